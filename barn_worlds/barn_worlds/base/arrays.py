"""Types of arrays, and the compiler of kernels over them."""

from collections.abc import Callable
from functools import update_wrapper
from typing import Any, TypeVar, cast

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
    """Return distances (n - 1,) between successive points, by their first two columns.

    Args:
        points: x and y, or row and column; further columns are ignored.
    """
    lengths: Floats = np.hypot(*np.diff(points[:, :2], axis=0).T)
    return lengths


def unit_vectors(angles: AnyArray) -> Floats:
    """Return the unit vectors (n, 2) of directions (n,) in rad."""
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


# What a node logs before it calls its first kernels.
COMPILING_NOTE = (
    "loading kernels; on the first start on a machine, compiling them takes a minute"
)

_Function = TypeVar("_Function", bound=Callable[..., object])


class _Kernel:
    """A function that numba compiles on its first call.

    Help and completion import kernels but call none, so they need no numba.
    """

    def __init__(self, function: Callable[..., object], **options: Any) -> None:
        """Keep the function and further options of `numba.njit`; compile nothing."""
        update_wrapper(self, function)
        self._options = options

    def __call__(self, *arguments: Any) -> object:
        """Return the function's value, after compiling it if this is the first call."""
        return self.compiled(*arguments)

    def __getattr__(self, name: str) -> Any:
        """Return a compiled function's attribute; AttributeError for "_..." names."""
        # `compiled` is set by the first use; all others are numba's, such as `py_func`.
        if name == "compiled":
            return self._compile()
        # A copy asks for these before it has any state.
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.compiled, name)

    @property
    def _numba_type_(self) -> Any:
        """The type by which numba compiles calls of this; compiles this first."""
        return self.compiled._numba_type_

    def _compile(self) -> Any:
        """Compile the function, keep the result in `compiled` and return it."""
        import numba  # noqa: PLC0415 (see above)

        self.compiled = numba.njit(cache=True, **self._options)(self.__wrapped__)
        return self.compiled


def kernel(function: _Function) -> _Function:
    """Return `function` as a numba kernel, compiled at its first call, cached on disk.

    A division by zero gives inf or NaN, as in numpy. Python's exception would cost a
    branch at every division, and would keep loops from being vectorized.
    """
    return cast(_Function, _Kernel(function, error_model="numpy"))


def strict_kernel(function: _Function) -> _Function:
    """Return a function compiled as by `kernel`, whose divisions by zero raise."""
    return cast(_Function, _Kernel(function))


def inline_kernel(function: _Function) -> _Function:
    """Return a function compiled as by `kernel` and inlined where kernels call it."""
    return cast(_Function, _Kernel(function, error_model="numpy", forceinline=True))
