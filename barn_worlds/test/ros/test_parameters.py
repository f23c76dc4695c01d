"""Parameters declared from a dataclass: defaults, overrides, ranges, and one line for what is not allowed."""

from dataclasses import dataclass, field

import pytest
import yaml
from refusals import refused

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402

from barn_worlds.base.config import Checked, quantity  # noqa: E402
from barn_worlds.ros.parameters import (  # noqa: E402
    declare_parameters,
    read_parameters,
    refuse_invalid_changes,
    warn_about_unknown_parameters,
)


@dataclass(frozen=True)
class Inner(Checked):
    range_max_m: float = quantity(
        30.0, "longest range", "m", minimum=0.0, maximum=100.0
    )


@dataclass(frozen=True)
class Config(Checked):
    beams: int = quantity(720, "number of beams", minimum=1)
    mode: str = quantity("exact", "kind of localisation", choices=("exact", "amcl"))
    pair: tuple[float, ...] = quantity((1.0, 2.0), "two numbers")
    inner: Inner = field(default_factory=Inner)


@dataclass(frozen=True)
class Lists(Checked):
    nodes: tuple[str, ...] = quantity((), "none by default")
    inputs: tuple[str, ...] = quantity(("scan", "odom"), "some by default")


@pytest.fixture
def context():
    context = rclpy.Context()
    rclpy.init(context=context)
    yield context
    rclpy.shutdown(context=context)


@dataclass(frozen=True)
class Selection(Checked):
    worlds: str = quantity("all", "worlds", is_selection=True)
    frame: str = quantity("map", "no list")


def make(context, **overrides):
    values = [Parameter(name, value=value) for name, value in overrides.items()]
    return Node(
        "declared", context=context, parameter_overrides=values, enable_rosout=False
    )


def test_defaults_overrides_and_descriptions(context):
    node = make(context, **{"beams": 360, "inner.range_max_m": 10.0})
    config = declare_parameters(node, Config())
    assert config == Config(beams=360, inner=Inner(10.0))
    described = node.describe_parameter("inner.range_max_m")
    assert described.description == "longest range [m]"
    assert described.floating_point_range[0].to_value == 100.0


@pytest.mark.parametrize(
    "overrides, config, message",
    [
        ({"beams": 0}, Config(), "beams"),
        ({"beams": "many"}, Config(), "beams"),
        ({"inner.range_max_m": "far"}, Config(), r"inner\.range_max_m"),
        (
            {"mode": "amlc"},
            Config(),
            "mode must be one of exact, amcl, got 'amlc'; did you mean 'amcl'",
        ),
        ({"nodes": 5}, Lists(), r"nodes\[0\] must be text, got 5$"),
    ],
)
def test_wrong_value_or_type_is_one_line(context, overrides, config, message):
    with refused(message):
        declare_parameters(make(context, **overrides), config)


def test_an_integer_serves_where_a_float_is_wanted(context):
    name = "inner.range_max_m"
    node = make(context, **{name: 10})
    assert declare_parameters(node, Config()).inner.range_max_m == 10.0
    refuse_invalid_changes(node, Config())
    (change,) = node.set_parameters([Parameter(name, value=20)])
    assert change.successful
    assert read_parameters(node, Config()).inner.range_max_m == 20.0
    (change,) = node.set_parameters([Parameter(name, value="far")])
    assert not change.successful


def test_an_unknown_parameter_is_warned_of_with_the_near_one(context, capfd):
    node = make(context, beems=3, use_sim_time=False)
    declare_parameters(node, Config())
    warn_about_unknown_parameters(node)
    output = capfd.readouterr().err
    assert "unknown parameter 'beems'; did you mean 'beams'?" in output
    assert "use_sim_time" not in output


def test_later_changes_are_checked_and_seen(context):
    node = make(context)
    declare_parameters(node, Config())
    refuse_invalid_changes(node, Config())
    refused = node.set_parameters([Parameter("mode", value="none")])[0]
    assert not refused.successful
    assert "one of exact, amcl" in refused.reason
    assert node.set_parameters([Parameter("beams", value=10)])[0].successful
    assert read_parameters(node, Config()).beams == 10


@pytest.mark.parametrize(
    "arguments, expected",
    [
        ([], Lists()),
        (["-p", "nodes:=[a,b]", "-p", "inputs:=[]"], Lists(("a", "b"), ())),
        (["-p", "nodes:=a", "-p", "inputs:=[scan]"], Lists(("a",), ("scan",))),
    ],
)
def test_lists_may_be_empty_or_a_single_text(context, arguments, expected):
    arguments_of_ros = ["--ros-args", *arguments] if arguments else []
    node = Node(
        "declared", context=context, cli_args=arguments_of_ros, enable_rosout=False
    )
    assert declare_parameters(node, Lists()) == expected
    assert read_parameters(node, Lists()) == expected


@pytest.mark.parametrize(
    "value, text", [("exact", "exact"), ("0", "0"), ("[0,5]", "0,5"), ("1.5", "1.5")]
)
def test_a_number_serves_where_a_text_is_wanted(context, value, text):
    arguments = ["--ros-args", "-p", f"worlds:={value}"]
    node = Node("declared", context=context, cli_args=arguments, enable_rosout=False)
    assert declare_parameters(node, Selection()) == Selection(text)
    assert read_parameters(node, Selection()) == Selection(text)


WRONG_TYPES = r"""
- [{worlds: true}, 'worlds must be whole numbers or text, .*, got True']
- [{worlds: [0.5, 5.0]}, 'worlds must be whole .*, got \[0\.5, 5\.0\]']
- [{frame: [1, 2]}, 'frame must be text, got \[1, 2\]']
"""


@pytest.mark.parametrize("overrides, message", yaml.safe_load(WRONG_TYPES))
def test_a_flag_or_a_list_is_no_text(context, overrides, message):
    with refused(message):
        declare_parameters(make(context, **overrides), Selection())


def test_a_text_cannot_be_deleted(context):
    node = make(context)
    declare_parameters(node, Selection())
    refuse_invalid_changes(node, Selection())
    (change,) = node.set_parameters([Parameter("frame", Parameter.Type.NOT_SET)])
    assert (change.successful, change.reason) == (
        False,
        "parameter: frame must be text, got None",
    )
