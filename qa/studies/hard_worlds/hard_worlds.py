"""The search for hard worlds: grids of one kind are drawn until one has a proven path.

The path is proven by geometry alone, for the turned footprint of one robot. No planner
takes part, so the worlds favor none.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from footprint_lattice import POINTS_PER_CELL, build_lattice, path_cells
from hard_grids import GRID_KINDS, GridSketch

from barn_worlds.base.arrays import BoolGrid, Floats
from barn_worlds.base.config import Checked, as_dict, quantity
from barn_worlds.base.errors import WorldError
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.world import Provenance, World

KINDS = tuple(GRID_KINDS)
LEAD_IN_CELLS = 14  # free columns in front of the field, where a proven path begins
LEAD_OUT_CELLS = 8  # free columns behind it
_DRIVING_DIRECTION = 4  # heading of the lattice along the columns


@dataclass(frozen=True)
class HardParameters(Checked):
    """What a hard world is generated with; cells have the size that suits the robot."""

    kind: str = quantity("doors", "what makes it hard", choices=KINDS)
    rows: int = quantity(30, "cells across, including the side walls", "", 24, 100)
    cols: int = quantity(45, "cells along the driving direction", "", 24, 200)
    resolution_m: float = quantity(0.15, "size of a cell", "m", 0.01, 10.0)
    margin_cells: float = quantity(
        0.3, "space that the proven path leaves on every side, in cells", "", 0.0, 2.0
    )
    spare_cells: int = quantity(
        2, "most cells that a passage is wider than the narrowest", "", 0, 10
    )
    attempts: int = quantity(
        1000, "most grids to try until one has a path through", "", 1, 1_000_000
    )


def generate_hard_world(
    parameters: HardParameters,
    robot: Robot,
    generator: np.random.Generator,
    name: str,
    seed: tuple[int, ...] = (),
) -> World:
    """Return a random world whose path is proven for the turned footprint of a robot.

    Args:
        parameters: Kind and sizes.
        robot: The robot that the path is proven for.
        generator: Source of all randomness; only its method `random` is used.
        name: Name of the world.
        seed: What `generator` was seeded with, for the provenance.

    Raises:
        WorldError: If none of the grids has a path.
    """
    cell_m = parameters.resolution_m
    margin_m = parameters.margin_cells * cell_m
    narrowest_cells = math.ceil((robot.width_m + 2.0 * margin_m) / cell_m - 1e-6)
    shape = (parameters.rows, parameters.cols)

    for _ in range(parameters.attempts):
        sketch = GridSketch(shape, narrowest_cells, parameters.spare_cells, generator)
        GRID_KINDS[parameters.kind](sketch)
        poses = prove_path(sketch.grid, cell_m, robot, margin_m)
        if poses is None:
            continue

        # The world's path is the part inside the field: after the last cell of the
        # lead-in and before the first cell of the lead-out.
        cells = path_cells(poses) - np.array([0, LEAD_IN_CELLS])
        first = np.flatnonzero(cells[:, 1] < 0)[-1] + 1
        end = np.flatnonzero(cells[:, 1] == parameters.cols)[0]
        provenance = Provenance(
            "generated",
            parameters=as_dict(parameters),
            seed=seed,
            path_source="planned",
        )
        return World(
            name,
            sketch.grid,
            cells[first:end],
            cell_m,
            robot.footprint_cells(cell_m),
            provenance,
        )

    raise WorldError(
        f"no path through {parameters.attempts} worlds of kind {parameters.kind}; "
        "allow more attempts or spare_cells, or larger cells"
    )


def generate_hard_worlds(
    parameters: HardParameters,
    kinds: Sequence[str],
    worlds_per_kind: int,
    seed: int,
    robot: Robot,
    name: str,
    progress: Callable[[int, int], None] | None = None,
) -> list[World]:
    """Return worlds of one or several kinds.

    World k of kind s comes from SeedSequence(seed, spawn_key=(s, k)), so it does not
    depend on how many worlds there are.

    Args:
        parameters: Sizes; `kind` is replaced by each of `kinds`.
        kinds: Some of `KINDS`.
        worlds_per_kind: Number of worlds of each kind.
        seed: Seed of all randomness.
        robot: The robot that paths are proven for.
        name: Worlds are named NAME_KIND_NUMBER.
        progress: Called after each world with the number of worlds so far and the
            total.
    """
    worlds = []
    for kind in kinds:
        kind_parameters = replace(parameters, kind=kind)
        for number in range(worlds_per_kind):
            key = (KINDS.index(kind), number)
            generator = np.random.default_rng(
                np.random.SeedSequence(seed, spawn_key=key)
            )
            world = generate_hard_world(
                kind_parameters,
                robot,
                generator,
                f"{name}_{kind}_{number}",
                seed=(seed, *key),
            )
            worlds.append(world)
            if progress is not None:
                progress(len(worlds), worlds_per_kind * len(kinds))

    return worlds


def prove_path(
    grid: BoolGrid, cell_m: float, robot: Robot, margin_m: float
) -> Floats | None:
    """Return a path of the turned footprint through a field, or None if there is none.

    The path leads from the middle in front of the field, straight ahead, to the middle
    behind it. The side walls continue in front, as in the containment of a world.

    Args:
        grid: The field (rows, cols), True where filled.
        cell_m: Size of a cell in m.
        robot: The robot that drives.
        margin_m: Distance that the footprint keeps from every cylinder.

    Returns:
        Poses (n, 3): x and y in cells from the corner of the lead-in, yaw in rad.
    """
    corridor = np.pad(grid, ((0, 0), (LEAD_IN_CELLS, LEAD_OUT_CELLS)))
    corridor[[0, -1], :LEAD_IN_CELLS] = True

    middle = POINTS_PER_CELL * grid.shape[0] // 2
    end = POINTS_PER_CELL * (corridor.shape[1] - 3)
    lattice = build_lattice(corridor, cell_m, robot.chassis, margin_m)
    return lattice.find_path((middle, 0, _DRIVING_DIRECTION), (middle, end))
