"""A trial in one process: simulator, planner and bag around one `RunningTrial`, without any middleware."""

import resource
import time
import timeit
from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import replace
from functools import cache

import numpy as np

from barn_eval.results.bags.messages import TrialBag
from barn_eval.results.bags.recorder import Recorder
from barn_eval.results.store import finish_bag
from barn_eval.trials.outcome import Outcome, Verdict
from barn_eval.trials.result import MEASURED, WallClock, pack_delays
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trial import (
    FinishedTrial,
    RunningTrial,
    describe_error,
    finish_trial,
)
from barn_planners.interface import Observation, Planner
from barn_planners.registry import make_planner
from barn_planners.runtime.planner_runtime import PlannerRuntime, RuntimeOutput
from barn_sim.contact.scene import ScenePool
from barn_sim.sensors.readings import Sensors
from barn_sim.simulator import Simulator
from barn_worlds.base.compute import CycleTimer
from barn_worlds.base.types import STOP, Velocity2D

_ready: set[tuple[str, str]] = (
    set()
)  # what this process has warmed up; it decides no result
# Physics clients of all trials of this process; new ones would give the same results.
_scenes = ScenePool()

# Wall-clock time that a planner may take to answer; the first time it may have kernels to compile.
FIRST_LIMIT_S, STALL_LIMIT_S = 300.0, 30.0

NOMINAL_S = (
    0.006  # of the fixed loop on the reference computer, whose cores are at 2 to 3 GHz
)
_REPEATS = 7


def run_direct_trial(
    spec: TrialSpec, recorder: Recorder | None = None, planner: Planner | None = None
) -> FinishedTrial:
    """Run one trial to its verdict, with a bag that is finished here; whatever a planner does, there is an outcome."""
    began = time.perf_counter()
    planner = planner or make_planner(spec.planner, spec.preset, spec.overrides)
    run = _DirectTrial(spec, planner, [TrialBag(recorder, spec)] if recorder else [])
    verdict = run.run()
    duration_s = time.perf_counter() - began
    factor = verdict.duration_s / duration_s if run.answer_times_s else None
    clock = WallClock.from_answer_times(duration_s, factor, run.answer_times_s)
    finished = finish_trial(
        spec,
        "direct",
        verdict,
        run.trial.log.trajectory(),
        wall_clock=clock.with_pace(
            pace(),
            max(spec.protocol.control_period_s, spec.compute.charged_s),
            spec.compute_mode,
        ),
        recoveries=run.trial.recoveries or 0,
        delays=pack_delays(run.cycle_timer.delays_ns)
        if spec.compute_mode == MEASURED
        else "",
    )
    finished = replace(
        finished, cylinders_m=run.cylinders_m, traceback=run.trial.traceback
    )
    if recorder is not None:
        finish_bag(recorder, finished)
    return finished


def warm_up(spec: TrialSpec, *, with_planner: bool) -> None:
    """Let simulator and referee, and a new planner of the trial's kind, do a few cycles, once per process.

    The machine code of their kernels is also kept on disk, where nodes of ROS find it: on a new machine they would else
    be busy compiling for longer than anybody waits for a node. A planner that does not survive this fails its trials,
    which say why.
    """
    if ("", "") not in _ready:
        _ready.add(("", ""))
        with closing(
            Simulator(
                spec.world, spec.simulator, spec.course.start, spec.simulator_seed
            )
        ) as simulator:
            simulator.sense()
            sensors = simulator.step(STOP)
            RunningTrial(spec).read(sensors.odometry, sensors.truth, sensors.collision)
    if with_planner and (spec.planner, spec.preset) not in _ready:
        _ready.add((spec.planner, spec.preset))
        planner = make_planner(spec.planner, spec.preset, spec.overrides)
        with suppress(Exception):  # the trials report it
            PlannerRuntime(planner, seed=0, use_map=spec.protocol.map_given).warm_up()


class _DirectTrial:
    """The loop of a trial: read, ask, record, step. bags: the one that is recorded, or none."""

    def __init__(
        self, spec: TrialSpec, planner: Planner, bags: Sequence[TrialBag]
    ) -> None:
        self.trial = RunningTrial(spec)
        self.answer_times_s: list[float] = []
        self.cycle_timer = CycleTimer(spec.compute, spec.planner_seed, spec.recorded_ns)
        self.cylinders_m = spec.world.cylinders_m.copy()
        self._spec, self._bags = spec, bags
        self._runtime = PlannerRuntime(
            planner, seed=spec.planner_seed, use_map=spec.protocol.map_given
        )

    def run(self) -> Verdict:
        spec, trial = self._spec, self.trial
        simulator = Simulator(
            spec.world, spec.simulator, spec.course.start, spec.simulator_seed, _scenes
        )
        with closing(simulator), trial.deadline.installed():
            sensors = simulator.sense()
            trial.ask(self._start_planner, FIRST_LIMIT_S)
            for bag in self._bags:
                bag.begin(sensors)
            while True:
                for bag in self._bags:
                    bag.reading(
                        sensors, asked=self.cycle_timer.is_free(sensors.stamp_ns)
                    )
                over = trial.read(sensors.odometry, sensors.truth, sensors.collision)
                # a planner answers scans, here as over ROS; in between its last command stays in force
                scanned = sensors.scan.stamp_ns == sensors.stamp_ns
                busy = (
                    over
                    or not scanned
                    or not self.cycle_timer.is_free(sensors.stamp_ns)
                )
                command, delay_ns = (None, 0) if busy else self._decide(sensors)
                self._show_standing(sensors.stamp_ns)
                if trial.verdict is not None:
                    self._see_moved(simulator, sensors.stamp_ns)
                    return trial.verdict
                try:
                    sensors = simulator.step(command, delay_ns)
                except Exception as error:  # whatever it is, it belongs in the result
                    verdict = trial.referee.fail(
                        Outcome.SIMULATOR_DIED, describe_error(error)
                    )
                    self._show_standing(sensors.stamp_ns)
                    return verdict

    def _start_planner(self) -> None:
        """Hand the planner its map and its goal, on which it begins."""
        if self._spec.map is not None:
            self._runtime.set_map(self._spec.map)
        self._runtime.set_goal(self._spec.goal)

    def _decide(self, sensors: Sensors) -> tuple[Velocity2D | None, int]:
        """Return the command that answers readings, None where there is none, and after how many ns it arrives."""
        pose = (
            sensors.localization
            if self._spec.protocol.map_given
            else sensors.odometry.pose
        )
        observation = Observation(
            sensors.stamp_ns, sensors.odometry, sensors.scan, pose
        )

        def cycle() -> RuntimeOutput:
            stopwatch = Stopwatch()
            try:
                return _checked(self._runtime.step(observation))
            finally:
                self.answer_times_s.append(stopwatch.elapsed_s())

        answer = self.trial.ask(
            cycle, STALL_LIMIT_S if self.answer_times_s else FIRST_LIMIT_S
        )
        # in whole microseconds, as they are kept
        measured_ns = (
            1000 * round(1e6 * pace() * self.answer_times_s[-1])
            if self._spec.compute_mode == MEASURED
            else None
        )
        delay_ns = self.cycle_timer.start_cycle(sensors.stamp_ns, measured_ns)
        if answer is None or answer.decision is None:
            return None, 0
        self.trial.report(answer.decision.status.value)
        if answer.decision.plan is not None:
            self.trial.plan(answer.decision.plan, sensors.stamp_ns)
        for bag in self._bags:
            bag.answer(
                answer.command, answer.decision, self._runtime.planner, sensors.stamp_ns
            )
        if answer.command is not None:
            self.trial.command(answer.command)
        return answer.command, delay_ns

    def _show_standing(self, stamp_ns: int) -> None:
        for bag in self._bags:
            bag.standing(self.trial.referee.standing, stamp_ns)

    def _see_moved(self, simulator: Simulator, stamp_ns: int) -> None:
        moved = simulator.moved_obstacles()
        self.cylinders_m[moved.indices] = moved.positions[:, :2]
        for bag in self._bags:
            bag.conclude(self.cylinders_m, stamp_ns)


def _checked(answer: RuntimeOutput) -> RuntimeOutput:
    if not isinstance(answer.command, (Velocity2D, type(None))):
        raise TypeError(f"command must be a Velocity2D or None, got {answer.command!r}")
    return answer


def reference_loop() -> float:
    """Do a fixed amount of work as planners have it, plain Python and small arrays, and return its result."""
    total, ranges = 0.0, np.linspace(0.1, 10.0, 720)
    for k in range(1600):
        near = np.minimum(ranges, 1.0 + 0.0025 * k)
        total += float(near @ ranges) + sum(i * 0.5 for i in range(60))
    return total


@cache
def pace() -> float:
    """Return reference seconds per second of this processor, measured once per process: above 1 on a faster one."""
    return NOMINAL_S / max(
        min(timeit.repeat(reference_loop, time.thread_time, number=1, repeat=_REPEATS)),
        1e-6,
    )


class Stopwatch:
    """Times what this thread does from the moment that it is made.

    That is the processor's time, so that other work on the machine costs nothing; but the wall clock's where the thread
    gave its processor away to wait: for a graphics card, another thread, a sleep.
    """

    def __init__(self) -> None:
        self._waits, self._used_s = _waits(), time.thread_time()
        self._wall_s = (
            time.perf_counter()
        )  # last here and first below: reading the other clock takes microseconds

    def elapsed_s(self) -> float:
        """Return the time so far."""
        wall_s = time.perf_counter() - self._wall_s
        used_s = time.thread_time() - self._used_s
        return wall_s if _waits() > self._waits else min(used_s, wall_s)


def _waits() -> int:
    return resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
