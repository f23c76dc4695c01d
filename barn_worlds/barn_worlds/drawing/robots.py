"""Draws a robot from above: outline, wheels, casters, center of mass and lidar."""

import math

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch, Polygon, Rectangle, Wedge

from barn_worlds.drawing import palette
from barn_worlds.robots.robot import Robot

# Shares of the robot's longer side: the margin around it, and the radius to which the
# lidar's field of view is drawn.
_MARGIN = 0.35
_VIEW_RADIUS = 0.6


def robot_figure(robot: Robot) -> Figure:
    """Return a matplotlib figure of a robot from above in base_link, x to the right."""
    figure = Figure(figsize=(6.4, 5.6), layout="constrained")
    axes = figure.add_subplot()
    _draw_lidar(axes, robot)
    _draw_body(axes, robot)
    axes.plot(
        0.0,
        0.0,
        marker="+",
        color=palette.OBSTACLE,
        markersize=12,
        linestyle="",
        label="base_link",
    )
    x, y, _ = robot.chassis.centre_of_mass_m
    axes.plot(
        x, y, marker="x", color=palette.GOAL, linestyle="", label="center of mass"
    )

    left, low, right, high = robot.chassis.extent_m
    margin = _MARGIN * max(robot.length_m, robot.width_m)
    axes.set(
        xlim=(left - margin, right + margin),
        ylim=(low - margin, high + margin),
        aspect="equal",
        xlabel="x, forward [m]",
        ylabel="y, left [m]",
    )
    axes.set_title(
        f"{robot.name}: {robot.length_m:.3f} x {robot.width_m:.3f} m, "
        f"{robot.chassis.mass_kg:.3g} kg"
    )
    figure.legend(loc="outside lower center", ncols=3, fontsize="small")
    return figure


def _draw_body(axes: Axes, robot: Robot) -> None:
    """Draw footprint, wheels and casters of a robot onto axes in base_link."""
    chassis = robot.chassis
    outline: Patch
    if chassis.is_round:
        outline = Circle((0.0, 0.0), chassis.footprint_radius_m)
    else:
        outline = Polygon(chassis.footprint_m)
    outline.set(
        # Translucent, so that the lidar's field of view stays visible.
        facecolor=palette.WHITE + "b0",
        edgecolor=palette.OBSTACLE,
        linewidth=1.5,
        label="footprint",
        zorder=2,
    )
    axes.add_patch(outline)

    radius = chassis.wheel_radius_m
    width = chassis.wheel_width_m
    # Only the first wheel and caster have a label, so that the legend names each once.
    label = "wheel"
    for x, y, _ in chassis.wheels_m:
        # From above a wheel is as long as its diameter.
        corner = (x - radius, y - 0.5 * width)
        wheel = Rectangle(
            corner, 2.0 * radius, width, facecolor=palette.HOLLOW, zorder=3, label=label
        )
        axes.add_patch(wheel)
        label = ""

    label = "caster"
    for center in chassis.casters_m:
        caster = Circle(
            center, 0.5 * width, facecolor=palette.START, zorder=3, label=label
        )
        axes.add_patch(caster)
        label = ""


def _draw_lidar(axes: Axes, robot: Robot) -> None:
    """Draw position and field of view of a robot's lidar onto axes in base_link."""
    lidar = robot.lidar
    # matplotlib takes degrees, counterclockwise from x like the suite.
    first_deg = math.degrees(lidar.angle_min_rad + lidar.mount_yaw_rad)
    last_deg = math.degrees(lidar.angle_max_rad + lidar.mount_yaw_rad)
    center = (lidar.mount_x_m, lidar.mount_y_m)
    field_of_view = Wedge(
        center,
        _VIEW_RADIUS * max(robot.length_m, robot.width_m),
        first_deg,
        last_deg,
        facecolor=palette.INFLATED,
        edgecolor=palette.SCAN,
        zorder=1,
    )
    axes.add_patch(field_of_view)
    axes.plot(
        *center,
        marker="o",
        color=palette.SCAN,
        linestyle="",
        zorder=4,
        label=f"lidar, {last_deg - first_deg:.0f}°, {lidar.range_max_m:g} m",
    )
