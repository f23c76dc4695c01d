"""A configuration checks itself and says in one line what is wrong."""

import re
from dataclasses import dataclass, field

import pytest
import yaml
from refusals import refused

from barn_worlds.base.config import (
    Checked,
    as_dict,
    fields_of,
    from_dict,
    quantity,
    replace_dotted,
)
from barn_worlds.base.errors import ConfigError, format_value, suggest


@dataclass(frozen=True)
class Inner(Checked):
    length_m: float = quantity(1.0, "a length", "m", minimum=0.0)
    kind: str = quantity("plain", "a kind", choices=("plain", "yellow"))

    low_m: float = quantity(0.0, "lower end", "m")
    high_m: float = quantity(2.0, "upper end", "m")

    def check_rules(self):
        self.require(
            self.low_m < self.high_m, "low_m", f"must be below high_m = {self.high_m:g}"
        )


@dataclass(frozen=True)
class Outer(Checked):
    count: int = quantity(3, "a count", minimum=1)
    inner: Inner = field(default_factory=Inner)


@dataclass(frozen=True)
class Placed(Checked):
    corner: tuple[float, float] = (0.0, 0.0)


# as a YAML file of few bytes makes it: each list holds the last one nine times
ALIASES: list = []
for _ in range(30):
    ALIASES = [ALIASES] * 9


@pytest.mark.parametrize(
    "mapping, message",
    [
        ({"count": 0}, "count must be at least 1, got 0"),
        ({"count": 1.5}, "count must be a whole number, got 1.5"),
        ({"count": True}, "count must be a whole number, got True"),
        ({"cuont": 1}, "unknown key 'cuont'; did you mean 'count'?"),
        (
            {"inner": {"lenght_m": 1}},
            "unknown key 'inner.lenght_m'; did you mean 'inner.length_m'?",
        ),
        (
            {"inner": {"length_m": -1.0}},
            "inner.length_m must be at least 0 m, got -1.0",
        ),
        (
            {"inner": {"length_m": float("nan")}},
            "inner.length_m must be at least 0 m, got nan",
        ),
        ({"inner": {"length_m": "1"}}, "inner.length_m must be a number, got '1'"),
        ({"inner": {"kind": "yelow"}}, "did you mean 'yellow'?"),
        (
            {"inner": {"length_m": 10**400}},
            "inner.length_m must be a number, got 1000000000",
        ),
        (
            {"inner": {"length_m": 10**5000}},
            "inner.length_m must be a number, got a number of thousands of digits",
        ),
        ({"inner": 3}, "inner must be a mapping"),
        ({"inner": "count"}, "inner must be a mapping of names to values, got 'count'"),
        ({"inner": {"low_m": 3.0}}, "inner.low_m must be below high_m = 2, got 3.0"),
        ({"inner": {5: 1, "kind": 2}}, "inner keys must be text, got 5"),
        ({None: 1}, "keys must be text, got None"),
        ({"count": ALIASES}, "count must be a whole number, got [["),
        ({"x" * 10**6: 1}, "unknown key 'xxx"),
        ([], "must be a mapping"),
    ],
)
def test_what_is_wrong_is_named(mapping, message):
    with refused("^file.yaml: .*" + re.escape(message)):
        from_dict(Outer, mapping, "file.yaml")


@pytest.mark.parametrize(
    "corner, message",
    [([1, "a"], "corner[1] must be"), ([1], "corner must be a list of 2, got")],
)
def test_items_and_their_number_are_named(corner, message):
    with refused("^file.yaml: " + re.escape(message)):
        from_dict(Placed, {"corner": corner}, "file.yaml")


def test_round_trip_and_integers_as_floats():
    config = from_dict(Outer, {"count": 2, "inner": {"length_m": 4}}, "here")
    assert config == Outer(2, Inner(4.0))
    assert from_dict(Outer, as_dict(config), "here") == config
    names = [name for name, _, _ in fields_of(config)]
    assert names == [
        "count",
        "inner.length_m",
        "inner.kind",
        "inner.low_m",
        "inner.high_m",
    ]


def test_dotted_changes():
    assert replace_dotted(Outer(), {"inner.length_m": 2}, "--set").inner.length_m == 2.0
    changes = {"inner": {"kind": "yellow", "low_m": 0.5}, "inner.low_m": 1}
    assert replace_dotted(Outer(inner=Inner(3.0)), changes, "--set") == Outer(
        inner=Inner(3.0, "yellow", 1.0)
    )


MISTAKES = """
- - inner.length: 2
  - unknown parameter 'inner.length'; did you mean 'inner.length_m'?
- - length_m: 2
  - unknown parameter 'length_m'; did you mean 'inner.length_m'?
- - lenght_m: 2
  - unknown parameter 'lenght_m'; did you mean 'inner.length_m'?
- - inner.a: 2
  - "unknown parameter 'inner.a'; known: inner.high_m, inner.kind, inner.length_m, inner.low_m"
- - zzz: 2
  - "unknown parameter 'zzz'; known: count, inner"
- - inner: {low: 2}
  - unknown parameter 'inner.low'; did you mean 'inner.low_m'?
- - 5: 2
  - "unknown parameter '5'; known: count, inner"
- - inner.length_m: -1
  - inner.length_m must be at least 0 m, got -1.0
"""


@pytest.mark.parametrize("changes, message", yaml.safe_load(MISTAKES))
def test_what_is_wrong_with_a_change_is_named(changes, message):
    with pytest.raises(ConfigError) as caught:
        replace_dotted(Outer(), changes, "--set")
    assert str(caught.value) == f"--set: {message}"


@pytest.mark.parametrize(
    "value, text",
    [
        ("a\nb", r"'a\nb'"),
        ("x" * 10**6, "'" + "x" * 57),
        pytest.param(10**5000, "a number of thousands of digits", id="digits"),
        (range(3), "range(0, 3)"),
    ],
)
def test_a_value_in_a_message_is_short(value, text):
    assert format_value(value).startswith(text)
    assert len(format_value(value)) < 130
    assert "\n" not in format_value(value)


def test_a_long_list_of_known_names_is_cut():
    names = [f"name{number:02}" for number in range(99)]
    assert suggest("x", names).endswith("name19, ...")


def test_an_optional_field_is_left_out_while_it_has_its_default():
    @dataclass(frozen=True)
    class Grown(Checked):
        old: int = quantity(1, "there from the first")
        new: bool = quantity(True, "came later", optional=True)

    @dataclass(frozen=True)
    class Outer(Checked):
        grown: Grown = field(default_factory=Grown)

    assert as_dict(Outer()) == {"grown": {"old": 1}}
    changed = replace_dotted(Outer(), {"grown.new": False}, "x")
    assert as_dict(changed) == {"grown": {"old": 1, "new": False}}
    assert from_dict(Outer, as_dict(changed), "x") == changed
    assert from_dict(Outer, as_dict(Outer()), "x") == Outer()
