"""Names for the kinds of arrays that worlds are made of."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

BoolGrid = npt.NDArray[np.bool_]  # (rows, cols), True where filled or occupied
Cells = npt.NDArray[np.int64]  # (n, 2) row, column
Points = npt.NDArray[np.float64]  # (n, 2) x, y in metres
