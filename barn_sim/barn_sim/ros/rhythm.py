"""Which instants a planner answers in lockstep: each scan, or one in a period.

A planner with a timer sends commands at a rate of its own. If the timer follows the
simulated clock, no wait brings a command before the clock has gone on far enough. If it
follows the wall clock, it would be asked at each scan, more often than on a robot.

Times are passed in: simulated ones in ns by the node's clock, others in s of
wall-clock time.
"""

import math
from itertools import pairwise
from statistics import median

# While a period is searched for, each instant lasts until this long after its start or
# its last command: so late answers do not pass for answers to later readings. The
# second is for a planner that has been silent for so many instants.
_SEARCH_S = 0.25
_HASTY_SEARCH_S = 0.02
_SILENT_INSTANTS = 20
# Commands whose intervals must agree, and waits after which one is made longer to see
# whether a second command comes without a new reading.
_SEARCH_COMMANDS = 3
_WAITS_BEFORE_HOLD = 20
_LONGEST_HOLD_S = 1.5


class Rhythm:
    """The waits of a lockstep, and what they show about the planner's timer."""

    period_ns: int
    """Simulated time between two commands; 0: each scan is answered."""

    is_declared: bool
    """Whether the period is the declared one."""

    missed: int
    """Missed commands of the trial, except during a search that succeeded."""

    def __init__(self, rate_hz: float = 0.0):
        """Start with the declared rate of commands; 0 if none is declared."""
        self.period_ns = 0
        self.is_declared = rate_hz > 0.0
        self.missed = 0
        self._rate_hz = rate_hz
        self._step_ns = 1
        self._wait_s = 0.0
        self._is_first_wait = True
        # Whether a wait has failed, and what the instants since then have shown.
        self._is_searching = False
        self._silent_instants = 0
        self._command_instants_ns: list[int] = []
        # The wait that is under way: its last event, and when its commands came.
        self._event_s = 0.0
        self._commands_s: list[float] = []
        self._hold_s = 0.0
        # When waits were answered, until one has been held.
        self._answers_s: list[float] = []
        self._is_waiting = False
        self._last_command_ns: int | None = None

    def begin_trial(self, step_ns: int, wait_s: float) -> None:
        """Reset missed commands; set a declared period, else keep the measured one.

        Args:
            step_ns: Control period of the trial.
            wait_s: Longest wait for a command.
        """
        self._step_ns = step_ns
        self._wait_s = wait_s
        self._is_first_wait = True
        self.missed = 0
        if len(self._answers_s) < _WAITS_BEFORE_HOLD:
            self._answers_s = []
        if self.is_declared:
            self.period_ns = self._whole_steps(1e9 / self._rate_hz)

    @property
    def is_timed_by_planner(self) -> bool:
        """Whether the current wait is for the first command of a periodic planner.

        How long the wait lasts then says nothing about the planner's computing.
        """
        return bool(self.period_ns and self._is_waiting and not self._commands_s)

    def expects(self, now_ns: int, *, has_scan: bool) -> bool:
        """Tell whether to wait for a command: by scan, by period, always in search."""
        if self._is_searching:
            return True
        if not self.period_ns:
            return has_scan
        last_ns = self._last_command_ns
        return last_ns is None or now_ns >= last_ns + self.period_ns

    def begin_wait(self, now_s: float) -> None:
        """Begin the wait for an answer to readings that have just been published."""
        self._is_waiting = True
        self._event_s = now_s
        self._commands_s = []
        self._hold_s = 0.0

    def hear(self, now_ns: int, now_s: float) -> None:
        """Record a command, expected or not, and learn the planner's timing from it."""
        self._last_command_ns = now_ns
        if not self._is_waiting:
            return
        self._event_s = now_s
        self._commands_s.append(now_s)
        if self._hold_s:
            self._judge_unasked(now_s - self._commands_s[0])
            return
        if self._is_searching and len(self._commands_s) == _WAITS_BEFORE_HOLD:
            # So many at one instant come from a timer on the wall clock.
            self._answers_s = self._commands_s
            self._judge_unasked(math.inf)
            return
        # A search holds its instants in any case.
        is_known = self.period_ns > 0 or self._is_searching
        if not is_known and len(self._answers_s) < _WAITS_BEFORE_HOLD:
            self._answers_s.append(now_s)
            if len(self._answers_s) == _WAITS_BEFORE_HOLD:
                longest_s = max(self._recent_intervals_s())
                self._hold_s = min(1.5 * longest_s, _LONGEST_HOLD_S)

    def remaining_s(self, now_s: float) -> float:
        """Return how many seconds the current wait should go on; it is over at <= 0."""
        return self._event_s + self._limit_s() - now_s

    def end_wait(self, now_ns: int) -> None:
        """End an instant's wait; unanswered, count a miss and search for a period."""
        self._is_waiting = False
        is_answered = bool(self._commands_s)
        if self._is_searching:
            self._search(now_ns, is_answered=is_answered)
            return
        is_first_wait = self._is_first_wait
        self._is_first_wait = False
        if is_answered:
            return

        # At its first wait a trial need not have met the phase of a timer. Later, the
        # period is wrong.
        if not (self.period_ns and is_first_wait):
            self.missed += 1
            self.period_ns = 0
            self.is_declared = False
        self._is_searching = True
        self._silent_instants = 0
        self._command_instants_ns = []

    def _limit_s(self) -> float:
        """Return how long, in s, the wait lasts after its latest event."""
        if self._is_searching:
            if self._silent_instants < _SILENT_INSTANTS:
                return _SEARCH_S
            return _HASTY_SEARCH_S
        if self._commands_s:
            return self._hold_s
        if self.period_ns and self._is_first_wait:
            return _SEARCH_S
        return self._wait_s

    def _search(self, now_ns: int, *, is_answered: bool) -> None:
        """Record an instant of a search; adopt a period once the commands agree."""
        if not is_answered:
            self._silent_instants += 1
            if not self.period_ns:
                self.missed += 1
            return
        self._silent_instants = 0
        if self.period_ns:
            # Only the phase was missing.
            self._is_searching = False
            return
        self._command_instants_ns.append(now_ns)
        instants_ns = self._command_instants_ns[-_SEARCH_COMMANDS:]
        intervals_ns = [later - earlier for earlier, later in pairwise(instants_ns)]
        if len(instants_ns) < _SEARCH_COMMANDS:
            return
        # A period of three and a half steps alternates between three and four.
        if max(intervals_ns) - min(intervals_ns) <= self._step_ns:
            self._adopt_period(max(intervals_ns))

    def _judge_unasked(self, interval_s: float) -> None:
        """End a hold; adopt a period if a second command this late shows a timer."""
        typical_s = median(self._recent_intervals_s())
        self._hold_s = 0.0
        # A second command at once comes from the same reading. Where a timer is so fast
        # that each reading is answered at once, nothing need be known of it.
        is_timer = interval_s > 0.5 * typical_s
        is_slow = 2e9 * typical_s > self._step_ns
        if is_timer and (is_slow or self._is_searching):
            # Measured intervals vary by a little, which is no reason for another step.
            self._adopt_period(1e9 * typical_s - 0.1 * self._step_ns)

    def _recent_intervals_s(self) -> list[float]:
        """Return the wall-clock times (s) between answers, without the first ones."""
        recent_s = self._answers_s[_WAITS_BEFORE_HOLD // 2 :]
        return [later - earlier for earlier, later in pairwise(recent_s)]

    def _adopt_period(self, period_ns: float) -> None:
        """Adopt a measured period in whole steps; set the missed commands to 0."""
        self.period_ns = self._whole_steps(period_ns)
        self._is_searching = False
        self.missed = 0

    def _whole_steps(self, period_ns: float) -> int:
        """Return the shortest whole number of steps that lasts a period, in ns."""
        # Less than a millionth of a step is rounding.
        steps = math.ceil(period_ns / self._step_ns - 1e-6)
        return max(1, steps) * self._step_ns
