"""What of a planner's preset changes for another robot than the Jackal, and how.

All presets are for the Jackal. For a robot whose circumscribed circle about base_link
is s times as large, the planner's parameters change as follows:

- lengths grow by s; times stay;
- speeds and accelerations grow by s, up to the robot's limits;
- yaw rates and yaw accelerations stay, up to the robot's limits;
- the outline is the robot's own.

Nothing changes for the Jackal itself. docs/robots.md has the table.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from barn_planners.costmap.config import (
    CostmapConfig,
    GlobalCostmapConfig,
    format_footprint,
)
from barn_planners.registry import planner_config, planner_entry
from barn_worlds.base.config import Checked, fields_of, replace_dotted
from barn_worlds.base.errors import ConfigError
from barn_worlds.geometry.polygon import Corner
from barn_worlds.robots.files import STANDARD_ROBOT, name_unless_standard
from barn_worlds.robots.parts import LidarConfig
from barn_worlds.robots.robot import Robot

# Sections about sensors and other movers, which do not grow with the robot.
_UNSCALED_SECTIONS = ("guard.", "tracker.")
# Weights per meter of distance: distances grow by s, so these shrink by s.
_WEIGHTS_PER_METER: tuple[str, ...] = (
    "critics.goal_weight",
    "critics.align_weight",
    "critics.follow_weight",
    "critics.forward_weight",
)
_DWA_WEIGHTS = ("dwa.path_weight", "dwa.goal_weight")
# Fields of `LidarConfig` by the planners' parameters for the same quantity.
_LIDAR_FIELDS = {
    "lidar_x_m": "mount_x_m",
    "lidar_y_m": "mount_y_m",
    "lidar_yaw_rad": "mount_yaw_rad",
}


def robot_scale(robot: Robot) -> float:
    """Return the ratio of a robot's circumscribed radius (base_link) to the Jackal's."""
    return robot.chassis.circumscribed_m / STANDARD_ROBOT.chassis.circumscribed_m


def fit_to_robot(config: Checked, robot: Robot) -> dict[str, Any]:
    """Return values to change for a robot by dotted name; {} if its body is a Jackal's.

    Args:
        config: Configuration of a planner for the Jackal.
        robot: Robot that the planner is to drive.

    Returns:
        New values by dotted name, but for the lidar's mount; empty for a robot with the
        Jackal's chassis.
    """
    if not name_unless_standard(robot.chassis):
        return {}

    scale = robot_scale(robot)
    changes = _scale_parameters(config, robot, scale) | _fit_dwa(config, robot, scale)
    for section in ("local_costmap", "global_costmap"):
        costmap = getattr(config, section, None)
        if isinstance(costmap, CostmapConfig):
            for name, value in _fit_costmap(costmap, robot, scale).items():
                changes[f"{section}.{name}"] = value
    return changes | _fit_body(config, robot)


def lidar_mount_changes(config: Checked, lidar: LidarConfig) -> dict[str, float]:
    """Return a lidar's mount by dotted name, leaving out what `config` has already.

    Args:
        config: Configuration of a planner.
        lidar: Lidar of the simulated robot, with its mount in base_link.

    Returns:
        Position in m and yaw in rad by dotted name, where they differ from `config`.
    """
    changes = {}
    for name, _, value in fields_of(config):
        lidar_field = _LIDAR_FIELDS.get(_last_part(name))
        if lidar_field is not None and value != getattr(lidar, lidar_field):
            changes[name] = getattr(lidar, lidar_field)
    return changes


def fit_parameters(
    name: str, preset: str, overrides: Mapping[str, Any], robot: Robot
) -> dict[str, Any]:
    """Return `overrides` and a preset's changes for a robot, none for Jackal; or raise.

    Args:
        name: Name of the planner.
        preset: Name of its preset.
        overrides: Values that the user set, by dotted name; they win.
        robot: Robot that the planner is to drive.

    Returns:
        Values by dotted name, with six significant digits so that they read well in
        files. For a robot with the Jackal's chassis, only `overrides`.

    Raises:
        ConfigError: If the planner cannot drive the robot.
    """
    entry = planner_entry(name)
    if entry.fit is None or not name_unless_standard(robot.chassis):
        return dict(overrides)

    try:
        changes = dict(entry.fit(planner_config(name, preset, overrides), robot))
    except ConfigError as error:
        raise ConfigError(f"planner {name!r}: {error}") from None
    for key, value in changes.items():
        if isinstance(value, float):
            changes[key] = float(f"{value:.6g}")
    return changes | dict(overrides)


def _last_part(name: str) -> str:
    """Return the last part of a dotted name, such as "max_speed_mps"."""
    return name.rpartition(".")[2]


def _scale_parameters(config: Checked, robot: Robot, scale: float) -> dict[str, Any]:
    """Return scaled parameters that differ, by dotted name, within allowed ranges."""
    weights = _WEIGHTS_PER_METER
    if getattr(getattr(config, "dwa", None), "distances_in_metres", False):
        weights += _DWA_WEIGHTS

    changes: dict[str, Any] = {}
    for name, quantity, value in fields_of(config):
        if not isinstance(value, float) or name.startswith(_UNSCALED_SECTIONS):
            continue
        new_value = _scale_by_unit(_last_part(name), value, scale, robot)
        if name.endswith(weights):
            new_value = value / scale
        if new_value == value:
            continue

        # A large robot must not push a parameter out of its allowed range.
        if quantity.minimum is not None:
            new_value = max(new_value, quantity.minimum)
        if quantity.maximum is not None:
            new_value = min(new_value, quantity.maximum)
        changes[name] = new_value
    return changes


def _scale_by_unit(parameter: str, value: float, scale: float, robot: Robot) -> float:
    """Return a value scaled by the unit in its name, up to the robot's limits."""
    drive = robot.drive
    if parameter.endswith("_per_m"):
        return value / scale
    if parameter.endswith("_mps2"):
        return min(scale * value, drive.max_acceleration_m_s2)
    if parameter.endswith("_radps2"):
        return min(value, drive.max_yaw_acceleration_rad_s2)
    if parameter.endswith("_radps"):
        return min(value, drive.max_yaw_rate_rad_s)
    if parameter.endswith("_mps"):
        fastest_reverse = min(drive.max_reverse_m_s, drive.max_speed_m_s)
        return min(max(scale * value, -fastest_reverse), drive.max_speed_m_s)
    # The lidar is where the robot has it, whatever the robot's size.
    is_length = parameter.endswith("_m") and parameter not in _LIDAR_FIELDS
    return scale * value if is_length else value


def _fit_dwa(config: Checked, robot: Robot, scale: float) -> dict[str, float]:
    """Return DWA's window period and, in meters, obstacle weight 0; {} without DWA."""
    dwa = getattr(config, "dwa", None)
    if dwa is None:
        return {}

    # A robot that accelerates slowly needs a window that opens for longer. Otherwise
    # it would sample only creeping speeds from rest.
    slowness = max(
        1.0, scale * dwa.acceleration_mps2 / robot.drive.max_acceleration_m_s2
    )
    changes = {"dwa.window_period_s": min(slowness * dwa.window_period_s, 1.0)}

    # With distances in meters, the cost under the footprint's edges would outweigh all
    # progress that a rollout can make.
    if dwa.distances_in_metres:
        changes["dwa.obstacle_weight"] = 0.0
    return changes


def _fit_costmap(
    costmap: CostmapConfig, robot: Robot, scale: float
) -> dict[str, float | str]:
    """Return footprint (m) and inflation of a costmap for a robot, by parameter.

    The footprint covers the same shares of the robot's length and width as it covers of
    the Jackal's. The inflation beyond the inscribed radius grows with the robot.
    """
    share_x = 2.0 * costmap.footprint_half_length_m / STANDARD_ROBOT.length_m
    share_y = 2.0 * costmap.footprint_half_width_m / STANDARD_ROBOT.width_m
    corners = [(share_x * x, share_y * y) for x, y in robot.chassis.hull_m]
    half_x, half_y = _half_sizes(corners)
    changes: dict[str, float | str] = {
        "footprint_half_length_m": half_x,
        "footprint_half_width_m": half_y,
    }
    # Half sizes are enough for a rectangle along the axes that is centered on 0.
    is_rectangle = len(corners) == 4 and all(
        abs(abs(x) - half_x) < 1e-9 and abs(abs(y) - half_y) < 1e-9 for x, y in corners
    )
    if not is_rectangle:
        changes["footprint"] = format_footprint(corners)

    padding_m = scale * costmap.footprint_padding_m
    padded = changes | {"footprint_padding_m": padding_m}
    inscribed_m = replace_dotted(costmap, padded, "costmap").inscribed_m

    # If base_link is nearer to the front or back than to the sides, the global plan
    # still keeps half the width away from obstacles. Otherwise it would lead through
    # gaps that are too narrow.
    half_width_m = half_y + padding_m
    if (
        isinstance(costmap, GlobalCostmapConfig)
        and half_width_m > inscribed_m + 1e-9
        and not robot.chassis.is_round
    ):
        inscribed_m = half_width_m
        changes["inscribed_radius_m"] = inscribed_m

    inflation_m = costmap.inflation_radius_m - costmap.inscribed_m
    changes["inflation_radius_m"] = inscribed_m + scale * inflation_m
    return changes


def _fit_body(config: Checked, robot: Robot) -> dict[str, float]:
    """Return a robot's sizes in m for those size parameters that `config` has."""
    half_x, half_y = _half_sizes(robot.chassis.hull_m)
    inscribed_m = robot.chassis.inscribed_m
    circumscribed_m = robot.chassis.circumscribed_m
    sizes = {
        "half_length_m": half_x,
        "half_width_m": half_y,
        "turning_radius_m": circumscribed_m,
    }

    changes: dict[str, float] = {}
    for name, _, value in fields_of(config):
        parameter = _last_part(name)
        if parameter in sizes:
            changes[name] = sizes[parameter]
        elif parameter == "robot_radius_m":
            # As far between the inscribed and the circumscribed radius as the Jackal's.
            jackal = STANDARD_ROBOT.chassis
            jackal_span_m = jackal.circumscribed_m - jackal.inscribed_m
            share = (value - jackal.inscribed_m) / jackal_span_m
            changes[name] = inscribed_m + share * (circumscribed_m - inscribed_m)
    return changes


def _half_sizes(corners: Sequence[Corner]) -> tuple[float, float]:
    """Return half length and width of the rectangle about 0 that covers all corners."""
    return max(abs(x) for x, _ in corners), max(abs(y) for _, y in corners)
