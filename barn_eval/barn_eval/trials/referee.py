"""The judge of a trial: a state machine over stamped readings, which reads no clock and knows no middleware."""

import math
from dataclasses import dataclass, replace

from barn_eval.trials.outcome import Outcome, Verdict
from barn_eval.trials.protocol import Course, Protocol
from barn_worlds.base.types import Pose2D, Velocity2D, nanoseconds, seconds


@dataclass(frozen=True, slots=True)
class Reading:
    """What the referee sees of one instant.

    odometry: measured pose in the odom frame (which starts at the start pose). truth: pose in the map frame.
    collision: contact with an obstacle since the reading before.
    """

    stamp_ns: int
    odometry: Pose2D
    truth: Pose2D
    collision: bool


@dataclass(frozen=True, slots=True)
class Standing:
    """How a trial stands: outcome (None while it runs), time on the clock (None before it starts), what is left.

    left_m: distance to the goal as the protocol measures it, None before the first reading.
    """

    outcome: Outcome | None
    on_clock_s: float | None
    contact_s: float
    left_m: float | None


class Referee:
    """Judge one trial; the first verdict stands, whatever comes after it.

    Where the map given is off, a robot is also at the goal where its pose on that map says so: a planner knows of no
    other place, and with a usual tolerance may stop out of reach of the goal by which the published trials were judged.

    Readings come in order of time. Stamps may start anywhere: all times count from the first reading.
    """

    def __init__(self, protocol: Protocol, course: Course) -> None:
        self._protocol = protocol
        goals = [course.goal] if course.goal_by_map is None else [course.goal, course.goal_by_map]
        relative = protocol.goal_source == "odometry"
        self._goals = [course.start.inverse() @ goal for goal in goals] if relative else goals
        self._limit_ns = nanoseconds(protocol.limit_s)
        self._first_motion_limit_ns = nanoseconds(protocol.first_motion_limit_s)
        self._first: Reading | None = None
        self._last: Reading | None = None
        self._clock_start_ns: int | None = None
        self._contact_ns = 0
        self._verdict: Verdict | None = None

    @property
    def verdict(self) -> Verdict | None:
        """The verdict, None while the trial runs."""
        return self._verdict

    @property
    def clock_started(self) -> bool:
        """Whether the robot has made its first motion."""
        return self._clock_start_ns is not None

    @property
    def standing(self) -> Standing:
        """How the trial stands at the last reading, or stood at the verdict."""
        last, start_ns = self._last, self._clock_start_ns
        return Standing(
            None if self._verdict is None else self._verdict.outcome,
            None if last is None or start_ns is None else seconds(last.stamp_ns - start_ns),
            seconds(self._contact_ns),
            None if last is None else self._left_m(last),
        )

    def observe(self, reading: Reading) -> Verdict | None:
        """Take the readings of one instant and return the verdict, if there is one by now."""
        if self._verdict is not None:
            return self._verdict
        fault = self._fault(reading)
        if fault:
            return self.fail(Outcome.SIMULATOR_DIED, fault)
        first, before = self._first or reading, self._last or reading
        if reading.collision:
            self._contact_ns += reading.stamp_ns - before.stamp_ns
        self._first, self._last = first, reading
        self._start_clock(first, reading)
        return self._judge(first, reading)

    def resume(self, last: Reading, clock_start_ns: int | None) -> None:
        """Go on from a reading up to which somebody else has judged by these rules, without a verdict or a contact."""
        self._last, self._clock_start_ns = last, clock_start_ns

    @property
    def clock_start_ns(self) -> int | None:
        """Stamp of the reading at which the clock started, None before."""
        return self._clock_start_ns

    @property
    def goals(self) -> tuple[Pose2D, ...]:
        """The goals, any of which is to be reached, in the frame of the protocol's source."""
        return tuple(self._goals)

    def command(self, command: Velocity2D) -> Verdict | None:
        """Take a command on its way to the robot; one that is not finite ends the trial."""
        if self._verdict is None and not command.is_finite():
            return self.fail(
                Outcome.INVALID_COMMAND, f"command ({command.linear!r} m/s, {command.angular!r} rad/s) is not finite"
            )
        return self._verdict

    def fail(self, outcome: Outcome, detail: str, blamed: str = "") -> Verdict:
        """End the trial for a reason that no reading shows, such as a process that died; `blamed` as in `Verdict`."""
        if self._verdict is None:
            self._verdict = replace(self._conclude(outcome, detail), blamed=blamed)
        return self._verdict

    def _fault(self, reading: Reading) -> str:
        last = self._last
        if last is not None and reading.stamp_ns < last.stamp_ns:
            return f"the clock ran back from {last.stamp_ns} to {reading.stamp_ns} ns"
        for name, pose in (("odometry", reading.odometry), ("true pose", reading.truth)):
            if not all(map(math.isfinite, (pose.x, pose.y, pose.yaw))):
                return f"the {name} is not finite"
        return ""

    def _start_clock(self, first: Reading, reading: Reading) -> None:
        if self._clock_start_ns is None:
            source = self._protocol.clock_start_source
            moved_m = _pose(reading, source).distance(_pose(first, source))
            if moved_m > self._protocol.clock_start_distance_m:
                self._clock_start_ns = reading.stamp_ns

    def _judge(self, first: Reading, reading: Reading) -> Verdict | None:
        protocol = self._protocol
        if reading.collision and protocol.collision_ends_trial:
            where = reading.truth
            return self.fail(Outcome.COLLISION, f"contact at ({where.x:.2f}, {where.y:.2f}) m")
        if self._clock_start_ns is None:
            if reading.stamp_ns - first.stamp_ns >= self._first_motion_limit_ns:
                return self.fail(
                    Outcome.NO_FIRST_MOTION,
                    f"moved less than {protocol.clock_start_distance_m:g} m in {protocol.first_motion_limit_s:g} s",
                )
            return None
        on_clock_ns = reading.stamp_ns - self._clock_start_ns
        left_m = self._left_m(reading)
        if left_m <= protocol.goal_distance_m and on_clock_ns <= self._limit_ns:
            return self.fail(Outcome.SUCCESS, "")
        if on_clock_ns >= self._limit_ns:
            return self.fail(Outcome.TIMEOUT, f"{left_m:.2f} m from the goal after {protocol.limit_s:g} s")
        return None

    def _left_m(self, reading: Reading) -> float:
        where = _pose(reading, self._protocol.goal_source)
        return min(where.distance(goal) for goal in self._goals)

    def _conclude(self, outcome: Outcome, detail: str) -> Verdict:
        if self._first is None or self._last is None:
            return Verdict(outcome, detail, None, 0.0, 0.0)
        last_ns = self._last.stamp_ns
        started_ns = self._clock_start_ns
        return Verdict(
            outcome,
            detail,
            None if started_ns is None else seconds(last_ns - started_ns),
            seconds(last_ns - self._first.stamp_ns),
            seconds(self._contact_ns),
        )


def _pose(reading: Reading, source: str) -> Pose2D:
    return reading.truth if source == "truth" else reading.odometry
