"""The part of a robot that can touch obstacles, as a footprint."""

from functools import cache

import numpy as np

from barn_worlds.geometry.footprint import Footprint, Rectangle
from barn_worlds.robots.robot import Chassis


@cache
def contact_footprint(chassis: Chassis) -> Footprint:
    """Return the outline, in base_link, of everything that can touch an obstacle.

    That is the hull of the footprint. Where the file of the robot gives a smaller box
    for the body, it is the rectangle around that box and the wheels.
    """
    if chassis.is_rectangular:
        return Rectangle(chassis.contact_extent_m)
    return Footprint(np.array(chassis.hull_m), chassis.footprint_radius_m)
