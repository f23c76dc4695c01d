"""Planners by name: the built-in ones and those of other packages.

Another package adds a planner with an entry point in the group `barn_planners.planners`
that names a `PlannerEntry`::

    entry_points={
        "barn_planners.planners": ["my_planner = my_package.my_planner:ENTRY"]
    }
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from barn_planners.interface import Planner
from barn_worlds.base.compute import Compute
from barn_worlds.base.config import Checked, fields_of, replace_dotted
from barn_worlds.base.errors import ConfigError, format_value, suggest
from barn_worlds.robots.robot import Robot

GROUP = "barn_planners.planners"
ANY_PROTOCOL = "default"

# Loaded on demand, because some of these modules take a while to import.
_BUILT_IN = {
    name: EntryPoint(name, f"barn_planners.{name}.planner:ENTRY", GROUP)
    for name in ("dwa", "eband", "gap", "mppi", "policy")
}


@dataclass(frozen=True)
class PlannerEntry:
    """All that the suite needs to make a planner by name."""

    build: Callable[[Any], Planner]
    """Makes a planner from a configuration of `config_class`."""
    presets: Mapping[str, Checked]
    """Configurations by name, the recommended one first. A planner that needs no
    settings per protocol has the single preset "default"."""
    summary: str = ""
    fit: Callable[[Any, Robot], dict[str, Any]] | None = None
    """Returns the parameters to change for a robot other than the Jackal, by dotted
    name. Raises ConfigError if the planner cannot drive that robot."""
    speed_cap: Callable[[Any], float] | None = None
    """Highest speed in m/s, forward or backward, that a configuration commands. None:
    the highest of its parameters named `max_speed_mps`."""
    compute: Compute | None = None
    """Declared computing time of a cycle on the reference computer. None: no delay."""

    def __post_init__(self) -> None:
        """Raise ConfigError if there is no preset."""
        if not self.presets:
            raise ConfigError("a planner needs at least one preset")

    @property
    def config_class(self) -> type[Checked]:
        """Class of the planner's configuration, taken from its first preset."""
        return type(next(iter(self.presets.values())))


# Includes what `register` added, because tests and notebooks have no entry points.
_loaded_entries: dict[str, PlannerEntry] = {}


def register(name: str, entry: PlannerEntry) -> None:
    """Register a planner in this process; raise ConfigError if its name is taken.

    Packages use the entry point instead.

    Args:
        name: Name that `make_planner` and the option --planner accept from now on.
        entry: How to make the planner.

    Raises:
        ConfigError: If another planner has the name.
    """
    if name in planner_names():
        raise ConfigError(f"a planner named {name!r} already exists")
    _loaded_entries[name] = entry


def planner_names() -> list[str]:
    """Return the names of all planners, built-in, registered and installed, sorted."""
    # Read anew each time: a package may have been installed since.
    external_names = {point.name for point in entry_points(group=GROUP)}
    return sorted({*_BUILT_IN, *_loaded_entries, *external_names})


def planner_entry(name: str) -> PlannerEntry:
    """Return a planner's entry, imported once and cached; ConfigError if that fails.

    Raises:
        ConfigError: If the name is unknown or the module cannot be loaded.
    """
    if name in _loaded_entries:
        return _loaded_entries[name]

    same_name = (point for point in entry_points(group=GROUP) if point.name == name)
    # Built-in planners win, so that no package can pose as one of them.
    point = _BUILT_IN.get(name) or next(same_name, None)
    if point is None:
        raise ConfigError(
            f"unknown planner {format_value(name)}{suggest(name, planner_names())}"
        )

    try:
        entry = point.load()
    except (ImportError, AttributeError) as error:
        raise ConfigError(
            f"planner {name!r}: cannot load {point.value!r}: {error}"
        ) from error
    if not isinstance(entry, PlannerEntry):
        raise ConfigError(
            f"planner {name!r}: its entry point must be a PlannerEntry, got {entry!r}"
        )

    _loaded_entries[name] = entry
    return entry


def planner_config(
    name: str, preset: str = "challenge", overrides: Mapping[str, Any] | None = None
) -> Any:
    """Return a preset, or a lone "default", with `overrides`; ConfigError if unknown.

    Args:
        name: Name of the planner.
        preset: Configuration to start from. Ignored if the planner has only the preset
            "default", which serves all protocols.
        overrides: Values that differ from the preset, by dotted name.

    Returns:
        A configuration of the planner's `config_class`.

    Raises:
        ConfigError: If planner, preset or parameter is unknown, or a value is not
            allowed.
    """
    available = planner_entry(name).presets
    # Protocols name presets; a planner without any takes the same for all.
    if list(available) == [ANY_PROTOCOL]:
        preset = ANY_PROTOCOL
    if preset not in available:
        raise ConfigError(
            f"planner {name!r}: unknown preset {format_value(preset)}"
            f"{suggest(preset, available)}"
        )
    return replace_dotted(available[preset], overrides or {}, f"planner {name!r}")


def speed_cap_mps(name: str, config: Checked) -> float:
    """Return the highest speed in m/s that a configuration declares, 0 if it has none.

    Args:
        name: Name of the planner.
        config: Its resolved configuration.
    """
    speed_cap = planner_entry(name).speed_cap
    if speed_cap is not None:
        return speed_cap(config)

    # By the last part of the name, since sections such as `dwa.` hold it.
    caps = [
        value
        for key, _, value in fields_of(config)
        if key.rpartition(".")[2] == "max_speed_mps"
    ]
    return max(caps, default=0.0)


def make_planner(
    name: str, preset: str = "challenge", overrides: Mapping[str, Any] | None = None
) -> Planner:
    """Build a planner, not started, from a preset with `overrides`; or ConfigError.

    Args:
        name: Name of the planner.
        preset: Configuration to start from, as in `planner_config`.
        overrides: Values that differ from the preset, by dotted name.

    Raises:
        ConfigError: If planner, preset or parameter is unknown, or a value is not
            allowed.
    """
    return planner_entry(name).build(planner_config(name, preset, overrides))
