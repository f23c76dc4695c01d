"""Array types of worlds and of measurements on them."""

from typing import Any

import numpy as np
import numpy.typing as npt

# Names say what an array holds. mypy checks the type of its numbers, not its shape.
BoolGrid = npt.NDArray[np.bool_]  # (rows, cols), True where filled or occupied
Bools = npt.NDArray[np.bool_]  # (n,)
Cells = npt.NDArray[np.int64]  # (n, 2) row, column
Points = npt.NDArray[np.float64]  # (n, 2) x, y in meters
Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Singles = npt.NDArray[np.float32]
Bytes = npt.NDArray[np.uint8]  # costs of cells, flags
MediumIntegers = npt.NDArray[np.int32]
SignedBytes = npt.NDArray[np.int8]  # cells of an occupancy grid
AnyArray = npt.NDArray[Any]


def side_lengths(points: AnyArray) -> Floats:
    """Return the distance (n - 1,) from each of some points (n, 2 or more) to the next.

    Args:
        points: x and y, or row and column, and what else there is about them.
    """
    lengths: Floats = np.hypot(*np.diff(points[:, :2], axis=0).T)
    return lengths


def unit_vectors(angles: AnyArray) -> Floats:
    """Return the unit vectors (n, 2) of directions (n,) in rad."""
    vectors: Floats = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return vectors
