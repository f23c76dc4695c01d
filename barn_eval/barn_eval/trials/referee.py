"""The judge of a trial: a state machine over stamped readings.

It reads no clock and knows no middleware.
"""

from dataclasses import dataclass

import numpy as np

from barn_eval.trials import rules
from barn_eval.trials.protocol import Course, Protocol
from barn_eval.trials.result import Outcome, Verdict
from barn_worlds.base.types import Pose2D, Velocity2D, seconds

# Relative rounding error of a command, which may have been a 32-bit number.
_ROUNDING = 1e-6

# Index of the referee's only trial among its states.
_ONLY = np.arange(1)


@dataclass(frozen=True, slots=True)
class Standing:
    """How a trial stands."""

    outcome: Outcome | None  # None while it runs
    clock_s: float | None  # time on the clock, None before it starts
    contact_s: float
    goal_distance_m: float | None  # as the protocol measures it, None without a reading


class Referee:
    """Judges one trial; the first verdict stands, whatever comes after it.

    Readings come in order of time. Stamps may start anywhere: all times count from the
    first reading.
    """

    def __init__(self, protocol: Protocol, course: Course, declared_mps: float = 0.0):
        """Prepare for the first reading.

        Args:
            protocol: Rules of the trial, in the size of its world.
            course: Start and goal in the map frame.
            declared_mps: Speed cap that the planner has declared, 0 for none.
        """
        self._protocol = protocol
        self._declared_mps = declared_mps
        self._verdict: Verdict | None = None

        # Arguments of the kernel, made once and filled at each reading.
        self._stamp_ns = np.zeros(1, np.int64)
        self._contact = np.zeros(1, np.bool_)
        self._odometry = np.zeros((1, 3))
        self._truth = np.zeros((1, 3))
        self._bind(rules.initial_states(protocol, course))

    @property
    def verdict(self) -> Verdict | None:
        """Verdict on the trial, None while it runs; the first one stands."""
        if self._verdict is None and self._code.item() != rules.RUNNING:
            self._verdict = self._make_verdict(*self._explain_end())
        return self._verdict

    @property
    def clock_started(self) -> bool:
        """Whether the clock has started, by motion or, if so ruled, with the goal."""
        return bool(self._state["clock_started"])

    @property
    def standing(self) -> Standing:
        """Outcome, clock, contact time and goal distance by the last judged reading."""
        state = self._state
        verdict = self.verdict
        return Standing(
            None if verdict is None else verdict.outcome,
            self._clock_s(),
            seconds(int(state["contact_ns"])),
            float(state["left_m"]) if state["has_reading"] else None,
        )

    def move_to(self, states: rules.States) -> None:
        """Copy the trial's state into the array `states` (1,) and keep it there.

        `states` is a row of the states of trials that are judged all at once.
        """
        states[:] = self._states
        self._bind(states)

    def observe(
        self, stamp_ns: int, odometry: Pose2D, truth: Pose2D, collision: bool
    ) -> Verdict | None:
        """Judge readings unless the trial has ended; return its verdict or None.

        Args:
            stamp_ns: Time of the readings.
            odometry: Measured pose in the odom frame, which starts at the start pose.
            truth: True pose in the map frame.
            collision: Whether there was a contact since the reading before.
        """
        if self._verdict is None:
            self._stamp_ns[:] = stamp_ns
            self._contact[:] = collision
            self._odometry[:] = odometry.numbers
            self._truth[:] = truth.numbers
            rules.observe(
                self._states,
                _ONLY,
                self._stamp_ns,
                self._odometry,
                self._truth,
                self._contact,
            )
        return self.verdict

    def command(self, command: Velocity2D) -> Verdict | None:
        """End the trial for a non-finite or too fast command; return verdict or None.

        Speed counts against the declared cap, forward and backward. Nothing is sent.
        """
        if self.verdict is not None:
            return self.verdict
        if not command.is_finite():
            return self.fail(
                Outcome.INVALID_COMMAND,
                f"command ({command.linear!r} m/s, {command.angular!r} rad/s) is not"
                " finite",
            )
        cap_mps = self._declared_mps * (1.0 + _ROUNDING)
        if 0.0 < cap_mps < abs(command.linear):
            return self.fail(
                Outcome.INVALID_COMMAND,
                f"command of {command.linear!r} m/s is above the planner's declared"
                f" speed cap of {self._declared_mps:g} m/s",
            )
        return None

    def fail(self, outcome: Outcome, detail: str, culprit: str = "") -> Verdict:
        """End the trial with `outcome` unless it has a verdict; return the one it has.

        This is for what no reading shows, such as a dead process.

        Args:
            outcome: How the trial ends, unless it has a verdict already.
            detail: What happened, for the row.
            culprit: Who failed, where the outcome alone does not say.
        """
        verdict = self.verdict
        if verdict is None:
            verdict = self._make_verdict(outcome, detail, culprit)
            self._verdict = verdict
        return verdict

    def _explain_end(self) -> tuple[Outcome, str]:
        """Return outcome and text of an ended trial; SIMULATOR_DIED for a fault."""
        state = self._state
        protocol = self._protocol
        match state["code"]:
            case rules.SUCCESS:
                return Outcome.SUCCESS, ""
            case rules.COLLISION:
                detail = f"contact at ({state['x']:.2f}, {state['y']:.2f}) m"
                return Outcome.COLLISION, detail
            case rules.LEFT_WORLD:
                return Outcome.LEFT_WORLD, (
                    f"at ({state['x']:.2f}, {state['y']:.2f}) m, more than"
                    f" {protocol.edge_m:g} m outside"
                )
            case rules.TIMEOUT:
                left_m = f"{state['left_m']:.2f}"
                detail = f"{left_m} m from the goal after {protocol.limit_s:g} s"
                return Outcome.TIMEOUT, detail
            case rules.NO_FIRST_MOTION:
                return Outcome.NO_FIRST_MOTION, (
                    f"moved less than {protocol.clock_start_distance_m:g} m in"
                    f" {protocol.first_motion_limit_s:g} s"
                )
            case code:
                return Outcome.SIMULATOR_DIED, self._explain_fault(code)

    def _explain_fault(self, code: int) -> str:
        """Return the detail text of a trial that a faulty reading has ended."""
        state = self._state
        if code == rules.CLOCK_BACK:
            return (
                f"the clock ran back from {state['last_ns']} to {state['stamp_ns']} ns"
            )
        pose = "odometry" if code == rules.ODOMETRY_LOST else "true pose"
        return f"the {pose} is not finite"

    def _bind(self, states: rules.States) -> None:
        """Use the array `states` (1,) as the trial's state; nothing is copied."""
        # Views that are made once: indexing an array costs more than reading them.
        self._states = states
        self._state = states[0]
        self._code = states["code"]

    def _clock_s(self) -> float | None:
        """Return simulated seconds on the clock so far, None before it starts."""
        state = self._state
        if not state["clock_started"]:
            return None
        return seconds(int(state["last_ns"] - state["clock_ns"]))

    def _make_verdict(
        self, outcome: Outcome, detail: str, culprit: str = ""
    ) -> Verdict:
        """Return a verdict with the times up to the last reading; it is not kept."""
        state = self._state
        duration_s = seconds(int(state["last_ns"] - state["first_ns"]))
        contact_s = seconds(int(state["contact_ns"]))
        return Verdict(outcome, detail, self._clock_s(), duration_s, contact_s, culprit)
