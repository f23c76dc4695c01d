"""The parameters that worlds are generated with, and the paper's twelve sets of them."""

import math
from dataclasses import dataclass

from barn_worlds.base.config import Checked, quantity
from barn_worlds.robots.robot import Robot
from barn_worlds.robots.standard import STANDARD

LARGEST_GENERATED_SIDE = 500


@dataclass(frozen=True)
class WorldParameters(Checked):
    """What a world is generated with (paper, section III-A and Table I)."""

    initial_fill: float = quantity(0.20, "initial share of filled cells", minimum=0.0, maximum=1.0)
    smoothing_iterations: int = quantity(3, "iterations of the cellular automaton", minimum=0, maximum=100)
    fill_threshold: int = quantity(5, "filled neighbours that make a cell filled, at least", minimum=0, maximum=9)
    clear_threshold: int = quantity(1, "filled neighbours that make a cell free, at most", minimum=-1, maximum=8)
    rows: int = quantity(30, "cells across, side walls included", minimum=3, maximum=LARGEST_GENERATED_SIDE)
    cols: int = quantity(30, "cells along the driving direction", minimum=2, maximum=LARGEST_GENERATED_SIDE)
    resolution_m: float = quantity(0.15, "size of a cell", "m", minimum=0.01, maximum=10.0)
    footprint_cells: int = quantity(5, "odd side of the robot's square footprint", minimum=1, maximum=101)
    attempts: int = quantity(1_000_000, "grids tried until one has a way through", minimum=1, maximum=10_000_000)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require(self.footprint_cells % 2 == 1, "footprint_cells", "must be odd")
        below = f"must be below fill_threshold ({self.fill_threshold})"
        self.require(self.clear_threshold < self.fill_threshold, "clear_threshold", below)


def cell_m(robot: Robot) -> float:
    """Return the size of a cell in worlds for a robot: the Jackal's 0.15 m in its own size, in whole millimetres.

    The robot then takes as many cells as the Jackal, 5 x 5, and passages are as wide for it.
    """
    standard_m, own_m = WorldParameters().resolution_m, STANDARD.reach_m
    return math.ceil(1000.0 * standard_m * robot.reach_m / own_m - 1e-6) / 1000.0


TABLE_I: tuple[WorldParameters, ...] = tuple(
    WorldParameters(initial_fill=fill, smoothing_iterations=iterations)
    for fill in (0.15, 0.20, 0.25, 0.30)
    for iterations in (2, 3, 4)
)
