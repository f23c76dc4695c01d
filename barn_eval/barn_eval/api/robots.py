"""Robots of the suite or of your own files, and their pictures."""

from pathlib import Path

from barn_eval.pages.figures import Plot
from barn_worlds.drawing.robots import robot_figure
from barn_worlds.robots.files import ROBOTS
from barn_worlds.robots.files import load_robot as load
from barn_worlds.robots.robot import Robot

__all__ = ["draw", "load", "names"]


def names() -> list[str]:
    """Return the names of the robots that come with the suite.

    For instance:

        barn.robots.load(barn.robots.names()[0]).drive.max_speed_m_s
    """
    return list(ROBOTS)


def draw(robot: Robot | str | Path) -> Plot:
    """Return a plot of a robot from above, in frame base_link with x to the right.

    Args:
        robot: Name, YAML file or object of the robot.

    Raises:
        BarnError: If the name is not known, or the file describes no robot.
    """
    if not isinstance(robot, Robot):
        robot = load(robot)
    return Plot(robot_figure(robot), robot.name)
