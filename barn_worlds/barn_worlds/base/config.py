"""Configuration as frozen dataclasses that check themselves.

A configuration class is declared once and serves the Python interface, YAML files, the ROS parameters of the
nodes and the tables of the documentation::

    @dataclass(frozen=True)
    class LidarConfig(Checked):
        beams: int = quantity(720, "number of beams", "", 1, 10000)
        range_max_m: float = quantity(30.0, "longest range", "m", minimum=0.0)
"""

import dataclasses
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field
from enum import Enum
from functools import cache, partial
from operator import attrgetter
from typing import Any, TypeVar, cast

import cattrs
from cattrs.errors import (
    ClassValidationError,
    ForbiddenExtraKeysError,
    IterableValidationError,
)
from cattrs.gen import make_dict_structure_fn, make_dict_unstructure_fn, override

from barn_worlds.base.errors import ConfigError, format_value, suggest
from barn_worlds.base.text_files import read_package_yaml

T = TypeVar("T")

_QUANTITY = "barn"
_KINDS: dict[type[Any], str] = {
    float: "a number",
    int: "a whole number",
    bool: "true or false",
    str: "text",
}
_LARGEST_FLOAT = 10**308
_LARGEST_INTEGER = 2**63 - 1


@dataclass(frozen=True)
class Quantity:
    """The meaning, unit and allowed values (inclusive) of one configuration field.

    optional: left out of plain data while it has its default, so that what was written before it existed is the same.
    """

    description: str
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    optional: bool = False

    def summary(self, *, unit: bool = True) -> str:
        """Return meaning, unit and allowed values in one line: "longest range [m] (at least 0 m)"."""
        allowed = f" ({self.describe_limits()})" if self.describe_limits() else ""
        return (
            self.description
            + (f" [{self.unit}]" if unit and self.unit else "")
            + allowed
        )

    def describe_limits(self) -> str:
        """Return the allowed values in words; an empty text if there is no limit."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        low, high = (
            f"{limit:g}" if isinstance(limit, float) else limit
            for limit in (self.minimum, self.maximum)
        )
        if low is None and high is None:
            return ""
        limits = (
            f"at most {high}"
            if low is None
            else f"at least {low}"
            if high is None
            else f"from {low} to {high}"
        )
        return f"{limits} {self.unit}" if self.unit else limits


def quantity(
    default: T,
    description: str,
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    choices: tuple[str, ...] = (),
    optional: bool = False,
) -> T:
    """Declare a field of a `Checked` dataclass; see `Quantity`."""
    about = Quantity(description, unit, minimum, maximum, choices, optional)
    return field(default=default, metadata={_QUANTITY: about})


required: Callable[..., Any] = partial(
    quantity, MISSING
)  # as `quantity`, for a field that has no default
optional: Callable[..., Any] = partial(quantity, optional=True)
OPTIONAL = {
    _QUANTITY: Quantity("", optional=True)
}  # metadata of an optional field of any dataclass


@dataclass(frozen=True)
class Checked:
    """Base of configuration dataclasses: every declared field is checked on construction."""

    def __post_init__(self) -> None:
        for name, about, value in fields_of(self):
            _check(name, about, value)

    def require(self, holds: bool, name: str, rule: str) -> None:
        """Raise ConfigError unless a rule over several fields holds.

        name: the field that the message names, dotted if nested. rule: such as "must be below high_m = 3".
        """
        if not holds:
            raise ConfigError(
                f"{name} {rule}, got {format_value(attrgetter(name)(self))}"
            )


def fields_of(config: Any) -> Iterator[tuple[str, Quantity, Any]]:
    """Yield (name, quantity, value) of each declared field; nested configurations give dotted names.

    A nested configuration that is `OPTIONAL` is given as a whole or not at all: its fields are no parameters.
    """
    for item in dataclasses.fields(config):
        value = getattr(config, item.name)
        if dataclasses.is_dataclass(value):
            if item.metadata.get(_QUANTITY, Quantity("")).optional:
                continue
            for name, about, inner in fields_of(value):
                yield f"{item.name}.{name}", about, inner
        elif _QUANTITY in item.metadata:
            yield item.name, item.metadata[_QUANTITY], value


def as_dict(config: object) -> dict[str, Any]:
    """Return a configuration as plain mappings, lists, numbers and texts, ready for YAML or JSON.

    Optional fields are left out while they have their defaults.
    """
    return cast(dict[str, Any], _writer().unstructure(config))


def from_dict(cls: type[T], mapping: Mapping[str, Any], where: str) -> T:
    """Build a configuration from plain data.

    Raises ConfigError in one line for an unknown key, a wrong type or a value out of range. The line begins with
    `where` (a path or the name of an option) and names the key with the dotted path to it.
    """
    try:
        return _converter().structure(mapping, cls)
    except (ClassValidationError, ConfigError, TypeError, ValueError) as error:
        raise ConfigError(f"{where}: {_first_cause(error)}") from None


@cache
def _converter() -> cattrs.Converter:
    """Return the converter, made once: it generates code for each class, and results are read by the thousand."""
    converter = cattrs.Converter(forbid_extra_keys=True, prefer_attrib_converters=True)
    for kind in _KINDS:
        converter.register_structure_hook(kind, _exact)
    converter.register_structure_hook_factory(
        dataclasses.is_dataclass, lambda cls: _reader(cls, converter)
    )
    return converter


def _reader(cls: type[Any], converter: cattrs.Converter) -> Callable[[Any, Any], Any]:
    """Return the function that builds a dataclass from a mapping, once the mapping itself is checked."""
    build = make_dict_structure_fn(cls, converter, _cattrs_forbid_extra_keys=True)

    def read(value: object, kind: object) -> Any:
        if not isinstance(value, Mapping):
            raise TypeError(
                f"must be a mapping of names to values, got {format_value(value)}"
            )
        if odd := [key for key in value if not isinstance(key, str)]:
            raise TypeError(f"keys must be text, got {format_value(odd[0])}")
        return build(value, kind)

    return read


@cache
def _writer() -> cattrs.Converter:
    converter = cattrs.Converter()

    def write(cls: type[Any]) -> Callable[[Any], dict[str, Any]]:
        omitted: dict[str, Any] = {
            name: override(omit_if_default=True) for name in _optional_fields(cls)
        }
        return make_dict_unstructure_fn(cls, converter, **omitted)

    converter.register_unstructure_hook_factory(
        lambda cls: bool(_optional_fields(cls)), write
    )
    return converter


def _optional_fields(cls: type[Any]) -> list[str]:
    """Return the names of a dataclass's optional fields; none for anything else."""
    found = dataclasses.fields(cls) if dataclasses.is_dataclass(cls) else ()
    return [
        item.name
        for item in found
        if _QUANTITY in item.metadata and item.metadata[_QUANTITY].optional
    ]


def replace_dotted(config: T, changes: Mapping[str, Any], where: str) -> T:
    """Return a copy with some fields replaced and everything checked again.

    changes: values by dotted name, or by the name of a nested configuration with a mapping of its fields.
    """
    merged = cast(dict[str, Any], cattrs.unstructure(config))
    known = dict(_dotted(merged))
    for name, value in _flat(known, changes):
        if name not in known:
            raise ConfigError(
                f"{where}: unknown parameter {format_value(name)}{suggest(name, known)}"
            )
        parents, _, last = name.rpartition(".")
        (known[parents] if parents else merged)[last] = value
    return from_dict(type(config), merged, where)


def read_presets(package: str, file: str, standard: T) -> dict[str, T]:
    """Return the configurations of a file in a package's data, by name.

    The file has of each what it changes, nested as the configuration is: of the one before it that it names as its
    base, or else of the standard one.
    """
    found: dict[str, T] = {}
    for name, changes in read_package_yaml(package, file).items():
        base = found[changes.pop("base")] if "base" in changes else standard
        found[name] = replace_dotted(base, changes, f"{file}: {name}")
    return found


def _dotted(mapping: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted name and the value of everything in nested mappings, the inner mappings included."""
    for name, value in mapping.items():
        yield prefix + name, value
        if isinstance(value, dict):
            yield from _dotted(value, f"{prefix}{name}.")


def _flat(
    known: Mapping[str, Any], changes: Mapping[Any, Any], prefix: str = ""
) -> Iterator[tuple[str, Any]]:
    """Yield changes by dotted name; a mapping for a nested configuration yields one per key."""
    for name, value in changes.items():
        nested = known.get(
            f"{prefix}{name}"
        )  # empty where it is a mapping of whatever its user puts there
        if nested and isinstance(nested, dict) and isinstance(value, Mapping):
            yield from _flat(known, value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _exact(value: object, kind: type[Any]) -> Any:
    """Return the value if it has the right type. An integer is accepted for a float; nothing else is converted."""
    if kind is float and type(value) is int and abs(value) < _LARGEST_FLOAT:
        return float(value)
    if issubclass(kind, Enum):
        return kind(value)
    if type(value) is kind:
        return value
    raise TypeError(f"must be {_KINDS[kind]}, got {format_value(value)}")


def _first_cause(error: BaseException, path: str = "") -> str:
    """Return the innermost first cause of a conversion error, with the dotted name of the field it concerns."""
    if isinstance(error, ForbiddenExtraKeysError):
        known = [path + item.name for item in dataclasses.fields(error.cl)]
        extra = path + min(error.extra_fields)
        return f"unknown key {format_value(extra)}{suggest(extra, known)}"
    if isinstance(error, ClassValidationError):
        name = _noted(error.exceptions[0], "name", "")
        return _first_cause(error.exceptions[0], f"{path}{name}." if name else path)
    if isinstance(error, IterableValidationError):
        index = _noted(error.exceptions[0], "index", 0)
        return _first_cause(error.exceptions[0], f"{path.rstrip('.')}[{index}].")
    if isinstance(error, KeyError):
        key = str(error.args[0])
        return f"missing key {(path if path.endswith(f'{key}.') else path + key).rstrip('.')!r}"
    if isinstance(error, ConfigError):
        return f"{path}{error}"
    return f"{path.rstrip('.')} {error}".lstrip()


def _noted(error: BaseException, what: str, default: T) -> T:
    return next(
        (
            getattr(note, what)
            for note in getattr(error, "__notes__", ())
            if hasattr(note, what)
        ),
        default,
    )


def _check(name: str, about: Quantity, value: object) -> None:
    plain = value.value if isinstance(value, Enum) else value
    for number in plain if isinstance(plain, tuple) else (plain,):
        if about.choices and number not in about.choices:
            near = "".join(
                hint
                for hint in [suggest(number, about.choices)]
                if "did you mean" in hint
            )
            raise ConfigError(
                f"{name} must be {about.describe_limits()}, got {format_value(number)}{near}"
            )
        if isinstance(number, bool) or not isinstance(number, (int, float)):
            continue
        kind, most = (
            ("finite", sys.float_info.max)
            if isinstance(number, float)
            else ("of 64 bits", _LARGEST_INTEGER)
        )
        low = -most if about.minimum is None else about.minimum
        high = most if about.maximum is None else about.maximum
        if not low <= number <= high:
            raise ConfigError(
                f"{name} must be {about.describe_limits() or kind}, got {format_value(number)}"
            )
