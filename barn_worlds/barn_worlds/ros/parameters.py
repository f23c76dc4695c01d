"""ROS parameters from a configuration dataclass, so that each is declared only once."""

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

from barn_worlds.base.config import Quantity, as_plain, fields_of, replace_dotted
from barn_worlds.base.errors import BarnError, ConfigError, suggest

T = TypeVar("T")


def declare_parameters(node: Node, config: T, *, read_only: bool = False) -> T:
    """Declare fields as ROS parameters; return a copy as set; ConfigError if invalid.

    Args:
        node: Node that gets the parameters. Nested fields get dotted names.
        config: Configuration with the defaults.
        read_only: Whether the parameters are fixed from now on.

    Returns:
        The configuration with what the user set.

    Raises:
        ConfigError: If the user set a value that is not allowed.
    """
    where = f"parameters of {node.get_name()}"
    changes = {}
    for name, declaration, default in fields_of(config):
        value = list(default) if isinstance(default, tuple) else default
        if not node.has_parameter(name):
            descriptor = _descriptor(declaration, value, read_only=read_only)
            try:
                node.declare_parameter(name, value, descriptor)
            except ParameterException as error:
                raise ConfigError(f"{where}: {error}") from None
        value = node.get_parameter(name).value
        changes[name] = _plain(value, default)
    return replace_dotted(config, changes, where)


def warn_about_unknown_parameters(node: Node) -> None:
    """Log a warning for every parameter that the user set but the node does not have.

    Call this after the last `declare_parameters`.
    """
    # rclpy declares values, but the method returns parameters.
    parameters = cast("dict[str, Parameter]", node.get_parameters_by_prefix(""))
    names = {parameter.name for parameter in parameters.values()}
    for name in node._parameter_overrides:
        if name not in names and not name.startswith("qos_overrides."):
            node.get_logger().warning(
                f"unknown parameter {name!r}{suggest(name, names)}"
            )


def refuse_invalid_changes(node: Node, config: object) -> None:
    """Make a node refuse later parameter changes that a configuration does not allow.

    Args:
        node: Node with the parameters.
        config: Configuration that they were declared from.
    """

    def check(parameters: list[Parameter]) -> SetParametersResult:
        """Return success if the configuration allows the values, else the reason."""
        try:
            _update(config, parameters)
        except BarnError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(check)


def read_parameters(node: Node, config: T) -> T:
    """Return a checked copy with a node's present values; ConfigError if not allowed.

    Args:
        node: Node with the parameters.
        config: Configuration that they were declared from.
    """
    names = [name for name, _, _ in fields_of(config)]
    return _update(config, map(node.get_parameter, names))


def _update(config: T, parameters: Iterable[Parameter]) -> T:
    """Return a checked copy of a configuration with the parameters that it declares."""
    defaults = {name: default for name, _, default in fields_of(config)}
    changes = {
        parameter.name: _plain(parameter.value, defaults[parameter.name])
        for parameter in parameters
        if parameter.name in defaults
    }
    return replace_dotted(config, changes, "parameter")


def _descriptor(
    declaration: Quantity, value: object, *, read_only: bool
) -> ParameterDescriptor:
    """Return the ROS descriptor of a parameter: meaning, unit, limits and typing."""
    description = declaration.description
    if declaration.unit:
        description += f" [{declaration.unit}]"
    descriptor = ParameterDescriptor(
        description=description,
        additional_constraints=declaration.describe_limits(),
        read_only=read_only,
        # So that `-p factor:=2` works for 2.0 and `-p worlds:=0` for "0", and since an
        # empty list of ROS has no type.
        dynamic_typing=isinstance(value, (float, str, list)),
    )
    minimum = declaration.minimum
    maximum = declaration.maximum
    if minimum is None and maximum is None:
        return descriptor
    largest: float = 1.7e308 if isinstance(value, float) else 2**63 - 1
    if minimum is None:
        minimum = -largest
    if maximum is None:
        maximum = largest
    if isinstance(value, float):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(minimum), to_value=float(maximum))
        ]
    elif isinstance(value, int) and not isinstance(value, bool):
        descriptor.integer_range = [
            IntegerRange(from_value=int(minimum), to_value=int(maximum))
        ]
    return descriptor


def _plain(value: Any, default: Any) -> Any:
    """Return a parameter's value, made a list or text if its default is one."""
    # rclpy gives arrays for lists of numbers.
    value = as_plain(value, depth=0)
    if isinstance(default, tuple):
        # A list of one text may be set without brackets.
        if isinstance(value, (str, bool, int, float)):
            return [value]
        return list(value or ())
    # The command line reads `name:=5` as a number. A flag and lists stay what they are,
    # which is no text.
    if isinstance(default, str) and type(value) in (int, float):
        return str(value)
    return value
