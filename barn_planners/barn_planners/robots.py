"""Planners for other robots: what of a preset, which is the Jackal's, changes with the robot, and how.

A robot whose circumscribed circle about base_link is s times the Jackal's gets the Jackal's planner drawn s times as
large: every length times s, every time as it is. So speeds and accelerations are s times the preset's, but at most the
robot's limits; yaw rates and yaw accelerations are the preset's, at most the robot's. The outline is the robot's own.
docs/robots.md has the table. Nothing changes for the Jackal itself, whose presets were calibrated.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from barn_planners.costmap.config import (
    CostmapConfig,
    GlobalCostmapConfig,
    format_footprint,
)
from barn_planners.registry import planner_config, planner_entry
from barn_worlds.base.config import Checked, Quantity, fields_of, replace_dotted
from barn_worlds.base.errors import ConfigError
from barn_worlds.geometry.polygon import Corner
from barn_worlds.robots.files import STANDARD, other_name
from barn_worlds.robots.parts import LidarConfig
from barn_worlds.robots.robot import Robot

# Sections about the sensor or about obstacles, which do not grow with the robot.
_KEPT = ("guard.", "tracker.")
# Weights of distances in metres.
_OF_METRES = (
    "critics.goal_weight",
    "critics.align_weight",
    "critics.follow_weight",
    "critics.forward_weight",
)
_DWA = ("dwa.path_weight", "dwa.goal_weight")
_LIDAR = {
    "lidar_x_m": "mount_x_m",
    "lidar_y_m": "mount_y_m",
    "lidar_yaw_rad": "mount_yaw_rad",
}


def scale_of(robot: Robot) -> float:
    """Return the robot's size in that of the Jackal: the ratio of the circumscribed radii about base_link."""
    return robot.chassis.circumscribed_m / STANDARD.chassis.circumscribed_m


def fitted(config: Checked, robot: Robot) -> dict[str, Any]:
    """Return the parameters of a preset, by dotted name, that a robot changes, but for the place of its lidar."""
    if not other_name(robot.chassis):
        return {}
    scale = scale_of(robot)
    found: dict[str, Any] = {}
    in_metres = getattr(getattr(config, "dwa", None), "distances_in_metres", False)
    of_metres = _OF_METRES + (_DWA if in_metres else ())
    for name, about, value in fields_of(config):
        if isinstance(value, float) and not name.startswith(_KEPT):
            changed = (
                value / scale
                if name.endswith(of_metres)
                else _scaled(name, value, scale, robot)
            )
            if changed != value:
                found[name] = _allowed(changed, about)
    found |= _dwa(config, robot, scale)
    for name, costmap in _costmaps(config):
        found |= {
            f"{name}.{key}": value
            for key, value in _outline(costmap, robot, scale).items()
        }
    return found | _body(config, robot)


def lidar_place(config: Checked, lidar: LidarConfig) -> dict[str, float]:
    """Return what a configuration must say of the place of the lidar, by dotted name, where it says something else."""
    found = {}
    for name, _, value in fields_of(config):
        key = _LIDAR.get(name.rpartition(".")[2])
        if key is not None and value != getattr(lidar, key):
            found[name] = getattr(lidar, key)
    return found


def parameters_for(
    name: str, preset: str, overrides: Mapping[str, Any], robot: Robot
) -> dict[str, Any]:
    """Return a planner's parameters for a robot by dotted name, `overrides` over those derived, or ConfigError."""
    entry = planner_entry(name)
    if entry.fit is None or not other_name(robot.chassis):
        return dict(overrides)
    try:
        derived = entry.fit(planner_config(name, preset, overrides), robot)
    except ConfigError as error:
        raise ConfigError(f"planner {name!r}: {error}") from None
    written = {
        key: float(f"{value:.6g}") if isinstance(value, float) else value
        for key, value in derived.items()
    }
    return written | dict(overrides)


def _scaled(name: str, value: float, scale: float, robot: Robot) -> float:
    """Return what becomes of a parameter, by the unit in its name."""
    drive, last = robot.drive, name.rpartition(".")[2]
    fastest, backwards = (
        drive.max_speed_m_s,
        min(drive.max_reverse_m_s, drive.max_speed_m_s),
    )
    by_unit = {
        "_per_m": value / scale,
        "_mps2": min(scale * value, drive.max_acceleration_m_s2),
        "_radps2": min(value, drive.max_yaw_acceleration_rad_s2),
        "_radps": min(value, drive.max_yaw_rate_rad_s),
        "_mps": min(max(scale * value, -backwards), fastest),
        "_m": value if last in _LIDAR else scale * value,
    }
    return next(
        (changed for unit, changed in by_unit.items() if last.endswith(unit)), value
    )


def _allowed(value: float, about: Quantity) -> float:
    low = value if about.minimum is None else max(value, about.minimum)
    return low if about.maximum is None else min(low, about.maximum)


def _dwa(config: Checked, robot: Robot, scale: float) -> dict[str, float]:
    """Return what keeps DWA from turning on the spot where it might drive.

    The window opens for longer if the robot accelerates slowly, or a robot at rest would try nothing but creeping.
    Where distances count in metres, costs under the edges do not count: they would outweigh all that a rollout can
    gain.
    """
    dwa = getattr(config, "dwa", None)
    if dwa is None:
        return {}
    slower = max(1.0, scale * dwa.acceleration_mps2 / robot.drive.max_acceleration_m_s2)
    found = {"dwa.window_period_s": min(slower * dwa.window_period_s, 1.0)}
    return found | ({"dwa.obstacle_weight": 0.0} if dwa.distances_in_metres else {})


def _costmaps(config: Checked) -> Iterator[tuple[str, CostmapConfig]]:
    for name in ("local_costmap", "global_costmap"):
        costmap = getattr(config, name, None)
        if isinstance(costmap, CostmapConfig):
            yield name, costmap


def _outline(costmap: CostmapConfig, robot: Robot, scale: float) -> dict[str, Any]:
    """Return footprint and inflation of a costmap: the same shares of the robot's length and width as of the Jackal's.

    What the inflation is beyond the inscribed radius grows with the robot. Where base_link is nearer to front or back
    than to the sides, global plans keep that far away, or passages would be too narrow.
    """
    own = STANDARD
    share_x = 2.0 * costmap.footprint_half_length_m / own.length_m
    share_y = 2.0 * costmap.footprint_half_width_m / own.width_m
    corners = [(share_x * x, share_y * y) for x, y in robot.chassis.hull_m]
    half_x, half_y = _reach(corners)
    found: dict[str, Any] = {
        "footprint_half_length_m": half_x,
        "footprint_half_width_m": half_y,
    }
    if not _rectangle(corners):
        found["footprint"] = format_footprint(corners)
    padded = {**found, "footprint_padding_m": scale * costmap.footprint_padding_m}
    inscribed = replace_dotted(costmap, padded, "costmap").inscribed_m
    across = half_y + padded["footprint_padding_m"]
    if (
        isinstance(costmap, GlobalCostmapConfig)
        and across > inscribed + 1e-9
        and not robot.chassis.round
    ):
        found["inscribed_radius_m"] = inscribed = across
    return found | {
        "inflation_radius_m": inscribed
        + scale * (costmap.inflation_radius_m - costmap.inscribed_m)
    }


def _body(config: Checked, robot: Robot) -> dict[str, float]:
    """Return the half sizes and radii of planners without a costmap: rectangles centred on base_link, and discs."""
    half_x, half_y = _reach(robot.chassis.hull_m)
    own, outer = STANDARD, robot.chassis.circumscribed_m
    found: dict[str, float] = {}
    for name, _, value in fields_of(config):
        last = name.rpartition(".")[2]
        if last == "half_length_m":
            found[name] = half_x
        elif last == "half_width_m":
            found[name] = half_y
        elif last == "turning_radius_m":
            found[name] = outer
        elif (
            last == "robot_radius_m"
        ):  # as far between inscribed and circumscribed radius as the Jackal's
            share = (value - own.chassis.inscribed_m) / (
                own.chassis.circumscribed_m - own.chassis.inscribed_m
            )
            found[name] = robot.chassis.inscribed_m + share * (
                outer - robot.chassis.inscribed_m
            )
    return found


def _reach(corners: Sequence[Corner]) -> tuple[float, float]:
    return max(abs(x) for x, _ in corners), max(abs(y) for _, y in corners)


def _rectangle(corners: Sequence[Corner]) -> bool:
    x, y = _reach(corners)
    return len(corners) == 4 and all(
        abs(abs(u) - x) < 1e-9 and abs(abs(v) - y) < 1e-9 for u, v in corners
    )
