"""Generates worlds and whole data sets from a seed (paper, Sec. III-A)."""

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from barn_worlds.base.arrays import BoolGrid, strict_kernel
from barn_worlds.base.config import Checked, as_dict, quantity
from barn_worlds.base.errors import ConfigError, WorldError
from barn_worlds.formats.dataset_file import WorldOrder, write_dataset_file
from barn_worlds.worlds.cspace import configuration_space
from barn_worlds.worlds.path_planner import (
    INFLATION_CELLS,
    INFLATION_WEIGHT,
    LARGEST_TURN,
    plan_through,
)
from barn_worlds.worlds.world import Provenance, World

LARGEST_GENERATED_SIDE = 500
MAX_WORLDS = 100_000
NARROWNESS = (
    "minus the mean distance in cells from the path's cells to the closest occupied "
    "C-space cell"
)

# Takes the number of worlds so far and the total.
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class WorldParameters(Checked):
    """Parameters that generate a world (paper, Sec. III-A and Table I)."""

    initial_fill: float = quantity(0.20, "share of cells filled at first", "", 0.0, 1.0)
    smoothing_iterations: int = quantity(
        3, "iterations of the cellular automaton", "", 0, 100
    )
    fill_threshold: int = quantity(
        5, "fewest filled neighbors that fill a cell", "", 0, 9
    )
    clear_threshold: int = quantity(
        1, "most filled neighbors that clear a cell", "", -1, 8
    )
    rows: int = quantity(
        30, "cells across, including the side walls", "", 3, LARGEST_GENERATED_SIDE
    )
    cols: int = quantity(
        30, "cells along the driving direction", "", 2, LARGEST_GENERATED_SIDE
    )
    resolution_m: float = quantity(0.15, "size of a cell", "m", 0.01, 10.0)
    footprint_cells: int = quantity(
        5, "side of the robot's square footprint in cells, odd", "", 1, 101
    )
    attempts: int = quantity(
        1_000_000, "most grids to try until one has a path", "", 1, 10_000_000
    )

    def check_rules(self) -> None:
        """Raise ConfigError for an even footprint or unordered thresholds."""
        self.require(self.footprint_cells % 2 == 1, "footprint_cells", "must be odd")
        self.require_order("clear_threshold", "below", "fill_threshold")


TABLE_I: tuple[WorldParameters, ...] = tuple(
    WorldParameters(initial_fill=fill, smoothing_iterations=count)
    for fill in (0.15, 0.20, 0.25, 0.30)
    for count in (2, 3, 4)
)


@dataclass(frozen=True)
class DatasetParameters(Checked):
    """Parameters that generate a data set; the defaults make the shipped barn300."""

    name: str = quantity("barn300", "name of the data set")
    seed: int = quantity(2020, "seed of all random numbers", "", 0, 2**63 - 1)
    worlds_per_set: int = quantity(
        25, "worlds to generate with each parameter set", "", 1, MAX_WORLDS
    )
    keep: int = quantity(
        0,
        "number of worlds to keep, spread evenly over their order; 0: all",
        "",
        0,
        MAX_WORLDS,
    )
    robot: str = quantity(
        "", "robot that the worlds are generated for; by default the Jackal"
    )
    sets: tuple[WorldParameters, ...] = TABLE_I

    def check_rules(self) -> None:
        """Raise ConfigError unless 1 to 100,000 worlds, and at least `keep`, result."""
        if not 1 <= self.world_count <= MAX_WORLDS:
            raise ConfigError(
                f"sets and worlds_per_set must make 1 to {MAX_WORLDS} worlds"
            )
        self.require(
            self.keep <= self.world_count,
            "keep",
            f"must be at most the {self.world_count} generated worlds",
        )

    @property
    def world_count(self) -> int:
        """Number of worlds that all sets make, before `keep` selects some."""
        return self.worlds_per_set * len(self.sets)


def generate_world(
    parameters: WorldParameters,
    generator: np.random.Generator,
    name: str = "generated",
    *,
    seed: tuple[int, ...] = (),
) -> World:
    """Return the first drawn grid with a path as a world; WorldError after `attempts`.

    Args:
        parameters: Cellular automaton, size and footprint.
        generator: Source of all randomness. Only its method `random` is used, whose
            stream NumPy is least likely to change.
        name: Name of the world.
        seed: What `generator` was seeded with, for the provenance.

    Raises:
        WorldError: If none of `parameters.attempts` grids has a path through.
    """
    for _ in range(parameters.attempts):
        *_, grid = automaton_grids(parameters, generator)
        cspace = configuration_space(grid, parameters.footprint_cells)
        # The order of draws is part of a data set: the grid, then start, then goal.
        path = plan_through(cspace, lambda rows: int(generator.random() * len(rows)))
        if path is None:
            continue

        provenance = Provenance(
            "generated", "", as_dict(parameters), seed, path_source="planned"
        )
        cell_m = parameters.resolution_m
        return World(name, grid, path, cell_m, parameters.footprint_cells, provenance)

    raise WorldError(
        f"no passable world in {parameters.attempts} attempts with "
        f"initial_fill {parameters.initial_fill:g} and "
        f"footprint_cells {parameters.footprint_cells}; "
        "lower initial_fill or raise attempts"
    )


def generate_dataset(
    parameters: DatasetParameters, progress: Progress | None = None
) -> list[World]:
    """Generate all worlds of a data set, set after set; `keep` is not applied.

    World k of set s comes from SeedSequence(seed, spawn_key=(s, k)), so it does not
    depend on how many other worlds there are.

    Args:
        parameters: Parameter sets, number of worlds and seed.
        progress: Called after each world.
    """
    worlds: list[World] = []
    for set_number, world_parameters in enumerate(parameters.sets):
        for number in range(parameters.worlds_per_set):
            key = (set_number, number)
            # A stream of its own for each world, whatever the others draw.
            sequence = np.random.SeedSequence(parameters.seed, spawn_key=key)
            world = generate_world(
                world_parameters,
                np.random.default_rng(sequence),
                f"{parameters.name}_{set_number}_{number}",
                seed=(parameters.seed, *key),
            )
            worlds.append(world)
            if progress is not None:
                progress(len(worlds), parameters.world_count)
    return worlds


def narrowness(world: World) -> float:
    """Return a proxy for difficulty: minus the path's mean distance from obstacles.

    Distances are in cells, from the path's cells to the closest occupied C-space cell.
    If nothing is occupied, it is minus the longer side of the grid.
    """
    occupied = np.argwhere(world.cspace)
    if len(occupied) == 0:
        return -float(max(world.grid.shape))

    distances = [np.hypot(*(occupied - cell).T).min() for cell in world.path]
    return -float(np.mean(distances))


def generate_ranked_dataset(
    parameters: DatasetParameters, progress: Progress | None = None
) -> tuple[list[World], WorldOrder]:
    """Generate worlds; return all, or `keep` of them by score, and narrowness scores.

    The widest and the narrowest world are always kept.

    Args:
        parameters: Parameter sets, number of worlds, how many to keep, and seed.
        progress: Called after each world.
    """
    worlds = generate_dataset(parameters, progress)
    scores = [narrowness(world) for world in worlds]
    if parameters.keep:
        # Stable, so that equal scores have the same order on every machine.
        ranking = np.argsort(scores, kind="stable")
        places = np.linspace(0, len(worlds) - 1, parameters.keep).round()
        selection = ranking[places.astype(np.int64)].tolist()
        worlds = [worlds[k] for k in selection]
        scores = [scores[k] for k in selection]
    return worlds, WorldOrder(NARROWNESS, tuple(scores))


def renumber(worlds: Sequence[World], order: WorldOrder) -> dict[int, World]:
    """Return copies numbered from 0 by rising score; WorldError unless all are finite.

    Args:
        worlds: The worlds; their copies are named world_0, world_1 and so on.
        order: One score per world.

    Raises:
        WorldError: If there is not one finite score for each world.
    """
    if len(order.scores) != len(worlds) or not np.isfinite(order.scores).all():
        raise WorldError(
            f"order by {order.by!r:.60} must have one finite score for each of "
            f"{len(worlds)} worlds"
        )

    numbered = {}
    for number, place in enumerate(np.argsort(order.scores, kind="stable")):
        numbered[number] = dataclasses.replace(worlds[place], name=f"world_{number}")
    return numbered


def write_dataset(
    target: Path,
    parameters: DatasetParameters | None = None,
    progress: Progress | None = None,
) -> None:
    """Generate a data set; write it, by narrowness, as .npz and .manifest.json.

    `write_dataset(Path("barn300.npz"))` makes the worlds that the package ships.

    Args:
        target: File to write.
        parameters: Parameter sets, number of worlds and seed.
        progress: Called after each world.
    """
    parameters = parameters or DatasetParameters()
    entries: dict[str, object] = {
        "seed": parameters.seed,
        "worlds_per_set": parameters.worlds_per_set,
    }
    if parameters.keep:
        entries["keep"] = parameters.keep
    if parameters.robot:
        entries["robot"] = parameters.robot
    # A later planner may find other paths through the same grids.
    entries["path_planner"] = {
        "search": "original",
        "largest_turn_steps": LARGEST_TURN,
        "inflation_cells": INFLATION_CELLS,
        "inflation_weight": INFLATION_WEIGHT,
    }
    worlds, order = generate_ranked_dataset(parameters, progress)
    write_ordered(target, parameters.name, worlds, order, entries)


def write_ordered(
    target: Path,
    name: str,
    worlds: Sequence[World],
    order: WorldOrder,
    entries: Mapping[str, object],
) -> None:
    """Write worlds, numbered by rising score, as .npz and .manifest.json.

    Args:
        target: File to write, .npz.
        name: Name of the data set.
        worlds: In the order of the scores.
        order: One score per world.
        entries: Further entries of the manifest.
    """
    numbered = renumber(worlds, order)
    # `renumber` has sorted the worlds by these scores.
    manifest_order = {"by": order.by, "scores": sorted(order.scores)}
    write_dataset_file(target, name, numbered, {**entries, "order": manifest_order})


def automaton_grids(
    parameters: WorldParameters, generator: np.random.Generator
) -> Iterator[BoolGrid]:
    """Yield a random grid, then that after each smoothing, both end rows always filled.

    Args:
        parameters: Fill, cellular automaton and size.
        generator: Source of all randomness.
    """
    shape = (parameters.rows, parameters.cols)
    grid: BoolGrid = generator.random(shape) < parameters.initial_fill
    # The side walls; with the paper's thresholds smoothing keeps them filled anyway.
    grid[[0, -1]] = True
    yield grid
    for _ in range(parameters.smoothing_iterations):
        grid = smooth(grid, parameters.fill_threshold, parameters.clear_threshold)
        grid[[0, -1]] = True
        yield grid


@strict_kernel
def smooth(grid: BoolGrid, fill_threshold: int, clear_threshold: int) -> BoolGrid:
    """Return a new grid after one step of the cellular automaton on all cells at once.

    Cells above the first and below the last row count as filled, corners included.
    Cells beside the first and the last column count as free.

    Args:
        grid: (rows, cols), True where filled.
        fill_threshold: A cell with at least this many filled cells among its 8
            neighbors is filled.
        clear_threshold: A cell with at most this many is cleared; all others stay.
    """
    rows, cols = grid.shape
    smoothed = np.empty((rows, cols), np.bool_)
    for row in range(rows):
        for column in range(cols):
            is_filled = grid[row, column]
            # The loop below counts the cell itself as well.
            neighbors = -int(is_filled)
            for r in range(row - 1, row + 2):
                for c in range(column - 1, column + 2):
                    neighbors += r < 0 or r >= rows or (0 <= c < cols and grid[r, c])
            stays_filled = is_filled and neighbors > clear_threshold
            smoothed[row, column] = neighbors >= fill_threshold or stays_filled
    return smoothed
