"""What scalars mean in YAML 1.2, in ROS parameter files and in maps."""

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from barn_worlds.base.files import dump_yaml, parse_yaml
from barn_worlds.base.yaml_scalars import (
    CoreLoader,
    RosLoader,
    TextLoader,
    parse_flag,
    parse_numbers,
)

# Text, what YAML 1.2 reads, what ROS reads: https://yaml.org/spec/1.2.2/#103-core-schema
# and `get_value` of rcl_yaml_param_parser.
SCALARS = [
    ("no", "no", False),
    ("ON", "ON", True),
    ("y", "y", True),
    ("True", True, True),
    ("10:20", "10:20", "10:20"),
    ("5e-1", 0.5, 0.5),
    ("1.", 1.0, 1.0),
    ("-.5E+3", -500.0, -500.0),
    ("010", 10, 8),
    ("0o10", 8, "0o10"),
    ("0x1F", 31, 31),
    ("-0x1F", "-0x1F", -31),
    ("1_000", "1_000", "1_000"),
    ("2020-01-01", "2020-01-01", "2020-01-01"),
    ("~", None, "~"),
    ("-.inf", -float("inf"), -float("inf")),
    ("infinity", "infinity", float("inf")),
    ("'1'", "1", "1"),
    ("<<", "<<", "<<"),
]


@pytest.mark.parametrize("text, core, ros", SCALARS)
def test_scalars(text, core, ros):
    assert parse_yaml(f"[{text}]", "f", CoreLoader) == [core]
    assert parse_yaml(f"[{text}]", "f", RosLoader) == [ros]


@given(
    st.sampled_from([text for text, *_ in SCALARS])
    | st.text("0123456789eExXo.:+-_infaNty ", max_size=5)
)
def test_texts_come_back_from_every_reader(text):
    dumped = dump_yaml({"a": [text]})
    for loader in (CoreLoader, RosLoader, yaml.SafeLoader):
        assert parse_yaml(dumped, "f", loader) == {"a": [text]}


@given(st.floats(allow_nan=False) | st.integers(-(2**63), 2**63 - 1) | st.booleans())
def test_numbers_come_back_from_every_reader(value):
    dumped = dump_yaml([value])
    for loader in (CoreLoader, RosLoader, yaml.SafeLoader):
        (back,) = parse_yaml(dumped, "f", loader)
        assert (back, type(back)) == (value, type(value))


def test_numbers_and_flags_of_maps_may_be_quoted():
    values = ["0.05", "1e-2", ".inf", "-.INF", ["1", "x"], "1:2"]
    infinity = float("inf")
    expected = [0.05, 0.01, infinity, -infinity, [1.0, "x"], "1:2"]
    assert parse_numbers(values) == expected
    assert [parse_flag(text) for text in ("1", "yes", "Off", "x")] == [1, 1, 0, "x"]


@pytest.mark.parametrize("loader", [CoreLoader, RosLoader, TextLoader])
def test_a_key_that_occurs_twice_is_refused(loader):
    with refused("^f: not YAML: 'a' occurs twice; keep only one"):
        parse_yaml("b: {a: 1, c: 2, a: 3}", "f", loader)
