"""A trial while it runs: readings and commands in, verdict and row out."""

import math
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from traceback import extract_tb, format_exc
from types import FrameType
from typing import Any, TypeVar

import numpy as np

from barn_eval.trials.encounters import measure_encounters
from barn_eval.trials.referee import Referee
from barn_eval.trials.result import Outcome, Scores, TrialResult, Verdict, score_trial
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trajectory import Trajectory, TrajectoryLog, measure_trajectory
from barn_planners.interface import PlannerStatus
from barn_worlds.base.arrays import Floats, side_lengths
from barn_worlds.base.errors import strip_controls
from barn_worlds.base.types import (
    NANOSECONDS_PER_SECOND,
    Odometry,
    Pose2D,
    Velocity2D,
    seconds,
)

T = TypeVar("T")

# Wall-clock time, in multiples of a limit, after which the machine is to blame and not
# the planner.
STALLED = 10.0

# Most characters of a planner's text in a row.
MAX_TEXT_LENGTH = 2000
_MAX_ERROR_LENGTH = 300
_ODOMETRY_DRIFT = 0.02  # share of the way by which odometry may be off
# A step of poses beyond this is a jump: a distance, and a speed times the period.
_JUMP_M = 0.25
_FASTEST_M_PER_NS = 5e-9
_SCHEDULE_BYTES = 100  # more than three numbers of 64 bits take


@contextmanager
def signal_handler(
    number: int, handler: Callable[[int, FrameType | None], None]
) -> Iterator[bool]:
    """Handle a signal in a context, main thread only; then restore the old handler.

    Args:
        number: Number of the signal.
        handler: Function that takes the signal.

    Yields:
        Whether the signal is handled: only the main thread can.
    """
    if threading.current_thread() is not threading.main_thread():
        yield False
        return
    previous = signal.signal(number, handler)
    try:
        yield True
    finally:
        signal.signal(number, previous)


class DeadlineError(BaseException):
    """The limit has passed.

    Not an Exception, so that a planner that catches those does not swallow it.
    """


class MachineStalledError(Exception):
    """The machine withheld its processor, so nothing follows about the planner."""


class PlannerError(Exception):
    """A planner raised an exception while it was made or shown, outside its cycles."""


class _StallError(BaseException):
    """Like `DeadlineError`, but through no fault of the planner."""


def processor_wait_s(process: str | int = "self") -> float:
    """Return for how many s a process's main thread has waited for a CPU; 0 if unknown.

    `process` is a process id, "self", or "thread-self" for the thread that calls.
    """
    try:
        # Asked before each cycle of a planner; a file object takes five times as long.
        file = os.open(f"/proc/{process}/schedstat", os.O_RDONLY)
        try:
            schedule = os.read(file, _SCHEDULE_BYTES)
        finally:
            os.close(file)
        # Time on a processor, time waiting for one, both in ns, and a count.
        return int(schedule.split()[1]) / NANOSECONDS_PER_SECOND
    except (OSError, IndexError, ValueError):
        return 0.0


class Deadline:
    """Raises DeadlineError in calls that take longer of their own time than a limit.

    So a planner cannot hang everything. A call's own time is processor time, and time
    in which it waits, but not what is withheld from it: a processor that is busy with
    other processes, or the time of a stopped process, in which no check comes.

    An interval timer makes the checks: in the main thread and while `installed` only,
    elsewhere nothing is limited; and in compiled code not before it returns.
    """

    # Holds from the next call on.
    limit_s = math.inf

    def __init__(self) -> None:
        """Begin without effect: calls are limited while `installed` only."""
        self._armed = False

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Limit calls by SIGALRM in a context in the main thread; elsewhere do nothing.

        The earlier handler comes back at the end.
        """
        with signal_handler(signal.SIGALRM, self._check) as armed:
            self._armed = armed
            try:
                yield
            finally:
                self._armed = False

    def __enter__(self) -> None:
        """Start the interval timer that limits a call; no effect unless installed."""
        if self._armed:
            # An overrun is noticed about a quarter of the limit late, or a second
            # under long limits.
            self._period_s = min(1.0, self.limit_s / 4.0)
            self._processor_s = time.thread_time()
            self._checked_s = 0.0
            self._withheld_s = math.nan
            signal.setitimer(signal.ITIMER_REAL, self._period_s, self._period_s)

    def __exit__(self, *error: object) -> None:
        """Stop the interval timer."""
        if self._armed:
            signal.setitimer(signal.ITIMER_REAL, 0.0)

    def _check(self, _signal: int, _frame: FrameType | None) -> None:
        """Raise DeadlineError if the call is over its limit, _StallError if stalled."""
        # The time withheld counts from the first check on: to ask the system at the
        # start would take longer than a short call.
        withheld_s = processor_wait_s()
        if math.isnan(self._withheld_s):
            self._withheld_s = withheld_s
        else:
            self._checked_s += self._period_s

        processor_s = time.thread_time() - self._processor_s
        call_s = self._checked_s - (withheld_s - self._withheld_s)
        if max(processor_s, call_s) >= self.limit_s:
            raise DeadlineError
        if self._checked_s >= STALLED * self.limit_s:
            raise _StallError


class RunningTrial:
    """The part of a trial that is the same however it is run.

    One process, nodes over ROS or a learner give it each instant's reading, then the
    command that answers it. It reads no clock.

    Attributes:
        spec: What determines the trial.
        referee: Judges the readings.
        log: Collects what the robot does.
        deadline: Limits calls of the planner.
        recoveries: How often the planner began to recover, None without reports.
        traceback: Of the exception that the planner raised.
    """

    def __init__(self, spec: TrialSpec, *, logged: bool = True):
        """Prepare for the first reading.

        Args:
            spec: What determines the trial.
            logged: Whether to collect what the robot does.
        """
        self.spec = spec
        self.referee = Referee(spec.scaled_protocol, spec.course, spec.declared_mps)
        self.log = TrajectoryLog()
        self.deadline = Deadline()
        self.recoveries: int | None = None
        self.traceback = ""
        self._logged = logged
        self._status = ""

    @property
    def verdict(self) -> Verdict | None:
        """Verdict of the referee, None while the trial runs."""
        return self.referee.verdict

    @property
    def scores(self) -> Scores | None:
        """Scores of the verdict, None while the trial runs; computed at each use."""
        verdict = self.verdict
        if verdict is None:
            return None

        # Only the efficiency of a success needs the least time, which takes a search.
        spec = self.spec
        least_s = spec.least_time_s if verdict.outcome is Outcome.SUCCESS else None
        return score_trial(verdict, spec.course, spec.scaled_protocol, least_s)

    def read(
        self, odometry: Odometry, truth: Odometry, collision: bool
    ) -> Verdict | None:
        """Log and judge the readings of an instant; return the verdict or None.

        Args:
            odometry: Measured pose and twist in the odom frame.
            truth: True pose and twist in the map frame; its stamp is the instant's.
            collision: Whether there was a contact since the reading before.
        """
        if self._logged:
            # Plans are in the frame of the planner's map, or else of its odometry.
            protocol = self.spec.protocol
            plan_pose = odometry.pose
            if protocol.map_given:
                plan_pose = Pose2D(0.0, protocol.map_offset_m(), 0.0) @ truth.pose
            self.log.reading(truth, collision, plan_pose)
        return self.referee.observe(
            truth.stamp_ns, odometry.pose, truth.pose, collision
        )

    def command(self, command: Velocity2D) -> Verdict | None:
        """Log and judge the last reading's command; return the verdict or None.

        The command is not sent to the robot.
        """
        if self._logged:
            self.log.command(command)
        return self.referee.command(command)

    def plan(self, points: Floats, stamp_ns: int) -> None:
        """Log a plan for the distance to it, unless it is too soon or malformed.

        Args:
            points: Points (n, 2) in m, in the planning frame.
            stamp_ns: Time of the reading that it answers.
        """
        if self._logged:
            self.log.plan(points, stamp_ns)

    def report(self, status: str) -> None:
        """Count a change of status to recovering; None becomes 0 at the first report.

        `status` is a value of `PlannerStatus`.
        """
        recovering = PlannerStatus.RECOVERING.value
        began = status == recovering and self._status != recovering
        self.recoveries = (self.recoveries or 0) + began
        self._status = status

    def ask(self, call: Callable[[], T], limit_s: float) -> T | None:
        """Return `call()`; None if it raises or is too slow, which ends the trial.

        Args:
            call: Calls the planner.
            limit_s: Longest time of its own that the call may take.

        Returns:
            The answer, None after a failure.

        Raises:
            MachineStalledError: The machine withheld its processor for too long.
        """
        try:
            self.deadline.limit_s = limit_s
            with self.deadline:
                return call()
        except DeadlineError:
            detail = f"no answer within {limit_s:g} s of its own time"
            self.referee.fail(Outcome.PLANNER_STALLED, detail)
        except _StallError:
            raise MachineStalledError(
                f"a cycle had less than {limit_s:g} s of its own in"
                f" {STALLED * limit_s:g} s: the machine stalled"
            ) from None
        except Exception as error:  # whatever it is, it belongs in the result
            self.traceback = format_exc()
            self.referee.fail(Outcome.PLANNER_DIED, describe_error(error))
        return None


@dataclass(frozen=True, eq=False)
class FinishedTrial:
    """A trial that has ended: its specification, result and trajectory."""

    spec: TrialSpec
    result: TrialResult
    trajectory: Trajectory
    # (k, 2) where the world's cylinders stood at the end, if known.
    cylinders_m: Floats | None = None
    traceback: str = ""  # of the exception that the planner raised


def finish_trial(
    spec: TrialSpec,
    mode: str,
    verdict: Verdict,
    trajectory: Trajectory,
    **columns: Any,
) -> FinishedTrial:
    """Return a trial with its row, computing scores and measures; nothing is written.

    Args:
        spec: What determines the trial.
        mode: "direct" or "ros".
        verdict: How it ended.
        trajectory: What the robot did.
        **columns: Further fields of its row.
    """
    world = spec.world
    scores = score_trial(verdict, spec.course, spec.scaled_protocol, spec.least_time_s)
    if spec.least_time_s is None:
        # A mean over the zeros of failures alone would say nothing.
        scores = replace(scores, efficiency=None)
    outline = spec.outline
    result = TrialResult(
        trial_id=spec.trial_id,
        dataset=spec.dataset,
        world=spec.world_number,
        world_name=world.name,
        world_checksum=world.checksum,
        planner=spec.planner,
        preset=spec.preset,
        protocol=spec.protocol.name,
        mode=mode,
        repetition=spec.repetition,
        campaign_seed=spec.run_seed,
        simulator_seed=spec.simulator_seed,
        planner_seed=spec.planner_seed,
        outcome=verdict.outcome,
        detail=verdict.detail[:MAX_TEXT_LENGTH],
        scores=scores,
        measures=measure_trajectory(
            trajectory,
            world.cylinders_m,
            world.cylinder_radius_m,
            outline,
            reports_contacts=spec.system.reports_contacts,
        ),
        task=spec.task,
        planner_config=spec.planner_config,
        metric=spec.metric,
        fault=verdict.fault,
        speed_cap_mps=spec.speed_cap_mps,
        compute=spec.compute_mode,
        motion=measure_encounters(
            trajectory,
            world,
            spec.phase_s,
            outline,
            spec.scaled_protocol,
            verdict.success_time_s,
        ),
        **columns,
    )
    return FinishedTrial(spec, result, trajectory)


def doubt_poses(
    spec: TrialSpec, verdict: Verdict, trajectory: Trajectory
) -> tuple[list[str], float]:
    """Return (remarks on jumps of poses, s by which an arrival may be off).

    Poses that jump farther than a robot drives make all times uncertain. Odometry
    drifts, but earlier the robot was too far from the goal whatever the drift.

    Args:
        spec: The trial.
        verdict: How it ended.
        trajectory: The judged poses.
    """
    truth = trajectory.truth
    stamps_ns = trajectory.stamps_ns
    steps_m = side_lengths(truth)
    is_jump = steps_m > _JUMP_M + _FASTEST_M_PER_NS * np.diff(stamps_ns)
    if is_jump.any():
        jumps = [f"poses jump by {steps_m[is_jump].max():.2f} m"]
        return jumps, seconds(int(np.ptp(stamps_ns)))
    if spec.system.frame != "odom" or verdict.success_time_s is None:
        return [], 0.0
    goal = spec.course.goal
    left_m = np.hypot(truth[:, 0] - goal.x, truth[:, 1] - goal.y)
    left_m -= _ODOMETRY_DRIFT * steps_m.sum()
    is_near = left_m <= spec.scaled_protocol.goal_distance_m
    return [], seconds(int(np.ptp(stamps_ns[np.argmax(is_near) :])))


def describe_error(error: Exception) -> str:
    """Return an error's type, first line of its message, file and line, as one line."""
    text = type(error).__name__
    lines = strip_controls(str(error)).splitlines()
    if lines:
        text = f"{text}: {lines[0]}"[:_MAX_ERROR_LENGTH]
    frames = extract_tb(error.__traceback__)
    if not frames:
        return text
    return f"{text} ({Path(frames[-1].filename).name}, line {frames[-1].lineno})"
