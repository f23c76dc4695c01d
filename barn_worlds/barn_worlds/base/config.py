"""Configuration as frozen dataclasses that check themselves.

You declare a configuration class once. The Python interface, YAML files, the ROS
parameters of the nodes and the tables of the documentation all use the declaration::

    @dataclass(frozen=True)
    class LidarConfig(Checked):
        beams: int = quantity(720, "number of beams", "", 1, 10000)
        range_max_m: float = quantity(30.0, "longest range", "m", minimum=0.0)

    LidarConfig(beams=0)  # ConfigError: beams must be from 1 to 10000, got 0
    from_dict(LidarConfig, {"beams": 360}, "robot.yaml")
"""

import dataclasses
import operator
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field
from enum import Enum
from functools import cache, partial
from numbers import Integral
from typing import Any, TypeVar, cast, get_args, get_origin

import cattrs
from cattrs.errors import (
    AttributeValidationNote,
    ClassValidationError,
    ForbiddenExtraKeysError,
    IterableValidationError,
    IterableValidationNote,
)
from cattrs.gen import make_dict_structure_fn, make_dict_unstructure_fn, override

from barn_worlds.base.errors import ConfigError, format_value, suggest, suggest_similar
from barn_worlds.base.files import read_package_yaml

T = TypeVar("T")

_METADATA_KEY = "barn"  # under which a dataclass field holds its `Quantity`
_TYPE_NAMES: dict[type[Any], str] = {
    float: "a number",
    int: "a whole number",
    bool: "true or false",
    str: "text",
}
_RELATIONS = {
    "below": operator.lt,
    "at most": operator.le,
    "at least": operator.ge,
    "above": operator.gt,
}
# A larger integer raises OverflowError where it becomes a float.
_LARGEST_FLOAT = 10**308
_LARGEST_INTEGER = 2**63 - 1


@dataclass(frozen=True)
class Quantity:
    """The meaning, unit and allowed values of one configuration field."""

    description: str

    unit: str = ""
    """Unit as it is written, such as "m/s"; empty for numbers without one."""

    minimum: float | None = None
    """Smallest allowed value, inclusive."""

    maximum: float | None = None
    """Largest allowed value, inclusive."""

    choices: tuple[str, ...] = ()
    """Allowed texts; empty if the field is no choice."""

    optional: bool = False
    """Whether plain data leave the field out while it has its default.

    A field that is added later is optional, so that earlier files and checksums of
    configurations stay the same.
    """

    is_selection: bool = False
    """Whether the text selects worlds, so that their numbers may stand for it."""

    def summary(self, *, unit: bool = True) -> str:
        """Return meaning, unit and limits: "longest range [m] (at least 0 m)"."""
        parts = [self.description]
        if unit and self.unit:
            parts.append(f"[{self.unit}]")
        limits = self.describe_limits()
        if limits:
            parts.append(f"({limits})")
        return " ".join(parts)

    def describe_limits(self) -> str:
        """Return "from 0 to 3 m" (inclusive), "one of a, b", or "" without limits."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        low = _format_limit(self.minimum)
        high = _format_limit(self.maximum)
        if low and high:
            limits = f"from {low} to {high}"
        elif low:
            limits = f"at least {low}"
        elif high:
            limits = f"at most {high}"
        else:
            return ""
        return f"{limits} {self.unit}".rstrip()


def quantity(
    default: T,
    description: str,
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    choices: tuple[str, ...] = (),
    optional: bool = False,
    is_selection: bool = False,
) -> T:
    """Return a dataclass field of a `Checked` class, with meaning, unit and limits.

    Args:
        default: Value of the field where nobody sets it.
        description: Meaning of the field in a few words, for tables and ROS tools.
        unit: Unit of the number, such as "m/s".
        minimum: Smallest value that passes the check. Applies to each item of a tuple.
        maximum: Largest value that passes the check. Applies to each item of a tuple.
        choices: Texts that pass the check. By default any text does.
        optional: Leave the field out of plain data while it has its default.
        is_selection: Take whole numbers for the text (`read_selection`).

    Returns:
        The dataclass field, under the type of its default.
    """
    declaration = Quantity(
        description, unit, minimum, maximum, choices, optional, is_selection
    )
    return field(default=default, metadata={_METADATA_KEY: declaration})


# As `quantity` without the default: whoever constructs the class must set the field.
required: Callable[..., Any] = partial(quantity, MISSING)
# As `quantity(..., optional=True)`.
optional: Callable[..., Any] = partial(quantity, optional=True)
# Metadata of an optional dataclass field that is no quantity.
OPTIONAL = {_METADATA_KEY: Quantity("", optional=True)}


@dataclass(frozen=True)
class Checked:
    """Base of configuration classes: construction checks every declared field."""

    def __post_init__(self) -> None:
        """Raise ConfigError if a declared field, nested or not, is not allowed."""
        for name, declaration, value in fields_of(self):
            _check(name, declaration, value)
        self.check_rules()

    def check_rules(self) -> None:
        """Raise ConfigError if fields do not fit together; subclasses say when."""

    def require(self, holds: bool, name: str, rule: str) -> None:
        """Raise ConfigError that names a field and its value, unless `holds`.

        Args:
            holds: Whether the configuration satisfies the rule.
            name: Field that the message names, dotted if it is nested.
            rule: The rest of the message, such as "must be below high_m = 3".

        Raises:
            ConfigError: If the rule does not hold.
        """
        if not holds:
            raise ConfigError(
                f"{name} {rule}, got {format_value(operator.attrgetter(name)(self))}"
            )

    def require_order(self, name: str, relation: str, other: str) -> None:
        """Raise ConfigError unless a field is related so to another field.

        Args:
            name: Field that the message names.
            relation: "below", "at most", "at least" or "above".
            other: Field that it is compared with.

        Raises:
            ConfigError: If the relation does not hold.
        """
        limit = getattr(self, other)
        holds = _RELATIONS[relation](getattr(self, name), limit)
        self.require(holds, name, f"must be {relation} {other} = {limit:g}")


def fields_of(config: Any) -> Iterator[tuple[str, Quantity, Any]]:
    """Yield dotted name, `Quantity`, value of each field, nested too unless `OPTIONAL`.

    An `OPTIONAL` nested configuration is set as a whole, so its fields are left out.
    """
    for item in dataclasses.fields(config):
        value = getattr(config, item.name)
        if not dataclasses.is_dataclass(value):
            if _METADATA_KEY in item.metadata:
                yield item.name, item.metadata[_METADATA_KEY], value
        elif not _is_optional(item):
            for name, declaration, inner_value in fields_of(value):
                yield f"{item.name}.{name}", declaration, inner_value


def as_dict(config: object) -> dict[str, Any]:
    """Return a configuration as a nested dict, without optional fields at defaults."""
    return cast(dict[str, Any], _writer().unstructure(config))


def from_dict(cls: type[T], mapping: Mapping[str, Any], where: str) -> T:
    """Return a checked configuration built from nested data; ConfigError names `where`.

    Args:
        cls: Dataclass to build, with nested dataclasses in it.
        mapping: Values by field name, as YAML or JSON give them.
        where: Path of the file or name of the option, to begin an error message with.

    Returns:
        The configuration, checked.

    Raises:
        ConfigError: For an unknown key, a wrong type or a value out of range. Its line
            names the key by its dotted path.
    """
    try:
        return _reader().structure(mapping, cls)
    except (ClassValidationError, ConfigError, TypeError, ValueError) as error:
        raise ConfigError(f"{where}: {_explain(error)}") from None


def replace_dotted(config: T, changes: Mapping[str, Any], where: str) -> T:
    """Return a checked copy with new values by dotted name; ConfigError for a bad one.

    Args:
        config: Configuration to start from; it stays as it is.
        changes: New values by dotted field name. The name of a nested configuration
            takes a mapping of its fields.
        where: Path of the file or name of the option, to begin an error message with.

    Returns:
        A configuration of the same class.

    Raises:
        ConfigError: For an unknown name or a value that is not allowed.
    """
    # All fields, also optional ones that `as_dict` leaves out.
    content = cast(dict[str, Any], cattrs.unstructure(config))
    values = dict(_walk(content))
    # `values` has the mappings inside `content` themselves, so a key that is set in one
    # changes `content`.
    for name, value in _flatten(values, changes):
        if name not in values:
            raise ConfigError(
                f"{where}: unknown parameter {format_value(name)}"
                f"{suggest(name, values)}"
            )
        parent, _, key = name.rpartition(".")
        mapping = values[parent] if parent else content
        mapping[key] = value
    return from_dict(type(config), content, where)


def as_plain(value: Any, depth: int = 3) -> Any:
    """Return a value with NumPy and pandas parts made plain, tuples made lists.

    Args:
        value: A number, an array, a column, or a list or dict that contains some.
        depth: Number of levels of nested lists and dicts to convert.
    """
    if hasattr(value, "tolist"):
        return value.tolist()
    if not depth:
        return value
    if isinstance(value, dict):
        return {key: as_plain(item, depth - 1) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [as_plain(item, depth - 1) for item in value]
    return value


def read_selection(worlds: Any, kind: type[Exception]) -> str:
    """Return world numbers (3, [0, 60]) as text ("0,60"), text as is, or raise `kind`.

    Args:
        worlds: A text, a whole number, or a list, array, column or range of them.
        kind: Class to raise for anything else.
    """
    worlds = as_plain(worlds, depth=0)
    if isinstance(worlds, str):
        return worlds
    is_list = isinstance(worlds, Iterable) and not isinstance(worlds, Mapping)
    numbers = list(worlds) if is_list else [worlds]
    for number in numbers:
        # In Python a bool is an int.
        if isinstance(number, bool) or not isinstance(number, (Integral, str)):
            numbers = []
    if not numbers:
        raise kind(
            "worlds must be whole numbers or text, such as 3, [0, 60] or 0-49, got"
            f" {format_value(worlds)}"
        )
    return ",".join(map(str, numbers))


def read_presets(package: str, file: str, standard: T) -> dict[str, T]:
    """Return package data's presets by name, each changing `standard` or its `base`.

    Args:
        package: Python package with the file in its folder `data`.
        file: File name. The file maps names of presets to changes, nested as the
            configuration is. The key `base` names an earlier preset to start from.
        standard: Configuration that presets without a base start from.

    Returns:
        Configurations by name, in the order of the file.
    """
    presets: dict[str, T] = {}
    for name, changes in read_package_yaml(package, file).items():
        base = presets[changes.pop("base")] if "base" in changes else standard
        presets[name] = replace_dotted(base, changes, f"{file}: {name}")
    return presets


@cache
def _reader() -> cattrs.Converter:
    """Return the one, shared converter of plain data to configurations.

    It is shared because it generates code for each class, and folders of results hold
    thousands of configurations.
    """
    converter = cattrs.Converter()
    for kind in _TYPE_NAMES:
        converter.register_structure_hook(kind, _read_value)

    def build_reader(cls: type[Any]) -> Callable[[Any, Any], Any]:
        """Return a function that builds `cls` from data and refuses unknown keys."""
        build = make_dict_structure_fn(cls, converter, _cattrs_forbid_extra_keys=True)
        selections = [
            item.name
            for item in dataclasses.fields(cls)
            if getattr(item.metadata.get(_METADATA_KEY), "is_selection", False)
        ]

        def read(value: object, kind: object) -> Any:
            """Build `cls` from a mapping; TypeError unless all keys are text."""
            # cattrs would fail inside generated code, with a message about indices.
            if not isinstance(value, Mapping):
                raise TypeError(
                    f"must be a mapping of names to values, got {format_value(value)}"
                )
            for key in value:
                if not isinstance(key, str):
                    raise TypeError(f"keys must be text, got {format_value(key)}")
            content = dict(value)
            for name in selections:
                if name in content:
                    content[name] = read_selection(content[name], ConfigError)
            return build(content, kind)

        return read

    converter.register_structure_hook_factory(dataclasses.is_dataclass, build_reader)
    converter.register_structure_hook_func(_is_tuple, partial(_read_tuple, converter))
    return converter


@cache
def _writer() -> cattrs.Converter:
    """Return the one, shared converter of configurations to plain data."""
    # cattrs keeps defaults unless a class has overrides, so only classes with optional
    # fields need a writer of their own.
    converter = cattrs.Converter()

    def has_optional_fields(cls: type[Any]) -> bool:
        """Tell whether a class is a dataclass with optional fields."""
        return dataclasses.is_dataclass(cls) and any(
            map(_is_optional, dataclasses.fields(cls))
        )

    def build_writer(cls: type[Any]) -> Callable[[Any], dict[str, Any]]:
        """Return a function that makes a dict of a `cls`, without optional defaults."""
        overrides: dict[str, Any] = {
            item.name: override(omit_if_default=True)
            for item in dataclasses.fields(cls)
            if _is_optional(item)
        }
        return make_dict_unstructure_fn(cls, converter, **overrides)

    converter.register_unstructure_hook_factory(has_optional_fields, build_writer)
    return converter


def _is_optional(item: "dataclasses.Field[Any]") -> bool:
    """Tell whether plain data leave a field out while it has its default."""
    declaration: Quantity | None = item.metadata.get(_METADATA_KEY)
    return declaration is not None and declaration.optional


def _read_value(value: object, kind: type[Any]) -> Any:
    """Return a value as `kind`: Enum member by value, int as float too; else TypeError.

    For an Enum, return the member with this value; ValueError if there is none.
    """
    if issubclass(kind, Enum):
        return kind(value)
    value = as_plain(value, depth=0)
    if type(value) is kind:
        return value
    # People write 2 where they mean 2.0, but a float cannot hold every integer.
    if kind is float and type(value) is int and abs(value) < _LARGEST_FLOAT:
        return float(value)
    raise TypeError(f"must be {_TYPE_NAMES[kind]}, got {format_value(value)}")


def _is_tuple(kind: object) -> bool:
    """Tell whether a type is a tuple with item types, such as `tuple[int, ...]`."""
    origin: object = get_origin(kind)
    return origin is tuple


def _read_tuple(
    converter: cattrs.Converter, value: object, kind: Any
) -> tuple[Any, ...]:
    """Return an iterable as tuple type `kind`; TypeError, or an item's own error."""
    is_list = isinstance(value, Iterable) and not isinstance(value, (str, Mapping))
    items = list(cast("Iterable[Any]", value)) if is_list else []
    kinds = get_args(kind)
    if kinds[-1] is Ellipsis:
        length = ""
        kinds = (kinds[0],) * len(items)
    else:
        length = f" of {len(kinds)}"
    if not is_list or len(items) != len(kinds):
        raise TypeError(f"must be a list{length}, got {format_value(value)}")

    values = []
    for index, (item, item_kind) in enumerate(zip(items, kinds, strict=True)):
        try:
            values.append(converter.structure(item, item_kind))
        except Exception as error:
            note = IterableValidationNote("", index, item_kind)
            error.__dict__["__notes__"] = [*getattr(error, "__notes__", ()), note]
            raise IterableValidationError("", [error], kind) from None
    return tuple(values)


def _walk(mapping: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted name and value of every entry of a mapping and of nested ones."""
    for name, value in mapping.items():
        yield prefix + name, value
        if isinstance(value, dict):
            yield from _walk(value, f"{prefix}{name}.")


def _flatten(
    values: Mapping[str, Any], changes: Mapping[Any, Any], prefix: str = ""
) -> Iterator[tuple[str, Any]]:
    """Yield dotted name and value of each change, nested ones field by field."""
    for key, value in changes.items():
        name = f"{prefix}{key}"
        nested = values.get(name)
        # An empty mapping is no nested configuration: users put their own keys there.
        if nested and isinstance(nested, dict) and isinstance(value, Mapping):
            yield from _flatten(values, value, f"{name}.")
        else:
            yield name, value


def _explain(error: BaseException) -> str:
    """Return one line: dotted key and cause of the first of the nested errors."""
    # Dotted name of the field that the error concerns, with a dot at its end.
    prefix = ""
    while isinstance(error, (ClassValidationError, IterableValidationError)):
        # One line names one key, so the first of several causes has to do. cattrs notes
        # where each is; a wrong number of items concerns no single one.
        error = error.exceptions[0]
        for note in getattr(error, "__notes__", ()):
            if isinstance(note, AttributeValidationNote):
                prefix += f"{note.name}."
            elif isinstance(note, IterableValidationNote):
                prefix = f"{prefix.removesuffix('.')}[{note.index}]."

    name = prefix.removesuffix(".")
    if isinstance(error, ForbiddenExtraKeysError):
        key = prefix + min(error.extra_fields)
        allowed = [prefix + item.name for item in dataclasses.fields(error.cl)]
        return f"unknown key {format_value(key)}{suggest(key, allowed)}"
    if isinstance(error, KeyError):
        return f"missing key {name!r}"
    if isinstance(error, ConfigError):
        return f"{prefix}{error}"
    if isinstance(error, AttributeError):
        # cattrs asks what should be a mapping for its items.
        return f"{name} must be a mapping of names to values"
    return f"{name} {error}".lstrip()


def _format_limit(limit: float | None) -> str:
    """Return a limit as text, empty for None."""
    if limit is None:
        return ""
    return f"{limit:g}" if isinstance(limit, float) else str(limit)


def _check(name: str, declaration: Quantity, value: object) -> None:
    """Raise ConfigError if a value, or an item of a tuple, is NaN or not allowed."""
    items = value if isinstance(value, tuple) else (value,)
    choices = declaration.choices
    limits = declaration.describe_limits()
    for item in items:
        if choices and item not in choices:
            raise ConfigError(
                f"{name} must be {limits}, got {format_value(item)}"
                f"{suggest_similar(item, choices)}"
            )
        # In Python a bool is an int, but limits are for numbers.
        if isinstance(item, bool) or not isinstance(item, (int, float)):
            continue

        largest: float = sys.float_info.max
        kind = "finite"
        if isinstance(item, int):
            # Larger integers fit neither a ROS parameter nor an array of numpy.
            largest = _LARGEST_INTEGER
            kind = "a 64-bit integer"
        low = declaration.minimum
        high = declaration.maximum
        if low is None:
            low = -largest
        if high is None:
            high = largest
        # NaN fails both comparisons.
        if not low <= item <= high:
            raise ConfigError(
                f"{name} must be {limits or kind}, got {format_value(item)}"
            )
