"""Robots from Python: those that come with the suite, files of one's own, and their pictures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from barn_worlds.robots.files import ROBOTS, load_robot

if TYPE_CHECKING:
    from barn_eval.pages.figures import Plot
    from barn_worlds.robots.robot import Robot


def robots() -> dict[str, Robot]:
    """Return the robots that come with the suite and can be simulated, by name.

    For instance:

        barn.robots()["husky"].drive.max_speed_m_s
    """
    return dict(ROBOTS)


def draw_robot(robot: Robot | str | Path) -> Plot:
    """Return a picture of a robot from above; robot: its name, its YAML file, or the robot itself."""
    from barn_eval.pages.figures import Plot  # noqa: PLC0415 (matplotlib)
    from barn_worlds.drawing.robots import robot_figure  # noqa: PLC0415

    found = load_robot(robot) if isinstance(robot, (str, Path)) else robot
    return Plot(robot_figure(found), found.name)
