"""A trial as it passes, whoever runs it: readings and answers go in; verdict, trajectory and row come out."""

import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from traceback import extract_tb, format_exc
from types import FrameType
from typing import Any, TypeVar

from barn_eval.trials.outcome import Outcome, Scores, Verdict, score_trial
from barn_eval.trials.referee import Referee
from barn_eval.trials.result import TrialResult
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trajectory import (
    Trajectory,
    TrajectoryLog,
    measure_encounters,
    measure_trajectory,
)
from barn_planners.interface import PlannerStatus
from barn_worlds.base.arrays import Floats
from barn_worlds.base.types import NANOSECONDS_PER_SECOND, Odometry, Pose2D, Velocity2D
from barn_worlds.robots.contact import contact_footprint

T = TypeVar("T")


@contextmanager
def signal_handler(
    number: int, handler: Callable[[int, FrameType | None], None]
) -> Iterator[bool]:
    """Handle a signal while the context lasts and give whether that is so: only the main thread can."""
    if threading.current_thread() is not threading.main_thread():
        yield False
        return
    before = signal.signal(number, handler)
    try:
        yield True
    finally:
        signal.signal(number, before)


class DeadlineError(BaseException):
    """The limit has passed; not an Exception, so that a planner that catches those does not swallow it."""


class MachineStalledError(Exception):
    """The machine gave a planner so little of its processor that nothing can be said of the planner."""


class _Stalled(BaseException):
    """As `DeadlineError`, by no fault of the planner."""


STALLED = 10.0  # wall-clock time in multiples of a limit after which the machine, not the planner, is given up
MAX_TEXT_LENGTH = 2000  # characters of what a planner may have said, in a row


def processor_wait_s(process: str | int = "self") -> float:
    """Return how long the main thread of a process has waited for a processor, 0 where the system does not tell."""
    try:
        return (
            int(Path(f"/proc/{process}/schedstat").read_text("ascii").split()[1])
            / NANOSECONDS_PER_SECOND
        )
    except (OSError, IndexError, ValueError):
        return 0.0


class Deadline:
    """Raises DeadlineError in calls that take longer of their own time, so that a planner cannot hang everything.

    Own is processor time, and time in which a call waits; not what is withheld from it. A processor that is busy with
    others is withheld, and so is the time of a process that is stopped, in which no look comes. Waiting counts from the
    first look on: before, nobody asks the system, which takes longer than short work.

    Works by an interval timer: in the main thread and while `installed` only (elsewhere nothing is limited), and in
    compiled code not before it returns. limit_s: holds from the next call on.
    """

    limit_s = math.inf

    def __init__(self) -> None:
        self._armed = False

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Take over the alarm signal, and give it back at the end."""
        with signal_handler(signal.SIGALRM, self._look) as armed:
            self._armed = armed
            try:
                yield
            finally:
                self._armed = False

    def __enter__(self) -> None:
        """Begin to count."""
        if self._armed:
            self._period_s = min(1.0, self.limit_s / 4.0)
            self._used_s, self._seen_s, self._queued_s = (
                time.thread_time(),
                0.0,
                math.nan,
            )
            signal.setitimer(signal.ITIMER_REAL, self._period_s, self._period_s)

    def __exit__(self, *error: object) -> None:
        """Stop counting."""
        if self._armed:
            signal.setitimer(signal.ITIMER_REAL, 0.0)

    def _look(self, _signal: int, _frame: FrameType | None) -> None:
        queued = processor_wait_s()
        if math.isnan(self._queued_s):
            self._queued_s = queued
        else:
            self._seen_s += self._period_s
        if (
            max(
                time.thread_time() - self._used_s,
                self._seen_s - (queued - self._queued_s),
            )
            >= self.limit_s
        ):
            raise DeadlineError
        if self._seen_s >= STALLED * self.limit_s:
            raise _Stalled


class RunningTrial:
    """The part of a trial that is the same however it is run: a session in one process, over ROS, or by a learner.

    Instant by instant it takes the reading, then the command that answers it. It reads no clock. recoveries: how often
    the planner began to recover, None if it has not said how it fares. traceback: of the exception that it raised.
    """

    def __init__(self, spec: TrialSpec, *, logged: bool = True) -> None:
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
        """The verdict, None while the trial runs."""
        return self.referee.verdict

    @property
    def scores(self) -> Scores | None:
        """What the verdict is worth, None while the trial runs; only for a success the least time is looked for."""
        verdict, spec = self.verdict, self.spec
        if verdict is None:
            return None
        least_s = spec.least_time_s if verdict.outcome is Outcome.SUCCESS else None
        return score_trial(verdict, spec.course, spec.protocol, least_s)

    def read(
        self, odometry: Odometry, truth: Odometry, collision: bool
    ) -> Verdict | None:
        """Take what is measured at an instant, of which the stamp is that of the truth; return the verdict by now."""
        if self._logged:
            rules = (
                self.spec.protocol
            )  # by which the frame of plans is that of a map, or else of the odometry
            place = (
                Pose2D(0.0, rules.map_offset_m(), 0.0) @ truth.pose
                if rules.map_given
                else odometry.pose
            )
            self.log.reading(truth, collision, place)
        return self.referee.observe(
            truth.stamp_ns, odometry.pose, truth.pose, collision
        )

    def command(self, command: Velocity2D) -> Verdict | None:
        """Take the command that answers the last reading; return the verdict by now."""
        if self._logged:
            self.log.command(command)
        return self.referee.command(command)

    def plan(self, points: Floats, stamp_ns: int) -> None:
        """Take a plan (n, 2) of the planner, in its planning frame."""
        if self._logged:
            self.log.plan(points, stamp_ns)

    def report(self, status: str) -> None:
        """Take what the planner says of how it fares, a value of `PlannerStatus`."""
        began = status == PlannerStatus.RECOVERING.value != self._status
        self.recoveries = (self.recoveries or 0) + began
        self._status = status

    def ask(self, call: Callable[[], T], limit_s: float) -> T | None:
        """Call the planner within a limit and return its answer; what goes wrong there ends the trial."""
        try:
            self.deadline.limit_s = limit_s
            with self.deadline:
                return call()
        except DeadlineError:
            detail = f"no answer within {limit_s:g} s of its own time"
            self.referee.fail(Outcome.PLANNER_STALLED, detail)
        except _Stalled:
            text = f"a cycle had less than {limit_s:g} s of its own in {STALLED * limit_s:g} s: the machine stalled"
            raise MachineStalledError(text) from None
        except Exception as error:  # whatever it is, it belongs in the result
            self.traceback = format_exc()
            self.referee.fail(Outcome.PLANNER_DIED, describe_error(error))
        return None


@dataclass(frozen=True, eq=False)
class FinishedTrial:
    """A trial that has ended: what was asked for, the result, and what the robot did."""

    spec: TrialSpec
    result: TrialResult
    trajectory: Trajectory
    cylinders_m: Floats | None = (
        None  # (k, 2) where the world's cylinders stood at the end, if known
    )
    traceback: str = ""  # of the exception that the planner raised


def finish_trial(
    spec: TrialSpec, mode: str, verdict: Verdict, trajectory: Trajectory, **told: Any
) -> FinishedTrial:
    """Return the finished trial with scores and measures; mode is "direct" or "ros", `told` more fields of its row."""
    world, scores = (
        spec.world,
        score_trial(verdict, spec.course, spec.protocol, spec.least_time_s),
    )
    traversal_s = scores.traversal_time_s if scores.success else None
    outline = contact_footprint(spec.simulator.chassis)
    result = TrialResult(
        trial_id=spec.trial_id,
        dataset=spec.dataset,
        planner=spec.planner,
        preset=spec.preset,
        repetition=spec.repetition,
        campaign_seed=spec.run_seed,
        simulator_seed=spec.simulator_seed,
        planner_seed=spec.planner_seed,
        task=spec.task,
        planner_config=spec.planner_config,
        world=spec.world_number,
        world_name=world.name,
        world_checksum=world.checksum,
        protocol=spec.protocol.name,
        mode=mode,
        outcome=verdict.outcome,
        detail=verdict.detail[:MAX_TEXT_LENGTH],
        scores=scores,
        measures=measure_trajectory(
            trajectory, world.cylinders_m, world.cylinder_radius_m, outline
        ),
        metric=spec.protocol.metric,
        fault=verdict.fault,
        speed_cap_mps=spec.speed_cap_mps,
        compute=spec.compute_mode,
        motion=measure_encounters(
            trajectory, world, spec.phase_s, outline, spec.scaled_protocol, traversal_s
        ),
        **told,
    )
    return FinishedTrial(spec, result, trajectory)


def describe_error(error: Exception) -> str:
    """Return an error of a planner or simulator in one line, with where it was raised, for the detail of a verdict."""
    lines = str(error).splitlines()
    said = (
        f"{type(error).__name__}: {lines[0]}"[:300] if lines else type(error).__name__
    )
    frames = extract_tb(error.__traceback__)
    return (
        f"{said} ({Path(frames[-1].filename).name}, line {frames[-1].lineno})"
        if frames
        else said
    )
