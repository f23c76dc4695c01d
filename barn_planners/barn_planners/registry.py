"""Planners by name: built-in ones and those of other packages.

Another package adds a planner with an entry point in the group `barn_planners.planners` that names a `PlannerEntry`::

    entry_points={"barn_planners.planners": ["my_planner = my_package.my_planner:ENTRY"]}
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from importlib.metadata import entry_points
from types import MappingProxyType
from typing import Any

from barn_planners.interface import Planner
from barn_worlds.base.compute import Compute
from barn_worlds.base.config import Checked, fields_of, replace_dotted
from barn_worlds.base.errors import ConfigError, format_value, suggest
from barn_worlds.robots.robot import Robot

GROUP = "barn_planners.planners"
ANY_PROTOCOL = "default"
_NOTHING: Mapping[str, Any] = MappingProxyType({})

# Imported on demand: some of these take a while to load.
_OWN = ("dwa", "eband", "gap", "mppi", "policy")
_BUILT_IN = {name: f"barn_planners.{name}.planner:ENTRY" for name in _OWN}


@dataclass(frozen=True)
class PlannerEntry:
    """A planner that can be made by name."""

    build: Callable[[Any], Planner]
    presets: Mapping[
        str, Checked
    ]  # the recommended one first; only "default" if no protocol needs settings
    summary: str = ""
    fit: Callable[[Any, Robot], dict[str, Any]] | None = (
        None  # what a robot changes, by dotted name, or ConfigError
    )
    speed_cap: Callable[[Any], float] | None = (
        None  # m/s, either way; None: the highest `max_speed_mps`
    )
    compute: Compute | None = (
        None  # how long a cycle takes on the reference computer; None: without delay
    )
    config_class: type[Checked] = field(init=False)

    def __post_init__(self) -> None:
        if not self.presets:
            raise ConfigError("a planner needs at least one preset")
        object.__setattr__(
            self, "config_class", type(next(iter(self.presets.values())))
        )


_registered: dict[str, PlannerEntry] = {}


def register(name: str, entry: PlannerEntry) -> None:
    """Add a planner under an unused name, for scripts and tests; packages use the entry point group."""
    if name in planner_names():
        raise ConfigError(f"a planner named {name!r} exists already")
    _registered[name] = entry


def planner_names() -> list[str]:
    """Return the names of all planners, sorted."""
    return sorted(
        {*_BUILT_IN, *_registered, *(point.name for point in entry_points(group=GROUP))}
    )


def planner_entry(name: str) -> PlannerEntry:
    """Return what is registered under a name; ConfigError names the near one."""
    if name in _registered:
        return _registered[name]
    if name in _BUILT_IN:
        module, _, attribute = _BUILT_IN[name].partition(":")
        entry = getattr(import_module(module), attribute)
    else:
        entry = _announced(name)
    if not isinstance(entry, PlannerEntry):
        raise ConfigError(
            f"planner {name!r}: its entry point must be a PlannerEntry, got {entry!r}"
        )
    _registered[name] = entry
    return entry


def presets(name: str) -> dict[str, Checked]:
    """Return the presets of a planner by name, the recommended one first."""
    return dict(planner_entry(name).presets)


def planner_config(
    name: str, preset: str = "challenge", overrides: Mapping[str, Any] = _NOTHING
) -> Any:
    """Return a preset with `overrides` (dotted names); a planner with only the preset "default" uses it for all."""
    known = planner_entry(name).presets
    if list(known) == [ANY_PROTOCOL]:
        preset = ANY_PROTOCOL
    if preset not in known:
        raise ConfigError(
            f"planner {name!r}: unknown preset {format_value(preset)}{suggest(preset, known)}"
        )
    return replace_dotted(known[preset], overrides, f"planner {name!r}")


def speed_cap_mps(name: str, config: Checked) -> float:
    """Return the speed cap that a planner of this configuration declares, 0 where it declares none."""
    declared = planner_entry(name).speed_cap
    if declared is not None:
        return declared(config)
    caps = (
        value
        for key, _, value in fields_of(config)
        if key.rpartition(".")[2] == "max_speed_mps"
    )
    return max(caps, default=0.0)


def make_planner(
    name: str, preset: str = "challenge", overrides: Mapping[str, Any] = _NOTHING
) -> Planner:
    """Return a new planner; its `config` is the resolved configuration. ConfigError for names or values unknown."""
    return planner_entry(name).build(planner_config(name, preset, overrides))


def _announced(name: str) -> Any:
    for point in entry_points(group=GROUP):
        if point.name == name:
            try:
                return point.load()
            except (ImportError, AttributeError) as error:
                raise ConfigError(
                    f"planner {name!r}: cannot load {point.value!r}: {error}"
                ) from error
    raise ConfigError(
        f"unknown planner {format_value(name)}{suggest(name, planner_names())}"
    )
