"""Maps of the MovingAI benchmarks (.map): a header of four lines, then a letter per cell, the first row at the top."""

import re
from pathlib import Path

import numpy as np

from barn_worlds.base.arrays import BoolGrid
from barn_worlds.base.errors import WorldError
from barn_worlds.base.files import read_bytes
from barn_worlds.worlds.world import LARGEST_SIDE

ENDING = ".map"
CELL_M = 1.0  # the format has no size: in cells of 1 m all of our robots pass where one cell is free
LARGEST_BYTES = LARGEST_SIDE * (LARGEST_SIDE + 2) + 1000
_HEADER = re.compile(
    rb"type octile\r?\nheight (\d{1,6})\r?\nwidth (\d{1,6})\r?\nmap\r?\n"
)
_FREE = b".G"
_KNOWN = b".G@OTSW"  # ground; out of bounds, trees, swamp and water, which are no ground for a robot


def read_grid(path: Path) -> BoolGrid:
    """Return the grid (rows along x, columns along y) of a map, True where it is no ground; WorldError if malformed."""
    content = read_bytes(path, LARGEST_BYTES)
    header = _HEADER.match(content)
    if header is None:
        raise WorldError(
            f"{path}: must begin with the lines type octile, height N, width N and map"
        )
    height, width = int(header[1]), int(header[2])
    if not 1 <= min(height, width) <= max(height, width) <= LARGEST_SIDE:
        raise WorldError(
            f"{path}: sides must be 1 to {LARGEST_SIDE} cells, got {width} x {height}"
        )
    lines = content[header.end() :].split()
    wrong = next(
        (k for k, line in enumerate(lines) if len(line) != width or line.strip(_KNOWN)),
        None,
    )
    if len(lines) != height or wrong is not None:
        what = f"line {5 + wrong}" if wrong is not None else f"{len(lines)} lines"
        raise WorldError(
            f"{path}: must have {height} lines of {width} of the letters {_KNOWN.decode()}, got {what}"
        )
    letters = np.frombuffer(b"".join(lines), np.uint8).reshape(height, width)
    return np.ascontiguousarray(~np.isin(letters, list(_FREE))[::-1].T)
