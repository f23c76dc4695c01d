"""ROS parameters declared from a configuration dataclass, so that each is defined once."""

from collections.abc import Iterable
from typing import Any, TypeVar, cast

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter

from barn_worlds.base.config import Quantity, fields_of, replace_dotted
from barn_worlds.base.errors import BarnError, ConfigError, suggest

T = TypeVar("T")


def declare_parameters(node: Node, config: T, *, read_only: bool = False) -> T:
    """Declare every field of `config` as a parameter and return the configuration with what the user set.

    Nested fields get dotted names. Raises ConfigError in one line for a value that is not allowed.
    """
    changes = {}
    for name, about, default in fields_of(config):
        value = list(default) if isinstance(default, tuple) else default
        if not node.has_parameter(name):
            try:
                node.declare_parameter(
                    name, value, _descriptor(about, value, read_only=read_only)
                )
            except ParameterException as error:
                raise ConfigError(f"parameters of {node.get_name()}: {error}") from None
        changes[name] = _typed(node.get_parameter(name).value, default)
    return replace_dotted(config, changes, f"parameters of {node.get_name()}")


def warn_about_unknown_parameters(node: Node) -> None:
    """Log a warning for every parameter that the user set and that is not declared; call after the last `declare`."""
    # rclpy says of the type that these are values
    everything = cast("dict[str, Parameter]", node.get_parameters_by_prefix(""))
    declared = {item.name for item in everything.values()}
    for name in node._parameter_overrides:
        if name not in declared and not name.startswith("qos_overrides."):
            node.get_logger().warning(
                f"unknown parameter {name!r}{suggest(name, declared)}"
            )


def _updated(config: T, parameters: Iterable[Parameter]) -> T:
    """Return `config` with the values in `parameters` that belong to it; ConfigError if one is not allowed."""
    own = {name: value for name, _, value in fields_of(config)}
    changes = {
        item.name: _typed(item.value, own[item.name])
        for item in parameters
        if item.name in own
    }
    return replace_dotted(config, changes, "parameter")


def refuse_invalid_changes(node: Node, config: object) -> None:
    """Reject later parameter changes that the configuration does not allow, with the reason."""

    def judge(parameters: list[Parameter]) -> SetParametersResult:
        try:
            _updated(config, parameters)
        except BarnError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(judge)


def read_parameters(node: Node, config: T) -> T:
    """Return `config` with the present values of the node's parameters."""
    return _updated(
        config, (node.get_parameter(name) for name, _, _ in fields_of(config))
    )


def _descriptor(
    about: Quantity, value: object, *, read_only: bool
) -> ParameterDescriptor:
    meaning = about.description + (f" [{about.unit}]" if about.unit else "")
    described = ParameterDescriptor(
        description=meaning,
        additional_constraints=about.describe_limits(),
        read_only=read_only,
    )
    # so that `-p factor:=2` works for 2.0, and because in ROS an empty list has no type
    described.dynamic_typing = isinstance(value, (float, list))
    if about.minimum is None and about.maximum is None:
        return described
    kind, largest = (float, 1.7e308) if isinstance(value, float) else (int, 2**63 - 1)
    low = kind(-largest if about.minimum is None else about.minimum)
    high = kind(largest if about.maximum is None else about.maximum)
    if isinstance(value, float):
        described.floating_point_range = [
            FloatingPointRange(from_value=low, to_value=high)
        ]
    elif isinstance(value, int) and not isinstance(value, bool):
        described.integer_range = [IntegerRange(from_value=low, to_value=high)]
    return described


def _typed(value: Any, like: Any) -> Any:
    if isinstance(like, tuple):
        one = isinstance(value, (str, bool, int, float))
        return [value] if one else list(value or ())
    return list(value) if hasattr(value, "tolist") else value
