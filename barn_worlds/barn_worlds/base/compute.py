"""How long a planner computes, in simulated time: what it declares, and when its commands take effect."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.types import nanoseconds

_Z95 = 1.6448536269514722  # 95th percentile of the standard normal distribution


@dataclass(frozen=True)
class Compute(Checked):
    """What a planner takes for a cycle on the reference computer (`barn_eval.running.direct.pace`).

    A command takes effect `delay_s` after the readings that it answers; the next cycle begins with the first readings
    after that, and no earlier than `period_s` after the last one. All zero: nothing is declared.
    """

    delay_s: float = quantity(
        0.0, "from readings to the effect of the command", "s", 0.0, 10.0
    )
    delay_p95_s: float = quantity(
        0.0,
        "95th percentile of that delay, log-normal by seed; 0: constant",
        "s",
        0.0,
        10.0,
    )
    period_s: float = quantity(0.0, "shortest time between two cycles", "s", 0.0, 10.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.delay_p95_s:
            self.require(
                self.delay_p95_s >= self.delay_s > 0.0,
                "delay_p95_s",
                "must be at least delay_s, above 0",
            )

    @property
    def is_declared(self) -> bool:
        """Whether anything is."""
        return self != Compute()

    @property
    def charged_s(self) -> float:
        """The longest time that is charged for a cycle, but for one in twenty."""
        return max(self.delay_s, self.delay_p95_s)


NO_COMPUTE = Compute()


class CycleTimer:
    """Says when a planner may begin a cycle and when its command takes effect.

    Without `recorded_ns` delays are those of the declaration, drawn from a seed; with it, they are these in turn, and
    those that `take` is given beyond them. delays_ns: of all cycles so far.
    """

    def __init__(
        self, compute: Compute, seed: int, recorded_ns: Sequence[int] = ()
    ) -> None:
        self._compute, self._recorded = compute, recorded_ns
        self._rng = np.random.default_rng([seed, 0xC0])
        self._free_ns = 0
        self.delays_ns: list[int] = []

    def is_free(self, now_ns: int) -> bool:
        """Tell whether no cycle is under way."""
        return now_ns >= self._free_ns

    def start_cycle(self, now_ns: int, measured_ns: int | None = None) -> int:
        """Begin a cycle at the time of its readings and return its delay, which is the measured one if there is one."""
        drawn_ns, count = (
            self._drawn_ns() if measured_ns is None else measured_ns,
            len(self.delays_ns),
        )
        delay_ns = self._recorded[count] if count < len(self._recorded) else drawn_ns
        self.delays_ns.append(delay_ns)
        self._free_ns = now_ns + max(delay_ns, nanoseconds(self._compute.period_s))
        return delay_ns

    def _drawn_ns(self) -> int:
        median_s, high_s = self._compute.delay_s, self._compute.delay_p95_s
        if high_s <= median_s:
            return nanoseconds(median_s)
        sigma = math.log(high_s / median_s) / _Z95
        return nanoseconds(
            min(median_s * math.exp(sigma * self._rng.standard_normal()), 10.0)
        )
