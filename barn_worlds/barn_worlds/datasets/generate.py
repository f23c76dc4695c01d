"""Generating worlds and whole data sets from a seed (paper, section III-A)."""

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numba import njit

from barn_worlds.base.arrays import BoolGrid
from barn_worlds.base.config import Checked, as_dict, quantity
from barn_worlds.base.errors import ConfigError, WorldError
from barn_worlds.formats.own import Order, write_own
from barn_worlds.robots.files import STANDARD
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.cspace import configuration_space, through_region
from barn_worlds.worlds.path_planner import (
    INFLATION_CELLS,
    INFLATION_WEIGHT,
    LARGEST_TURN,
    plan_path,
)
from barn_worlds.worlds.world import Provenance, World

LARGEST_GENERATED_SIDE = 500


@dataclass(frozen=True)
class WorldParameters(Checked):
    """What a world is generated with (paper, section III-A and Table I)."""

    initial_fill: float = quantity(0.20, "initial share of filled cells", "", 0.0, 1.0)
    smoothing_iterations: int = quantity(
        3, "iterations of the cellular automaton", "", 0, 100
    )
    fill_threshold: int = quantity(
        5, "filled neighbours that make a cell filled, at least", "", 0, 9
    )
    clear_threshold: int = quantity(
        1, "filled neighbours that make a cell free, at most", "", -1, 8
    )
    rows: int = quantity(
        30, "cells across, side walls included", "", 3, LARGEST_GENERATED_SIDE
    )
    cols: int = quantity(
        30, "cells along the driving direction", "", 2, LARGEST_GENERATED_SIDE
    )
    resolution_m: float = quantity(0.15, "size of a cell", "m", 0.01, 10.0)
    footprint_cells: int = quantity(
        5, "odd side of the robot's square footprint", "", 1, 101
    )
    attempts: int = quantity(
        1_000_000, "grids tried until one has a way through", "", 1, 10_000_000
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require(self.footprint_cells % 2 == 1, "footprint_cells", "must be odd")
        below = f"must be below fill_threshold ({self.fill_threshold})"
        self.require(
            self.clear_threshold < self.fill_threshold, "clear_threshold", below
        )


def cell_size_m(robot: Robot) -> float:
    """Return the size of a cell in worlds for a robot: the Jackal's 0.15 m in its own size, in whole millimetres.

    The robot then takes as many cells as the Jackal, 5 x 5, and passages are as wide for it.
    """
    standard_m, own_m = WorldParameters().resolution_m, STANDARD.reach_m
    return math.ceil(1000.0 * standard_m * robot.reach_m / own_m - 1e-6) / 1000.0


TABLE_I: tuple[WorldParameters, ...] = tuple(
    WorldParameters(initial_fill=fill, smoothing_iterations=automaton_grids)
    for fill in (0.15, 0.20, 0.25, 0.30)
    for automaton_grids in (2, 3, 4)
)


MOST_WORLDS = 100_000
NARROWNESS = "minus the mean distance in cells from the path's cells to the closest occupied C-space cell"


@dataclass(frozen=True)
class DatasetParameters(Checked):
    """What a data set is generated with; the defaults are those of the shipped barn300."""

    name: str = quantity("barn300", "name of the data set")
    seed: int = quantity(2020, "seed of all randomness", "", 0, 2**63 - 1)
    worlds_per_set: int = quantity(
        25, "worlds made with each parameter set", "", 1, MOST_WORLDS
    )
    keep: int = quantity(
        0,
        "worlds kept of those made, evenly spread over their order; 0: all",
        "",
        0,
        MOST_WORLDS,
    )
    robot: str = quantity(
        "", "robot that the worlds are made for, if it is not the Jackal"
    )
    sets: tuple[WorldParameters, ...] = TABLE_I

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.made <= MOST_WORLDS:
            raise ConfigError(
                f"sets and worlds_per_set must make 1 to {MOST_WORLDS} worlds"
            )
        self.require(
            self.keep <= self.made,
            "keep",
            f"must be at most the {self.made} worlds made",
        )

    @property
    def made(self) -> int:
        """Number of worlds that are made of all sets."""
        return self.worlds_per_set * len(self.sets)


def generate_world(
    parameters: WorldParameters,
    generator: np.random.Generator,
    name: str = "generated",
    *,
    seed: tuple[int, ...] = (),
) -> World:
    """Return a random world; WorldError if none of `parameters.attempts` grids has a way through.

    seed: what `generator` was seeded with, stored as provenance.
    """
    for _ in range(parameters.attempts):
        grid = generate_grid(parameters, generator)
        cspace = configuration_space(grid, parameters.footprint_cells)
        region = through_region(cspace)
        if region is None:
            continue
        # `random` alone, the stream that NumPy is least likely to change
        ends = [np.flatnonzero(region[:, column]) for column in (0, -1)]
        start, goal = (int(rows[int(generator.random() * len(rows))]) for rows in ends)
        path = plan_path(cspace, (start, 0), (goal, parameters.cols - 1))
        if path is not None:
            provenance = Provenance(
                "generated",
                parameters=as_dict(parameters),
                seed=seed,
                path_source="planned",
            )
            return World(
                name,
                grid,
                path,
                parameters.resolution_m,
                parameters.footprint_cells,
                provenance,
            )
    asked = f"initial_fill {parameters.initial_fill:g} and footprint_cells {parameters.footprint_cells}"
    hint = "fill less, or allow more attempts"
    raise WorldError(
        f"no passable world in {parameters.attempts} attempts with {asked}; {hint}"
    )


def generate_dataset(
    parameters: DatasetParameters, progress: Callable[[int, int], None] | None = None
) -> list[World]:
    """Return the worlds of a data set, one parameter set after the other.

    World k of set s is drawn from SeedSequence(seed, spawn_key=(s, k)), so it does not depend on how many other worlds
    there are. progress: called after each world with the number made so far and the total.
    """
    worlds: list[World] = []
    for s, k in itertools.product(
        range(len(parameters.sets)), range(parameters.worlds_per_set)
    ):
        generator = np.random.default_rng(
            np.random.SeedSequence(parameters.seed, spawn_key=(s, k))
        )
        name, seed = f"{parameters.name}_{s}_{k}", (parameters.seed, s, k)
        worlds.append(generate_world(parameters.sets[s], generator, name, seed=seed))
        if progress is not None:
            progress(len(worlds), parameters.made)
    return worlds


def narrowness(world: World) -> float:
    """Return minus the mean distance in cells from the path's cells to the closest occupied C-space cell.

    A simple proxy for difficulty. If nothing is occupied: minus the longer side of the grid.
    """
    occupied = np.argwhere(world.cspace)
    if len(occupied) == 0:
        return -float(max(world.grid.shape))
    closest = [np.hypot(*(occupied - cell).T).min() for cell in world.path]
    return -float(np.mean(closest))


def generate_ranked_dataset(
    parameters: DatasetParameters, progress: Callable[[int, int], None] | None = None
) -> tuple[list[World], Order]:
    """Return the worlds of a data set that are kept, and their order, which is that of rising narrowness.

    The first and the last in order are always among those kept.
    """
    worlds = generate_dataset(parameters, progress)
    scores = [narrowness(world) for world in worlds]
    kept = range(len(worlds))
    if parameters.keep:
        places = (
            np.linspace(0, len(worlds) - 1, parameters.keep).round().astype(np.int64)
        )
        kept = np.argsort(scores, kind="stable")[places].tolist()
    return [worlds[k] for k in kept], Order(NARROWNESS, tuple(scores[k] for k in kept))


def renumber(worlds: Sequence[World], order: Order) -> dict[int, World]:
    """Return the worlds by number, from 0, in rising order of score and named world_0, world_1 and so on."""
    if len(order.scores) != len(worlds) or not np.isfinite(order.scores).all():
        raise WorldError(
            f"order by {order.by!r:.60} must have one finite score for each of {len(worlds)} worlds"
        )
    ranked = np.argsort(order.scores, kind="stable")
    return {
        k: dataclasses.replace(worlds[i], name=f"world_{k}")
        for k, i in enumerate(ranked)
    }


def write_dataset(
    target: Path,
    parameters: DatasetParameters | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Generate a data set, number it by rising narrowness and write it as a .npz file with a manifest beside it.

    `write_dataset(Path("barn300.npz"))` makes the worlds that the package ships.
    """
    chosen = parameters or DatasetParameters()
    about: dict[str, object] = {
        "seed": chosen.seed,
        "worlds_per_set": chosen.worlds_per_set,
    }
    about |= {
        key: value
        for key, value in (("keep", chosen.keep), ("robot", chosen.robot))
        if value
    }
    inflated = {
        "inflation_cells": INFLATION_CELLS,
        "inflation_weight": INFLATION_WEIGHT,
    }
    about["path_planner"] = {
        "search": "original",
        "largest_turn_steps": LARGEST_TURN,
        **inflated,
    }
    write_ordered(
        target, chosen.name, *generate_ranked_dataset(chosen, progress), about
    )


def write_ordered(
    target: Path,
    name: str,
    worlds: Sequence[World],
    order: Order,
    about: Mapping[str, object],
) -> dict[int, World]:
    """Write worlds as a data set file, numbered by rising score, and return them.

    about: more entries for the manifest, beside the order.
    """
    numbered = renumber(worlds, order)
    write_own(
        target,
        name,
        numbered,
        {**about, "order": {"by": order.by, "scores": sorted(order.scores)}},
    )
    return numbered


def generate_grid(
    parameters: WorldParameters, generator: np.random.Generator
) -> BoolGrid:
    """Return a grid (rows, cols) of obstacles, True where filled."""
    *_, grid = automaton_grids(parameters, generator)
    return grid


def automaton_grids(
    parameters: WorldParameters, generator: np.random.Generator
) -> Iterator[BoolGrid]:
    """Yield the random grid and then the grid after each smoothing iteration (as in Fig. 1 of the paper)."""
    grid: BoolGrid = (
        generator.random((parameters.rows, parameters.cols)) < parameters.initial_fill
    )
    grid[[0, -1]] = True  # the side walls
    yield grid
    for _ in range(parameters.smoothing_iterations):
        grid = smooth(grid, parameters.fill_threshold, parameters.clear_threshold)
        grid[[0, -1]] = True  # with the paper's thresholds they stay filled anyway
        yield grid


@njit(cache=True)
def smooth(grid: BoolGrid, fill_threshold: int, clear_threshold: int) -> BoolGrid:
    """Return the grid after one iteration; every cell looks at the grid before it.

    A cell with at least `fill_threshold` filled cells among its 8 neighbours is filled. One with at most
    `clear_threshold` is cleared. Any other stays as it is. Cells above the first and below the last row count as filled
    (corners included), cells beside the first and the last column as free.
    """
    rows, cols = grid.shape
    smoothed = np.empty((rows, cols), np.bool_)
    for row in range(rows):
        for column in range(cols):
            filled = grid[row, column]
            neighbours = -int(filled)
            for r in range(row - 1, row + 2):
                for c in range(column - 1, column + 2):
                    neighbours += r < 0 or r >= rows or (0 <= c < cols and grid[r, c])
            smoothed[row, column] = neighbours >= fill_threshold or (
                filled and neighbours > clear_threshold
            )
    return smoothed
