"""Configuration as frozen dataclasses that check themselves.

A configuration class is declared once and serves the Python interface, YAML files, the ROS parameters of the
nodes and the tables of the documentation::

    @dataclass(frozen=True)
    class LidarConfig(Checked):
        beams: int = quantity(720, "number of beams", minimum=1, maximum=10000)
        range_max_m: float = quantity(30.0, "longest range", "m", minimum=0.0)
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import cache
from typing import Any, TypeVar, cast

import cattrs
from cattrs.errors import ClassValidationError, ForbiddenExtraKeysError, IterableValidationError

from barn_worlds.errors import ConfigError, suggest

T = TypeVar("T")

_QUANTITY = "barn"


@dataclass(frozen=True)
class Quantity:
    """What is known of one configuration field: its meaning, unit and the values allowed (inclusive)."""

    description: str
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()

    def allowed(self) -> str:
        """Return the allowed values in words, or an empty text where everything is."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        unit = f" {self.unit}" if self.unit else ""
        if self.minimum is not None and self.maximum is not None:
            return f"from {self.minimum:g} to {self.maximum:g}{unit}"
        if self.minimum is not None:
            return f"at least {self.minimum:g}{unit}"
        if self.maximum is not None:
            return f"at most {self.maximum:g}{unit}"
        return ""


def quantity(
    default: T,
    description: str,
    unit: str = "",
    *,
    minimum: float | None = None,
    maximum: float | None = None,
    choices: tuple[str, ...] = (),
) -> T:
    """Declare a field of a `Checked` dataclass with its default, meaning, unit and allowed values."""
    about = Quantity(description, unit, minimum, maximum, choices)
    return field(default=default, metadata={_QUANTITY: about})


@dataclass(frozen=True)
class Checked:
    """Base of configuration dataclasses: every declared field is checked on construction."""

    def __post_init__(self) -> None:
        for name, about, value in fields_of(self):
            _check(f"{type(self).__name__}.{name}", about, value)


def fields_of(config: Any) -> Iterator[tuple[str, Quantity, Any]]:
    """Yield (name, quantity, value) of each declared field; nested configurations give dotted names."""
    for item in dataclasses.fields(config):
        value = getattr(config, item.name)
        if dataclasses.is_dataclass(value):
            for name, about, inner in fields_of(value):
                yield f"{item.name}.{name}", about, inner
        elif _QUANTITY in item.metadata:
            yield item.name, item.metadata[_QUANTITY], value


def as_dict(config: Any) -> dict[str, Any]:
    """Return a configuration as plain mappings, lists, numbers and texts, ready for YAML or JSON."""
    return cast(dict[str, Any], cattrs.unstructure(config))


def from_dict(cls: type[T], mapping: Mapping[str, Any], where: str) -> T:
    """Build a configuration from plain data.

    Raises ConfigError in one line, beginning with `where` (a path or the name of an option), for an unknown key,
    a wrong type or a value out of range.
    """
    converter = _converter()
    if not isinstance(mapping, Mapping):
        raise ConfigError(f"{where}: must be a mapping of names to values, got {mapping!r}")
    try:
        return converter.structure(mapping, cls)
    except ClassValidationError as error:
        raise ConfigError(f"{where}: {_first_cause(error)}") from None
    except (ConfigError, TypeError, ValueError) as error:
        raise ConfigError(f"{where}: {error}") from None


@cache
def _converter() -> cattrs.Converter:
    """Return the converter that keeps what it has found out about each class: thousands of results are read with it."""
    converter = cattrs.Converter(forbid_extra_keys=True, prefer_attrib_converters=True)
    for kind in (float, int, bool, str):
        converter.register_structure_hook(kind, _exact)
    return converter


def replace_dotted(config: T, changes: Mapping[str, Any], where: str) -> T:
    """Return a copy with the fields of `changes` (dotted names allowed) replaced and everything checked again."""
    merged = as_dict(config)
    for dotted, value in changes.items():
        *parents, last = dotted.split(".")
        node: Any = merged
        for name in [*parents, last]:
            if not isinstance(node, dict) or name not in node:
                known = node if isinstance(node, dict) else merged
                raise ConfigError(f"{where}: unknown parameter {dotted!r}{suggest(name, known)}")
            if name is not last:
                node = node[name]
        node[last] = value
    return from_dict(type(config), merged, where)


def _exact(value: Any, kind: type[Any]) -> Any:
    """Take a value only if it is of the kind already; an integer serves as a float, nothing else is converted."""
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if issubclass(kind, Enum):
        return kind(value)
    if type(value) is kind:
        return value
    raise TypeError(f"must be {kind.__name__}, got {value!r}")


def _first_cause(error: BaseException, path: str = "") -> str:
    """Return the innermost first cause of a conversion error, with the dotted name of the field it concerns."""
    if isinstance(error, ForbiddenExtraKeysError):
        known = {item.name for item in dataclasses.fields(error.cl)}
        extra = sorted(error.extra_fields)[0]
        return f"unknown key {path + extra!r}{suggest(extra, known)}"
    if isinstance(error, ClassValidationError):
        inner = error.exceptions[0]
        name = next((note.name for note in getattr(inner, "__notes__", ()) if hasattr(note, "name")), None)
        return _first_cause(inner, f"{path}{name}." if name else path)
    if isinstance(error, IterableValidationError):
        inner = error.exceptions[0]
        index = next((note.index for note in getattr(inner, "__notes__", ()) if hasattr(note, "index")), 0)
        return _first_cause(inner, f"{path.rstrip('.')}[{index}].")
    if isinstance(error, KeyError):
        return f"missing key {path + str(error.args[0])!r}"
    if isinstance(error, ConfigError) or not path:
        return str(error)
    reason = "must be a mapping" if "not iterable" in str(error) else str(error)
    return f"{path.rstrip('.')} {reason}"


def _check(name: str, about: Quantity, value: Any) -> None:
    plain = value.value if isinstance(value, Enum) else value
    numbers = plain if isinstance(plain, tuple) else (plain,)
    for number in numbers:
        if about.choices and number not in about.choices:
            raise ConfigError(f"{name} must be {about.allowed()}, got {number!r}{_near(number, about.choices)}")
        if isinstance(number, bool) or not isinstance(number, (int, float)):
            continue
        low = -math.inf if about.minimum is None else about.minimum
        high = math.inf if about.maximum is None else about.maximum
        if not math.isfinite(number) or not low <= number <= high:
            raise ConfigError(f"{name} must be {about.allowed() or 'finite'}, got {number!r}")


def _near(value: object, choices: tuple[str, ...]) -> str:
    hint = suggest(value, choices)
    return hint if "did you mean" in hint else ""
