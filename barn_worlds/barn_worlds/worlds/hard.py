"""Worlds of narrow passages, dead ends, doors behind turns and cluttered ground, by geometry alone.

Each world is of one kind and gets a way that `barn_worlds.worlds.oriented` proves for the robot's turned footprint with
a margin; what has none is drawn again. No planner has a say in it.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from barn_worlds.base.arrays import BoolGrid, Floats
from barn_worlds.base.config import Checked, as_dict, quantity, replace_dotted
from barn_worlds.base.errors import WorldError
from barn_worlds.datasets.generate import cell_size_m
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.oriented import POINTS_PER_CELL, cells_of, lattice
from barn_worlds.worlds.world import Provenance, World

KINDS = ("doors", "dead_ends", "turns", "clutter")
ALL = "all"
_AHEAD, _AFTER = (
    14,
    8,
)  # free cells that a way begins and ends with, before and after the field
_NORTH = 4  # heading of the lattice along columns


@dataclass(frozen=True)
class HardParameters(Checked):
    """What a hard world is generated with; lengths that are counted in cells are for the robot's size of cells."""

    kind: str = quantity("doors", "what makes it hard", choices=KINDS)
    rows: int = quantity(30, "cells across, side walls included", "", 24, 100)
    cols: int = quantity(45, "cells along the driving direction", "", 24, 200)
    resolution_m: float = quantity(0.15, "size of a cell", "m", 0.01, 10.0)
    margin_cells: float = quantity(
        0.3, "room that the proven way leaves on every side, in cells", "", 0.0, 2.0
    )
    spare_cells: int = quantity(
        2, "most cells that a passage is wider than the narrowest", "", 0, 10
    )
    attempts: int = quantity(
        1000, "grids tried until one has a way through", "", 1, 1_000_000
    )


class Draw:
    """A grid that is being drawn, with its random numbers and the widths of its passages in cells."""

    def __init__(
        self, parameters: HardParameters, narrowest: int, generator: np.random.Generator
    ) -> None:
        self.grid: BoolGrid = np.zeros((parameters.rows, parameters.cols), np.bool_)
        self.grid[[0, -1]] = True  # the side walls
        self._narrowest, self._spare, self._generator = (
            narrowest,
            parameters.spare_cells,
            generator,
        )

    def whole(self, low: int, high: int) -> int:
        """Return a whole number, both ends included."""
        return low + int(self._generator.random() * (high - low + 1))

    def passage(self) -> int:
        """Return how many cells wide a passage is."""
        return self._narrowest + self.whole(0, self._spare)


def _doors(draw: Draw) -> None:
    """Draw one to three walls across the field, each door off the one before; a screen hides some of them."""
    rows, cols = draw.grid.shape
    column, before = draw.whole(4, 12), rows // 2
    for _ in range(draw.whole(1, 3)):
        wide = draw.passage()
        room = [
            row
            for row in range(1, rows - 1 - wide)
            if abs(row + wide // 2 - before) >= rows // 8
        ]
        door = room[draw.whole(0, len(room) - 1)]
        draw.grid[:, column] = True
        draw.grid[door : door + wide, column] = False
        if draw.whole(0, 1):
            reach, front = draw.whole(1, 4), column - draw.passage() - 1
            draw.grid[max(1, door - reach) : door + wide + reach, max(front, 0)] = True
        before = door + wide // 2
        column += draw.whole(10, 13)
        if column > cols - 2:
            return


def _dead_ends(draw: Draw) -> None:
    """Draw one or two bays across the way that open towards the start, some with a wall that splits them."""
    rows, cols = draw.grid.shape
    column = draw.whole(2, 10)
    for _ in range(draw.whole(1, 2)):
        end, room = min(column + draw.whole(4, 12), cols - 1), draw.passage()
        left, right = draw.whole(0, rows // 2 - 4), draw.whole(rows // 2 + 4, rows - 1)
        if (
            left <= room and rows - 1 - right <= room
        ):  # else it would leave no way on either side
            left, right = (
                (room + 1, rows - 1) if draw.whole(0, 1) else (0, rows - 2 - room)
            )
        draw.grid[left : right + 1, end] = True
        draw.grid[[left, right], column : end + 1] = True
        if draw.whole(0, 1):
            draw.grid[(left + right) // 2, end - draw.whole(2, 4) : end + 1] = True
        column = end + draw.whole(7, 10)
        if column > cols - 6:
            return


def _turns(draw: Draw) -> None:
    """Draw a corridor that winds from side to side past two to five walls, and stubs that narrow it."""
    rows, cols = draw.grid.shape
    column, side = draw.whole(4, 12), draw.whole(0, 1)
    for _ in range(draw.whole(2, 5)):
        wide = draw.passage() + draw.whole(0, rows // 4)
        draw.grid[:, column] = True
        draw.grid[
            slice(1, 1 + wide) if side else slice(rows - 1 - wide, rows - 1), column
        ] = False
        after = column + draw.passage() + draw.whole(2, 4)
        if draw.whole(0, 1):
            place, stub = draw.whole(9, rows - 11), after - draw.passage()
            draw.grid[place : place + 2, column:stub] = True
        column, side = after, 1 - side
        if column > cols - 2:
            return


def _clutter(draw: Draw) -> None:
    """Draw small things, at least a passage apart, and pockets among them that open to any side."""
    rows, cols = draw.grid.shape
    for _ in range(draw.whole(0, 3)):
        pocket = np.ones((draw.whole(7, 10), draw.whole(6, 8)), np.bool_)
        pocket[1:-1, :-1] = False  # open to the start
        _place(draw, np.rot90(pocket, (0, 0, 1, 3)[draw.whole(0, 3)]), 40)
    for _ in range(rows * cols // 4):
        _place(draw, np.ones((draw.whole(1, 2), draw.whole(1, 2)), np.bool_), 1)


def _place(draw: Draw, thing: BoolGrid, attempts: int) -> None:
    """Put a thing where all others and the side walls are at least a passage away, if there is such a place."""
    rows, cols = (
        side - size for side, size in zip(draw.grid.shape, thing.shape, strict=True)
    )
    for _ in range(attempts):
        row, column, gap = draw.whole(1, rows - 1), draw.whole(0, cols), draw.passage()
        high, far = row + thing.shape[0], column + thing.shape[1]
        if not draw.grid[
            max(0, row - gap) : high + gap, max(0, column - gap) : far + gap
        ].any():
            draw.grid[row:high, column:far] |= thing
            return


_DRAWN = dict(zip(KINDS, (_doors, _dead_ends, _turns, _clutter), strict=True))


def hard_world(
    parameters: HardParameters,
    robot: Robot,
    generator: np.random.Generator,
    name: str,
    seed: tuple[int, ...] = (),
) -> World:
    """Return a random world with a way proven for the robot's turned footprint as its path.

    generator: only `random` is used. seed: what it was seeded with, for the provenance. Raises WorldError if none of
    the grids tried has a way.
    """
    side_m, margin_m = (
        parameters.resolution_m,
        parameters.margin_cells * parameters.resolution_m,
    )
    narrowest = math.ceil((robot.width_m + 2.0 * margin_m) / side_m - 1e-6)
    for _ in range(parameters.attempts):
        draw = Draw(parameters, narrowest, generator)
        _DRAWN[parameters.kind](draw)
        way = proven_way(draw.grid, side_m, robot, margin_m)
        if way is None:
            continue
        cells = cells_of(way) - np.array([0, _AHEAD])
        path = cells[
            np.flatnonzero(cells[:, 1] < 0)[-1] + 1 : np.flatnonzero(
                cells[:, 1] == parameters.cols
            )[0]
        ]
        about = Provenance(
            "generated",
            parameters=as_dict(parameters),
            seed=seed,
            path_source="planned",
        )
        return World(
            name, draw.grid, path, side_m, robot.footprint_cells(side_m), about
        )
    hint = "allow more attempts or spare_cells, or larger cells"
    raise WorldError(
        f"no way through {parameters.attempts} worlds of kind {parameters.kind}; {hint}"
    )


def hard_worlds(
    changes: Mapping[str, object], per_kind: int, seed: int, robot: Robot, name: str,
    progress: Callable[[int, int], None] | None = None,
) -> list[World]:  # fmt: skip
    """Return so many worlds of each kind, or of the one that `changes` names.

    World k of kind s is drawn from SeedSequence(seed, spawn_key=(s, k)), so it does not depend on how many others there
    are. changes: to `HardParameters`, by name; kind may be "all". Cells are in the robot's size (`generate.cell_m`).
    """
    kinds = KINDS if changes["kind"] == ALL else (changes["kind"],)
    worlds = []
    for kind in kinds:
        asked = {"resolution_m": cell_size_m(robot), **changes, "kind": kind}
        parameters = replace_dotted(
            HardParameters(), asked, "parameters of hard worlds"
        )
        for k in range(per_kind):
            key = KINDS.index(parameters.kind), k
            generator = np.random.default_rng(
                np.random.SeedSequence(seed, spawn_key=key)
            )
            called = f"{name}_{parameters.kind}_{k}"
            worlds.append(
                hard_world(parameters, robot, generator, called, seed=(seed, *key))
            )
            if progress is not None:
                progress(len(worlds), per_kind * len(kinds))
    return worlds


def proven_way(
    grid: BoolGrid, side_m: float, robot: Robot, margin_m: float
) -> Floats | None:
    """Return a way (n, 3) through a field, in cells from 14 in front of it, x and y, and yaw in rad; None without one.

    From the middle in front of it, ahead, to the middle behind it. The side walls go on in front, as the containment
    has them.
    """
    whole = np.pad(grid, ((0, 0), (_AHEAD, _AFTER)))
    whole[[0, -1], :_AHEAD] = True
    middle, end = (
        POINTS_PER_CELL * grid.shape[0] // 2,
        POINTS_PER_CELL * (whole.shape[1] - 3),
    )
    return lattice(whole, side_m, robot.chassis, margin_m).way(
        (middle, 0, _NORTH), (middle, end)
    )
