"""The simulated time that a planner takes to compute a command.

A planner declares its computing time as `Compute`. A `CycleTimer` turns the
declaration, or measured or recorded times, into the delays of a trial.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.types import nanoseconds

_Z95 = 1.6448536269514722  # 95th percentile of the standard normal distribution
_LONGEST_DELAY_S = 10.0


@dataclass(frozen=True)
class Compute(Checked):
    """The time that a planner declares for one cycle on the reference computer.

    The defaults, all zero, declare nothing. `barn_eval.running.direct.pace` describes
    the cycle.
    """

    # A command takes effect this much later than the readings that it answers.
    delay_s: float = quantity(
        0.0,
        "time from the readings until the command takes effect",
        "s",
        0.0,
        _LONGEST_DELAY_S,
    )
    delay_p95_s: float = quantity(
        0.0,
        "95th percentile of a random, log-normal delay; 0: the delay is constant",
        "s",
        0.0,
        _LONGEST_DELAY_S,
    )
    # The next cycle begins with the first readings after the command takes effect,
    # and no earlier than this after the last cycle began.
    period_s: float = quantity(
        0.0, "shortest time between two cycle starts", "s", 0.0, _LONGEST_DELAY_S
    )

    def check_rules(self) -> None:
        """Raise ConfigError unless delay_p95_s is 0 or at least delay_s, above 0."""
        if self.delay_p95_s:
            self.require(
                self.delay_p95_s >= self.delay_s > 0.0,
                "delay_p95_s",
                "must be at least delay_s, above 0",
            )

    @property
    def is_declared(self) -> bool:
        """Whether a planner declares anything: any field differs from zero."""
        return self != NO_COMPUTE

    @property
    def charged_s(self) -> float:
        """Delay in s that 19 of 20 cycles do not exceed: median or 95th percentile."""
        return max(self.delay_s, self.delay_p95_s)


NO_COMPUTE = Compute()


class CycleTimer:
    """Decides when a planner may start a cycle and when its command takes effect."""

    delays_ns: list[int]
    """Delays of all cycles so far, in order."""

    def __init__(self, compute: Compute, seed: int, recorded_ns: Sequence[int] = ()):
        """Create a free timer; recorded delays replace those of the first cycles.

        Args:
            compute: Declaration of the planner.
            seed: Seed of the delays that are drawn from the declaration.
            recorded_ns: Delays of an earlier drive. The first cycles get these,
                whatever is measured or declared.
        """
        self._compute = compute
        self._recorded_ns = recorded_ns
        self._rng = np.random.default_rng([seed, 0xC0])
        self._free_ns = 0
        self.delays_ns = []

    def is_free(self, now_ns: int) -> bool:
        """Tell whether no cycle is under way at a simulated time, so one may start."""
        return now_ns >= self._free_ns

    def start_cycle(self, now_ns: int, measured_ns: int | None = None) -> int:
        """Start a cycle; append its recorded, measured or drawn delay; return it (ns).

        Args:
            now_ns: Simulated time of the readings that the planner gets.
            measured_ns: Measured delay. By default the delay follows the declaration.
        """
        # Each cycle draws, even if its delay is recorded, so that the cycles after the
        # recorded ones get the same delays as in the earlier drive.
        delay_ns = self._draw_ns() if measured_ns is None else measured_ns
        if len(self.delays_ns) < len(self._recorded_ns):
            delay_ns = self._recorded_ns[len(self.delays_ns)]
        self.delays_ns.append(delay_ns)
        self._free_ns = now_ns + max(delay_ns, nanoseconds(self._compute.period_s))
        return delay_ns

    def _draw_ns(self) -> int:
        """Return the declared delay in ns; with a p95, a random one up to 10 s."""
        median_s = self._compute.delay_s
        p95_s = self._compute.delay_p95_s
        if p95_s <= median_s:
            return nanoseconds(median_s)
        # The logarithm is normal: its mean is that of the median, its 95th percentile
        # lies _Z95 standard deviations above.
        sigma = math.log(p95_s / median_s) / _Z95
        delay_s = median_s * math.exp(sigma * self._rng.standard_normal())
        return nanoseconds(min(delay_s, _LONGEST_DELAY_S))
