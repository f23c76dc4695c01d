"""The judge of a trial: a state machine over stamped readings, which reads no clock and knows no middleware."""

from dataclasses import dataclass, replace

import numpy as np

from barn_eval.trials import rules
from barn_eval.trials.outcome import Outcome, Verdict
from barn_eval.trials.protocol import Course, Protocol
from barn_worlds.base.types import Pose2D, Velocity2D, seconds

_ROUNDING = 1e-6  # of a command, which may have been a number of 32 bits
_ONLY = np.arange(1)  # the trial of a referee among its states


@dataclass(frozen=True, slots=True)
class Standing:
    """How a trial stands: outcome (None while it runs), time on the clock (None before it starts), what is left.

    left_m: distance to the goal as the protocol measures it, None before the first reading.
    """

    outcome: Outcome | None
    clock_s: float | None
    contact_s: float
    goal_distance_m: float | None


class Referee:
    """Judge one trial; the first verdict stands, whatever comes after it.

    Readings come in order of time. Stamps may start anywhere: all times count from the first reading. declared_mps: the
    speed cap that the planner has declared and is held to, 0 for none.
    """

    def __init__(
        self, protocol: Protocol, course: Course, declared_mps: float = 0.0
    ) -> None:
        self._protocol, self._declared_mps = protocol, declared_mps
        self._verdict: Verdict | None = None
        self._stamp_ns, self._contact = (
            np.zeros_like(_ONLY),
            np.zeros_like(_ONLY, np.bool_),
        )
        self._odometry, self._truth = (
            np.zeros((len(_ONLY), 3)),
            np.zeros((len(_ONLY), 3)),
        )
        self._keep(rules.states_of(protocol, course))

    @property
    def verdict(self) -> Verdict | None:
        """The verdict, None while the trial runs."""
        if self._verdict is None and self._code.item() != rules.RUNNING:
            self._verdict = self._conclude(*self._end())
        return self._verdict

    @property
    def clock_started(self) -> bool:
        """Whether the robot has made its first motion."""
        return bool(self._state["clock_started"])

    @property
    def standing(self) -> Standing:
        """How the trial stands at the last reading, or stood at the verdict."""
        state, verdict = self._state, self.verdict
        return Standing(
            None if verdict is None else verdict.outcome,
            self._on_clock_s(),
            seconds(int(state["contact_ns"])),
            float(state["left_m"]) if state["begun"] else None,
        )

    def move_to(self, states: rules.States) -> None:
        """Keep the state of the trial in these (1,) from now on: a row of those that are observed by others at once."""
        states[:] = self._states
        self._keep(states)

    def observe(
        self, stamp_ns: int, odometry: Pose2D, truth: Pose2D, collision: bool
    ) -> Verdict | None:
        """Take the readings of one instant and return the verdict, if there is one by now.

        odometry: measured pose in the odom frame (which starts at the start pose). truth: pose in the map frame.
        collision: contact with an obstacle since the reading before.
        """
        if self._verdict is None:
            self._stamp_ns[:], self._contact[:] = stamp_ns, collision
            self._odometry[:] = odometry.x, odometry.y, odometry.yaw
            self._truth[:] = truth.x, truth.y, truth.yaw
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
        """Take a command on its way to the robot; one that is not finite, or above the speed cap, ends the trial."""
        if self.verdict is not None:
            return self.verdict
        if not command.is_finite():
            linear, angular = command.linear, command.angular
            return self.fail(
                Outcome.INVALID_COMMAND,
                f"command ({linear!r} m/s, {angular!r} rad/s) is not finite",
            )
        if 0.0 < self._declared_mps * (1.0 + _ROUNDING) < abs(command.linear):
            cap = f"declared speed cap of {self._declared_mps:g} m/s"
            return self.fail(
                Outcome.INVALID_COMMAND,
                f"command of {command.linear!r} m/s is above the planner's {cap}",
            )
        return None

    def fail(self, outcome: Outcome, detail: str, culprit: str = "") -> Verdict:
        """End the trial for a reason that no reading shows, such as a process that died; `blamed` as in `Verdict`."""
        if (verdict := self.verdict) is None:
            verdict = self._verdict = replace(
                self._conclude(outcome, detail), culprit=culprit
            )
        return verdict

    def _end(self) -> tuple[Outcome, str]:
        """Return outcome and detail of a trial that a reading has ended."""
        state, protocol = self._state, self._protocol
        match state["code"]:
            case rules.SUCCESS:
                return Outcome.SUCCESS, ""
            case rules.COLLISION:
                return (
                    Outcome.COLLISION,
                    f"contact at ({state['x']:.2f}, {state['y']:.2f}) m",
                )
            case rules.TIMEOUT:
                return (
                    Outcome.TIMEOUT,
                    f"{state['left_m']:.2f} m from the goal after {protocol.limit_s:g} s",
                )
            case rules.NO_FIRST_MOTION:
                least = f"{protocol.clock_start_distance_m:g} m in {protocol.first_motion_limit_s:g} s"
                return Outcome.NO_FIRST_MOTION, f"moved less than {least}"
            case rules.CLOCK_BACK:
                last, stamp = state["last_ns"], state["stamp_ns"]
                return (
                    Outcome.SIMULATOR_DIED,
                    f"the clock ran back from {last} to {stamp} ns",
                )
            case code:
                name = "odometry" if code == rules.ODOMETRY_LOST else "true pose"
                return Outcome.SIMULATOR_DIED, f"the {name} is not finite"

    def _keep(self, states: rules.States) -> None:
        self._states, self._state, self._code = states, states[0], states["code"]

    def _on_clock_s(self) -> float | None:
        state = self._state
        return (
            seconds(int(state["last_ns"] - state["clock_ns"]))
            if state["clock_started"]
            else None
        )

    def _conclude(self, outcome: Outcome, detail: str) -> Verdict:
        state = self._state
        lasted_ns, contact_ns = (
            int(state["last_ns"] - state["first_ns"]),
            int(state["contact_ns"]),
        )
        return Verdict(
            outcome, detail, self._on_clock_s(), seconds(lasted_ns), seconds(contact_ns)
        )
