"""Random grids with narrow passages, dead ends, turns or clutter.

The order of the random draws is part of the definition: the grids of a seed must stay
the same, since `barn_hard` is generated from one.
"""

from collections.abc import Callable, Mapping

import numpy as np

from barn_worlds.base.arrays import BoolGrid


class GridSketch:
    """A grid that obstacles are drawn into, and the random numbers that place them."""

    # (rows, cols), True where filled.
    grid: BoolGrid

    def __init__(
        self,
        shape: tuple[int, int],
        narrowest_cells: int,
        spare_cells: int,
        generator: np.random.Generator,
    ) -> None:
        """Start with an empty field between two side walls.

        Args:
            shape: Rows and columns of the grid.
            narrowest_cells: Width of the narrowest passage.
            spare_cells: How many cells a passage may be wider than that.
            generator: Source of all randomness; only its method `random` is used.
        """
        self.grid = np.zeros(shape, np.bool_)
        self.grid[[0, -1]] = True
        self._narrowest_cells = narrowest_cells
        self._spare_cells = spare_cells
        self._generator = generator

    def integer(self, low: int, high: int) -> int:
        """Draw an integer.

        Args:
            low: Smallest value.
            high: Largest value, included.
        """
        return low + int(self._generator.random() * (high - low + 1))

    def passage_cells(self) -> int:
        """Draw the width of a passage in cells."""
        return self._narrowest_cells + self.integer(0, self._spare_cells)

    def place(self, shape: BoolGrid, attempts: int) -> None:
        """Add an obstacle at least one passage away from everything else.

        Args:
            shape: Cells of the obstacle, True where filled.
            attempts: Places that are tried; if none is free, nothing is added.
        """
        last_row = self.grid.shape[0] - shape.shape[0] - 1
        last_column = self.grid.shape[1] - shape.shape[1]

        for _ in range(attempts):
            row = self.integer(1, last_row)
            column = self.integer(0, last_column)
            gap = self.passage_cells()

            end_row = row + shape.shape[0]
            end_column = column + shape.shape[1]
            neighborhood = self.grid[
                max(0, row - gap) : end_row + gap,
                max(0, column - gap) : end_column + gap,
            ]
            if not neighborhood.any():
                self.grid[row:end_row, column:end_column] |= shape
                return


def draw_doors(sketch: GridSketch) -> None:
    """Draw one to three walls with a door each, away from the door before it.

    A screen in front hides some of the doors.
    """
    rows, cols = sketch.grid.shape
    column = sketch.integer(4, 12)
    previous_door = rows // 2

    for _ in range(sketch.integer(1, 3)):
        width = sketch.passage_cells()
        places = [
            row
            for row in range(1, rows - 1 - width)
            if abs(row + width // 2 - previous_door) >= rows // 8
        ]
        door = places[sketch.integer(0, len(places) - 1)]
        sketch.grid[:, column] = True
        sketch.grid[door : door + width, column] = False

        if sketch.integer(0, 1):
            overhang = sketch.integer(1, 4)
            screen_column = max(column - sketch.passage_cells() - 1, 0)
            first_row = max(1, door - overhang)
            sketch.grid[first_row : door + width + overhang, screen_column] = True

        previous_door = door + width // 2
        column += sketch.integer(10, 13)
        if column > cols - 2:
            return


def draw_dead_ends(sketch: GridSketch) -> None:
    """Draw one or two bays that open toward the start; a wall splits some of them."""
    rows, cols = sketch.grid.shape
    column = sketch.integer(2, 10)

    for _ in range(sketch.integer(1, 2)):
        back = min(column + sketch.integer(4, 12), cols - 1)
        passage = sketch.passage_cells()
        left = sketch.integer(0, rows // 2 - 4)
        right = sketch.integer(rows // 2 + 4, rows - 1)

        # A bay this wide blocks both sides: move it to one side wall instead.
        if left <= passage and rows - 1 - right <= passage:
            if sketch.integer(0, 1):
                left = passage + 1
                right = rows - 1
            else:
                left = 0
                right = rows - 2 - passage

        sketch.grid[left : right + 1, back] = True
        sketch.grid[[left, right], column : back + 1] = True
        if sketch.integer(0, 1):
            divider = back - sketch.integer(2, 4)
            sketch.grid[(left + right) // 2, divider : back + 1] = True

        column = back + sketch.integer(7, 10)
        if column > cols - 6:
            return


def draw_turns(sketch: GridSketch) -> None:
    """Draw two to five walls that are open on alternating sides, with stubs between."""
    rows, cols = sketch.grid.shape
    column = sketch.integer(4, 12)
    opens_left = bool(sketch.integer(0, 1))

    for _ in range(sketch.integer(2, 5)):
        width = sketch.passage_cells() + sketch.integer(0, rows // 4)
        first_open = 1 if opens_left else rows - 1 - width
        sketch.grid[:, column] = True
        sketch.grid[first_open : first_open + width, column] = False

        next_column = column + sketch.passage_cells() + sketch.integer(2, 4)
        if sketch.integer(0, 1):
            row = sketch.integer(9, rows - 11)
            stub_end = next_column - sketch.passage_cells()
            sketch.grid[row : row + 2, column:stub_end] = True

        column = next_column
        opens_left = not opens_left
        if column > cols - 2:
            return


def draw_clutter(sketch: GridSketch) -> None:
    """Draw small obstacles a passage apart, and pockets that open to any side."""
    for _ in range(sketch.integer(0, 3)):
        pocket = np.ones((sketch.integer(7, 10), sketch.integer(6, 8)), np.bool_)
        pocket[1:-1, :-1] = False
        # Twice as many pockets open toward the start as to each side.
        quarter_turns = (0, 0, 1, 3)[sketch.integer(0, 3)]
        sketch.place(np.rot90(pocket, quarter_turns), attempts=40)

    for _ in range(sketch.grid.size // 4):
        block = np.ones((sketch.integer(1, 2), sketch.integer(1, 2)), np.bool_)
        sketch.place(block, attempts=1)


GRID_KINDS: Mapping[str, Callable[[GridSketch], None]] = {
    "doors": draw_doors,
    "dead_ends": draw_dead_ends,
    "turns": draw_turns,
    "clutter": draw_clutter,
}
