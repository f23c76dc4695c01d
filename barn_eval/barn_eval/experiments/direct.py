"""A trial in one process: simulator, planner, referee and recorder in one loop, without any middleware."""

import time
from collections.abc import Callable
from contextlib import closing, suppress
from typing import TypeVar

from barn_eval.bags.recorder import Recorder
from barn_eval.bags.trial_bag import TrialBag
from barn_eval.experiments.store import finish_bag
from barn_eval.trials.deadline import Deadline, DeadlineError
from barn_eval.trials.outcome import Outcome, Verdict
from barn_eval.trials.referee import Reading, Referee
from barn_eval.trials.result import WallClock
from barn_eval.trials.spec import FinishedTrial, TrialSpec, conclude
from barn_eval.trials.trajectory import TrajectoryLog
from barn_planners.interface import Observation, Planner, PlannerStatus
from barn_planners.registry import make_planner
from barn_planners.runtime.session import Answer, PlannerSession
from barn_sim.body.bullet import PhysicsClient
from barn_sim.sensors.readings import Sensors
from barn_sim.simulator import Simulator
from barn_worlds.base.types import STOP, Velocity2D

T = TypeVar("T")
_ready: set[tuple[str, str]] = set()  # what this process has warmed up; it decides no result
_engine = PhysicsClient()  # of all trials of this process, one after the other; a new one would give the same

# Wall-clock time that a planner may take to answer; the first time it may have kernels to compile.
FIRST_LIMIT_S, STALL_LIMIT_S = 300.0, 30.0


def run_direct_trial(
    spec: TrialSpec, recorder: Recorder | None = None, planner: Planner | None = None
) -> FinishedTrial:
    """Run one trial to its verdict; whatever the planner does, it ends in an outcome.

    recorder: gets the bag, which is finished here. planner: used instead of a new one from the registry.
    """
    began = time.perf_counter()
    planner = planner or make_planner(spec.planner, spec.preset, spec.overrides)
    trial = _DirectTrial(spec, planner, TrialBag(recorder, spec) if recorder else None)
    verdict = trial.run()
    duration_s = time.perf_counter() - began
    factor = verdict.duration_s / duration_s if trial.cycle_times_s else None
    finished = conclude(
        spec,
        "direct",
        verdict,
        trial.log.trajectory(),
        wall_clock=WallClock.of(duration_s, trial.cycle_times_s, factor),
        recoveries=trial.recoveries,
        cylinders_m=trial.cylinders_m,
    )
    if recorder is not None:
        finish_bag(recorder, finished)
    return finished


def warm_up(spec: TrialSpec, *, with_planner: bool) -> None:
    """Let the simulator, and a new planner of the trial's kind, do a few cycles, once per process.

    The machine code of their kernels is also kept on disk, where nodes of ROS find it: on a new machine they would else
    be busy compiling for longer than anybody waits for a node. A planner that does not survive this fails its trials,
    which say why.
    """
    if ("", "") not in _ready:
        _ready.add(("", ""))
        with closing(Simulator(spec.world, spec.simulator, spec.course.start, spec.simulator_seed)) as simulator:
            simulator.sense()
            simulator.step(STOP)
    if with_planner and (spec.planner, spec.preset) not in _ready:
        _ready.add((spec.planner, spec.preset))
        planner = make_planner(spec.planner, spec.preset, spec.overrides)
        with suppress(Exception):  # the trials report it
            PlannerSession(planner, seed=0, use_map=spec.protocol.map_given).warm_up()


class _DirectTrial:
    def __init__(self, spec: TrialSpec, planner: Planner, bag: TrialBag | None) -> None:
        self.log = TrajectoryLog()
        self.cycle_times_s: list[float] = []
        self.recoveries = 0
        self.cylinders_m = spec.world.cylinders_m
        self._spec = spec
        self._session = PlannerSession(planner, seed=spec.planner_seed, use_map=spec.protocol.map_given)
        self._bag = bag
        self._status = PlannerStatus.RUNNING
        self._referee = Referee(spec.rules, spec.course)
        self._deadline = Deadline(FIRST_LIMIT_S)

    def run(self) -> Verdict:
        spec, referee = self._spec, self._referee
        with (
            closing(
                Simulator(spec.world, spec.simulator, spec.course.start, spec.simulator_seed, _engine)
            ) as simulator,
            self._deadline.installed(),
        ):
            sensors = simulator.sense()
            self._start_planner()
            if self._bag is not None:
                self._bag.begin(sensors)
            while True:
                self._take(sensors)
                command = None if referee.verdict else self._decide(sensors)
                self._show_standing(sensors.stamp_ns)
                if referee.verdict is not None:
                    self._see_moved(simulator, sensors.stamp_ns)
                    return referee.verdict
                try:
                    sensors = simulator.step(command)
                except Exception as error:  # whatever it is, it belongs in the result
                    verdict = referee.fail(Outcome.SIMULATOR_DIED, _one_line(error))
                    self._show_standing(sensors.stamp_ns)
                    return verdict

    def _see_moved(self, simulator: Simulator, stamp_ns: int) -> None:
        moved = simulator.moved_obstacles()
        self.cylinders_m = self.cylinders_m.copy()
        self.cylinders_m[moved.indices] = moved.positions[:, :2]
        if self._bag is not None:
            self._bag.conclude(self.cylinders_m, stamp_ns)

    def _start_planner(self) -> None:
        """Hand the planner its map and its goal, on which it begins."""
        known = self._spec.map
        if known is not None:
            self._guarded(lambda: self._session.set_map(known))
        self._guarded(lambda: self._session.set_goal(self._spec.goal))

    def _take(self, sensors: Sensors) -> None:
        if self._bag is not None:
            self._bag.reading(sensors)
        self.log.reading(sensors.truth, sensors.collision)
        self._referee.observe(Reading(sensors.stamp_ns, sensors.odometry.pose, sensors.truth.pose, sensors.collision))

    def _show_standing(self, stamp_ns: int) -> None:
        if self._bag is not None:
            self._bag.standing(self._referee.standing, stamp_ns)

    def _decide(self, sensors: Sensors) -> Velocity2D | None:
        pose = sensors.localisation if self._spec.protocol.map_given else sensors.odometry.pose
        observation = Observation(sensors.stamp_ns, sensors.odometry, sensors.scan, pose)
        began = time.perf_counter()
        answer = self._guarded(lambda: _checked(self._session.answer(observation)))
        self.cycle_times_s.append(time.perf_counter() - began)
        self._deadline.limit_s = STALL_LIMIT_S
        if answer is None or answer.decision is None:
            return None
        decision, command = answer.decision, answer.command
        self.recoveries += decision.status is PlannerStatus.RECOVERING is not self._status
        self._status = decision.status
        if self._bag is not None:
            self._bag.answer(command, decision, self._session.planner, sensors.stamp_ns)
        if command is not None:
            self.log.command(command)
            self._referee.command(command)
        return command

    def _guarded(self, call: Callable[[], T]) -> T | None:
        """Call the planner and turn what goes wrong there into an outcome."""
        try:
            with self._deadline:
                return call()
        except DeadlineError:
            self._referee.fail(
                Outcome.PLANNER_STALLED, f"no answer within {self._deadline.limit_s:g} s of wall-clock time"
            )
        except Exception as error:  # whatever it is, it belongs in the result
            self._referee.fail(Outcome.PLANNER_DIED, _one_line(error))
        return None


def _checked(answer: Answer) -> Answer:
    if not isinstance(answer.command, (Velocity2D, type(None))):
        raise TypeError(f"command must be a Velocity2D or None, got {answer.command!r}")
    return answer


def _one_line(error: Exception) -> str:
    lines = str(error).splitlines()
    return f"{type(error).__name__}: {lines[0]}"[:300] if lines else type(error).__name__
