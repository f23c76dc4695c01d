"""The robot that is meant where none is named: presets and protocols are made for it, and it is left out of results."""

from barn_worlds.robots.files import load_robot
from barn_worlds.robots.robot import Chassis

STANDARD = load_robot("jackal")


def other_name(chassis: Chassis) -> str:
    """Return the name of a robot, empty if it is the one that is meant where none is named."""
    return "" if chassis == STANDARD.chassis else chassis.name
