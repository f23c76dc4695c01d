"""Which estimate of its pose in the map a robot has, and in which map."""

import math
from dataclasses import replace

import numpy as np

from barn_sim.config import SimulatorConfig
from barn_sim.sensors.estimates import FilterLocalisation
from barn_sim.sensors.particles import ParticleLocalisation
from barn_worlds.base.types import OccupancyMap, Pose2D
from barn_worlds.worlds.cells import STANDARD_CELL_M
from barn_worlds.worlds.world import World


def known_map(world: World, historical: bool) -> OccupancyMap:
    """Return the map to localise in; worlds of other cells never had a historical one, theirs is off as a whole."""
    standard = math.isclose(world.resolution_m, STANDARD_CELL_M)
    known = world.occupancy_map(historical=historical and standard)
    off_m = -STANDARD_CELL_M if historical and not standard else 0.0
    return replace(known, origin_y=known.origin_y + off_m)


def localisation_of(
    config: SimulatorConfig, world: World, start: Pose2D, mount: Pose2D, rng: np.random.Generator
) -> FilterLocalisation | ParticleLocalisation | None:
    """Return what estimates the pose in the map, None if the pose is exact."""
    localisation = config.localisation
    if localisation.mode == "amcl":
        return FilterLocalisation(localisation, rng)
    if localisation.mode == "particles":
        return ParticleLocalisation(localisation, rng, known_map(world, localisation.historical_map), start, mount)
    return None
