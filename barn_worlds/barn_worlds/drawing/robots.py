"""A picture of a robot from above: outline, wheels, casters, centre of mass and lidar."""

import math
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle, Wedge

from barn_worlds.drawing.palette import (
    GOAL,
    HOLLOW,
    INFLATED,
    OBSTACLE,
    SCAN,
    START,
    WHITE,
)
from barn_worlds.robots.robot import Robot

_BEYOND = 0.35  # of the longer side, that is drawn around the robot
_SEEN = 0.6  # of the longer side, to which the field of view is drawn


def robot_figure(robot: Robot) -> Figure:
    """Return a picture of a robot from above in base_link, x to the right."""
    figure = Figure(figsize=(6.4, 5.6), layout="constrained")
    axes = figure.add_subplot()
    _draw_lidar(axes, robot)
    _draw_body(axes, robot)
    axes.plot(
        0.0,
        0.0,
        marker="+",
        color=OBSTACLE,
        markersize=12,
        linestyle="",
        label="base_link",
    )
    x, y, _ = robot.chassis.centre_of_mass_m
    axes.plot(x, y, marker="x", color=GOAL, linestyle="", label="centre of mass")
    left, low, right, high = robot.chassis.extent_m
    around = _BEYOND * max(robot.length_m, robot.width_m)
    axes.set(
        xlim=(left - around, right + around),
        ylim=(low - around, high + around),
        aspect="equal",
    )
    axes.set(xlabel="x, forward [m]", ylabel="y, left [m]")
    axes.set_title(
        f"{robot.name}: {robot.length_m:.3f} x {robot.width_m:.3f} m, {robot.chassis.mass_kg:.3g} kg"
    )
    figure.legend(loc="outside lower center", ncols=3, fontsize="small")
    return figure


def _draw_body(axes: Axes, robot: Robot) -> None:
    chassis = robot.chassis
    look: Any = {
        "facecolor": WHITE + "b0",
        "edgecolor": OBSTACLE,
        "linewidth": 1.5,
        "label": "footprint",
        "zorder": 2,
    }
    outline = (
        Circle((0.0, 0.0), chassis.footprint_radius_m, **look)
        if chassis.is_round
        else None
    )
    axes.add_patch(outline or Polygon(chassis.footprint_m, **look))
    radius, width = chassis.wheel_radius_m, chassis.wheel_width_m
    for k, (x, y, _) in enumerate(chassis.wheels_m):
        place, label = (x - radius, y - 0.5 * width), "" if k else "wheel"
        axes.add_patch(
            Rectangle(
                place, 2.0 * radius, width, facecolor=HOLLOW, zorder=3, label=label
            )
        )
    for k, place in enumerate(chassis.casters_m):
        axes.add_patch(
            Circle(
                place,
                0.5 * width,
                facecolor=START,
                zorder=3,
                label="" if k else "caster",
            )
        )


def _draw_lidar(axes: Axes, robot: Robot) -> None:
    lidar = robot.lidar
    first, last = (
        math.degrees(angle + lidar.mount_yaw_rad)
        for angle in (lidar.angle_min_rad, lidar.angle_max_rad)
    )
    reach = _SEEN * max(robot.length_m, robot.width_m)
    place = lidar.mount_x_m, lidar.mount_y_m
    name = f"lidar, {last - first:.0f}°, {lidar.range_max_m:g} m"
    axes.add_patch(
        Wedge(place, reach, first, last, facecolor=INFLATED, edgecolor=SCAN, zorder=1)
    )
    axes.plot(*place, marker="o", color=SCAN, linestyle="", zorder=4, label=name)
