"""The decorators of kernels: functions that numba compiles."""

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

_Function = TypeVar("_Function", bound=Callable[..., object])


def kernel(function: _Function) -> _Function:
    """Return a function that numba compiles on its first call and caches on disk.

    A division by zero gives inf or NaN, as in numpy. Python's exception would cost a
    branch at every division, and would keep loops from being vectorized.
    """
    return cast(_Function, njit(cache=True, error_model="numpy")(function))


def inline_kernel(function: _Function) -> _Function:
    """Return a function compiled as by `kernel` and inlined where kernels call it."""
    compiled = njit(cache=True, error_model="numpy", forceinline=True)(function)
    return cast(_Function, compiled)
