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
