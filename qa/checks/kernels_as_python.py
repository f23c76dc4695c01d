"""A plugin of pytest for `make coverage`: lets kernels run as Python, where coverage.py sees them.

What numba alone has is replaced: attributes of records, and the fused multiply-add, which Python has from 3.13 on.
"""

from fractions import Fraction
from typing import Any

import numpy as np

from barn_sim.body import state, tires

_whole = state.Fleet.of.__func__  # type: ignore[attr-defined]


def _with_attributes(cls: type[state.Fleet], *arguments: int) -> state.Fleet:
    """Make a fleet whose records have attributes in Python, too."""
    made = _whole(cls, *arguments)
    return cls(
        made.robots.view(np.recarray),
        made.pending,
        made.settings.view(np.recarray),
        made.noise,
    )


def _rounded_once(a: float, b: float, c: float) -> float:
    return float(Fraction(a) * Fraction(b) + Fraction(c))


made: Any = state.Fleet
made.of = classmethod(_with_attributes)
tires.fused = _rounded_once
