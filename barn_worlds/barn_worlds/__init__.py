"""Worlds of the BARN navigation benchmark: geometry, data sets, generator, formats."""

from pathlib import Path as _Path

from barn_worlds.base import kernel_cache as _kernel_cache

__version__ = "0.1.0"

# Before any module imports numba.
_kernel_cache.prepare(_Path(__file__).parent)
