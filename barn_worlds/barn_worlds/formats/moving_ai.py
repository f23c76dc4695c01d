"""Maps of the MovingAI benchmarks (.map).

A header of four lines, then a letter per cell, the first row at the top.
"""

import re
from pathlib import Path

import numpy as np

from barn_worlds.base.arrays import BoolGrid
from barn_worlds.base.errors import WorldError
from barn_worlds.base.files import read_bytes
from barn_worlds.worlds.world import LARGEST_SIDE

ENDING = ".map"
# The format has no cell size. Every robot of the suite fits through one cell of 1 m.
CELL_M = 1.0
LARGEST_BYTES = LARGEST_SIDE * (LARGEST_SIDE + 2) + 1000
_HEADER = re.compile(
    rb"type octile\r?\nheight (\d{1,6})\r?\nwidth (\d{1,6})\r?\nmap\r?\n"
)
_HEADER_LINES = 4
_GROUND = b".G"
# Ground, and what no robot drives on: out of bounds, trees, swamp and water.
_LETTERS = b".G@OTSW"


def read_grid(path: Path) -> BoolGrid:
    """Read a .map file's grid (rows along x), False on ground; WorldError if invalid.

    Raises:
        WorldError: If the file cannot be read or is malformed.
    """
    content = read_bytes(path, LARGEST_BYTES)
    header = _HEADER.match(content)
    if header is None:
        raise WorldError(
            f"{path}: must begin with the lines type octile, height N, width N and map"
        )
    height, width = map(int, header.groups())
    if not 1 <= min(height, width) <= max(height, width) <= LARGEST_SIDE:
        raise WorldError(
            f"{path}: sides must be 1 to {LARGEST_SIDE} cells, got {width} x {height}"
        )

    lines = content[header.end() :].split()
    problem = ""
    if len(lines) != height:
        problem = f"{len(lines)} lines"
    for number, line in enumerate(lines, _HEADER_LINES + 1):
        if len(line) != width or line.strip(_LETTERS):
            problem = f"line {number}"
            break
    if problem:
        raise WorldError(
            f"{path}: must have {height} lines of {width} letters out of "
            f"{_LETTERS.decode()}, got {problem}"
        )
    letters = np.frombuffer(b"".join(lines), np.uint8).reshape(height, width)
    is_filled = ~np.isin(letters, list(_GROUND))
    # The first line of a file is the top; y points up, and rows lie along x.
    return np.ascontiguousarray(is_filled[::-1].T)
