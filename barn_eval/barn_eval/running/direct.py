"""A trial in one process: simulator, planner and bag, without any middleware."""

import resource
import time
import timeit
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from barn_eval.results.bags.messages import TrialBag
from barn_eval.results.bags.recorder import Recorder
from barn_eval.results.store import finish_bag
from barn_eval.trials.result import MEASURED, Outcome, Verdict, WallClock, pack_delays
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trial import (
    FinishedTrial,
    PlannerError,
    RunningTrial,
    describe_error,
    finish_trial,
    processor_wait_s,
)
from barn_planners.interface import Decision, Observation, Planner, PlannerStatus
from barn_planners.registry import make_planner
from barn_planners.runtime.planner_runtime import PlannerRuntime, RuntimeOutput
from barn_sim.contact.scene import ScenePool
from barn_sim.sensors.readings import Sensors
from barn_sim.simulator import Simulator
from barn_worlds.base.compute import CycleTimer
from barn_worlds.base.errors import BarnError, TippedError
from barn_worlds.base.types import STOP, Velocity2D

# What this process has warmed up: ("", "") for simulator and referee, and planners with
# their presets. No result depends on it.
_warm: set[tuple[str, str]] = set()

# Physics clients of all trials of this process; new ones give the same results.
_scenes = ScenePool()

# Wall-clock time that a planner may take to answer [s]. The first answer may have
# kernels to compile.
FIRST_LIMIT_S = 300.0
STALL_LIMIT_S = 30.0

# Time of `reference_loop` on the reference computer, whose cores run at 2 to 3 GHz [s].
NOMINAL_S = 0.006
_REPEATS = 7
_THREAD = "thread-self"  # in /proc


def run_direct_trial(
    spec: TrialSpec, recorder: Recorder | None = None, planner: Planner | None = None
) -> FinishedTrial:
    """Run one trial in this process to its verdict; finish its bag; return the trial.

    Args:
        spec: The trial.
        recorder: Records its bag, which is finished at the end. By default, there is no
            bag.
        planner: Planner object. By default, the planner of the registry that `spec`
            names.
    """
    start_s = time.perf_counter()
    if planner is None:
        with _blame_planner():
            planner = make_planner(spec.entry_name, spec.preset, spec.overrides)
    bag = TrialBag(recorder, spec) if recorder else None
    driver = _DirectTrial(spec, planner, bag)
    # A planner may change how numpy treats rounding errors, which rivals would meet.
    with np.errstate():
        verdict = driver.run()

    duration_s = time.perf_counter() - start_s
    real_time_factor = None
    if driver.cycle_times:
        real_time_factor = verdict.duration_s / duration_s
    wall_clock = WallClock.from_answer_times(
        duration_s,
        real_time_factor,
        [sum(taken) for taken in driver.cycle_times],
        compute_clock="processor",
    )
    trial = driver.trial
    is_measured = spec.compute_mode == MEASURED
    finished = finish_trial(
        spec,
        "direct",
        verdict,
        trial.log.trajectory(),
        wall_clock=wall_clock.with_pace(
            pace(),
            [taken.reference_s(pace()) for taken in driver.cycle_times],
            max(spec.protocol.control_period_s, spec.compute.charged_s),
            spec.compute_mode,
        ),
        recoveries=trial.recoveries or 0,
        delays=pack_delays(driver.cycle_timer.delays_ns) if is_measured else "",
    )
    finished = replace(
        finished, cylinders_m=driver.cylinders_m, traceback=trial.traceback
    )
    if recorder is not None:
        finish_bag(recorder, finished)
    return finished


def warm_up(spec: TrialSpec, *, with_planner: bool) -> None:
    """Compile kernels in a few cycles, once per process; ignore the planner's errors.

    Simulator, referee and planner keep their machine code on disk, where ROS nodes find
    it: on a new machine, they would otherwise compile for longer than anybody waits for
    a node.

    Args:
        spec: A trial with the simulator and the planner.
        with_planner: Whether to run a new planner of the registry as well. One that
            raises an exception fails its trials, which say why.
    """
    if ("", "") not in _warm:
        _warm.add(("", ""))
        simulator = Simulator(
            spec.world, spec.simulator, spec.course.start, spec.simulator_seed
        )
        with closing(simulator):
            simulator.sense()
            sensors = simulator.step(STOP)
            RunningTrial(spec).read(sensors.odometry, sensors.truth, sensors.collision)
    planner_key = (spec.entry_name, spec.preset)
    if with_planner and planner_key not in _warm:
        _warm.add(planner_key)
        with suppress(Exception):
            planner = make_planner(spec.entry_name, spec.preset, spec.overrides)
            PlannerRuntime(planner, seed=0, use_map=spec.protocol.map_given).warm_up()


@contextmanager
def _blame_planner() -> Iterator[None]:
    """Turn exceptions in a context into PlannerError, except the suite's own errors."""
    try:
        yield
    except BarnError:
        raise
    except Exception as error:
        raise PlannerError(describe_error(error)) from error


class _DirectTrial:
    """The loop of a trial: read the sensors, ask the planner, record, step."""

    def __init__(self, spec: TrialSpec, planner: Planner, bag: TrialBag | None):
        """Prepare referee, timer and planner; the simulator is made in `run`."""
        self.trial = RunningTrial(spec)
        self.cycle_times: list[CycleTime] = []
        self.cycle_timer = CycleTimer(spec.compute, spec.planner_seed, spec.recorded_ns)
        self.cylinders_m = spec.world.cylinders_m.copy()
        self._spec = spec
        self._bag = bag
        self._runtime = PlannerRuntime(
            planner, seed=spec.planner_seed, use_map=spec.protocol.map_given
        )

    def run(self) -> Verdict:
        """Run the trial and return its verdict, also after a simulator's error."""
        spec = self._spec
        trial = self.trial
        simulator = Simulator(
            spec.world,
            spec.simulator,
            spec.course.start,
            spec.simulator_seed,
            _scenes,
        )
        with closing(simulator), trial.deadline.installed():
            sensors = simulator.sense()
            trial.ask(self._start_planner, FIRST_LIMIT_S)
            if self._bag is not None:
                self._bag.begin(sensors)
            while True:
                is_free = self.cycle_timer.is_free(sensors.stamp_ns)
                if self._bag is not None:
                    self._bag.reading(sensors, asked=is_free)
                is_over = trial.read(sensors.odometry, sensors.truth, sensors.collision)
                # A planner answers scans, here as over ROS. In between, its last
                # command stays in force.
                has_scan = sensors.scan.stamp_ns == sensors.stamp_ns
                # None leaves the last command in force.
                command: Velocity2D | None = None
                delay_ns = 0
                if has_scan and is_free and not is_over:
                    command, delay_ns = self._decide(sensors)
                self._record_standing(sensors.stamp_ns)
                if trial.verdict is not None:
                    self._conclude(simulator, sensors.stamp_ns)
                    return trial.verdict
                try:
                    readings = simulator.step(command, delay_ns)
                    simulator.require_upright()
                # Whatever the simulator raises belongs in the result.
                except Exception as error:
                    outcome = Outcome.SIMULATOR_DIED
                    detail = describe_error(error)
                    if isinstance(error, TippedError):
                        outcome = Outcome.ROBOT_TIPPED
                        detail = str(error)
                    verdict = trial.referee.fail(outcome, detail)
                    self._record_standing(sensors.stamp_ns)
                    return verdict
                sensors = readings

    def _start_planner(self) -> None:
        """Give the planner its map, if the protocol has one, and its goal."""
        if self._spec.map is not None:
            self._runtime.set_map(self._spec.map)
        self._runtime.set_goal(self._spec.goal)

    def _decide(self, sensors: Sensors) -> tuple[Velocity2D | None, int]:
        """Ask the planner, report its answer; return (command or None, delay [ns])."""
        # Without a map a planner has nothing to be localized in.
        pose = sensors.odometry.pose
        if self._spec.protocol.map_given:
            pose = sensors.localization
        observation = Observation(
            sensors.stamp_ns, sensors.odometry, sensors.scan, pose
        )

        def run_cycle() -> RuntimeOutput:
            """Return the planner's answer, as plain copies, and store the time it took."""
            stopwatch = Stopwatch()
            try:
                return _make_plain(self._runtime.step(observation))
            # A cycle that raises has taken its time as well.
            finally:
                self.cycle_times.append(stopwatch.elapsed())

        limit_s = STALL_LIMIT_S if self.cycle_times else FIRST_LIMIT_S
        answer = self.trial.ask(run_cycle, limit_s)
        measured_ns = None
        if self._spec.compute_mode == MEASURED:
            # Rows keep delays in whole microseconds.
            delay_s = self.cycle_times[-1].reference_s(pace())
            measured_ns = 1000 * round(1e6 * delay_s)
        delay_ns = self.cycle_timer.start_cycle(sensors.stamp_ns, measured_ns)
        if answer is None or answer.decision is None:
            return None, 0

        decision = answer.decision
        self.trial.report(decision.status.value)
        if decision.plan is not None:
            self.trial.plan(decision.plan, sensors.stamp_ns)
        if self._bag is not None:
            with _blame_planner():
                self._bag.answer(
                    answer.command, decision, self._runtime.planner, sensors.stamp_ns
                )
        if answer.command is not None:
            self.trial.command(answer.command)
        return answer.command, delay_ns

    def _record_standing(self, stamp_ns: int) -> None:
        """Record the referee's standing in the bag, if there is a bag."""
        if self._bag is not None:
            self._bag.standing(self.trial.referee, stamp_ns)

    def _conclude(self, simulator: Simulator, stamp_ns: int) -> None:
        """Store the final positions of pushed obstacles, also in the bag if any."""
        moved = simulator.moved_obstacles()
        self.cylinders_m[moved.indices] = moved.positions[:, :2]
        if self._bag is not None:
            self._bag.conclude(self.cylinders_m, stamp_ns)


def _make_plain(answer: RuntimeOutput) -> RuntimeOutput:
    """Return an answer in plain types; TypeError if its command is no Velocity2D.

    A planner's own types could compute or fail when they are read, after its cycle.

    Raises:
        TypeError: The command is not a Velocity2D.
    """
    command = answer.command
    decision = answer.decision
    if command is not None:
        if not isinstance(command, Velocity2D):
            raise TypeError(f"command must be a Velocity2D or None, got {command!r}")
        command = Velocity2D(float(command.linear), float(command.angular))
    if decision is not None:
        plan = decision.plan
        if plan is not None:
            plan = np.array(plan, np.float64)
        status = PlannerStatus(decision.status)
        decision = Decision(
            decision.command, status, decision.reason, plan, decision.diagnostics
        )
    return RuntimeOutput(command, decision)


def reference_loop() -> float:
    """Do a fixed amount of a planner's kind of work, for `pace` to time.

    That is plain Python and small arrays. The sum that it returns has no use.
    """
    total = 0.0
    ranges = np.linspace(0.1, 10.0, 720)
    for k in range(1600):
        near = np.minimum(ranges, 1.0 + 0.0025 * k)
        total += float(near @ ranges) + sum(i * 0.5 for i in range(60))
    return total


@cache
def pace() -> float:
    """Return this processor's speed over the reference's, above 1 if faster; cached."""
    return measure_pace(time.thread_time)


def measure_pace(clock: Callable[[], float]) -> float:
    """Return the speed by `clock` over the reference computer's, above 1 if faster.

    Args:
        clock: Returns seconds of processor time: what other processes take from a
            planner is not charged, so it must not make the processor look slow.
    """
    # The minimum has the least interference from other processes.
    times_s = timeit.repeat(reference_loop, timer=clock, number=1, repeat=_REPEATS)
    return NOMINAL_S / max(min(times_s), 1e-6)


class CycleTime(NamedTuple):
    """What a cycle of a planner took, in s."""

    processor_s: float
    waited_s: float  # by its own doing: a sleep, a graphics card, another thread

    def reference_s(self, pace: float) -> float:
        """Return the cycle's time in s on the reference computer; waits are not scaled.

        A sleep is as long on any processor, so waiting is not scaled.

        Args:
            pace: Reference seconds per second of this processor.
        """
        return pace * self.processor_s + self.waited_s


class Stopwatch:
    """Measures the time that this thread takes from construction on.

    It measures processor time, and the time in which the thread waits by its own doing.
    What other work on the machine takes from it costs nothing.
    """

    def __init__(self) -> None:
        """Start to measure this thread's processor time and the wall clock's."""
        self._wait_count = _count_waits()
        self._withheld_s = processor_wait_s(_THREAD)
        self._processor_s = time.thread_time()
        # Reading the other clock takes microseconds, so this one is read last here and
        # first in `elapsed`.
        self._wall_s = time.perf_counter()

    def elapsed(self) -> CycleTime:
        """Return this thread's processor time and own waiting time so far."""
        wall_s = time.perf_counter() - self._wall_s
        processor_s = min(time.thread_time() - self._processor_s, wall_s)
        if _count_waits() == self._wait_count:
            return CycleTime(processor_s, 0.0)
        withheld_s = processor_wait_s(_THREAD) - self._withheld_s
        return CycleTime(processor_s, max(0.0, wall_s - processor_s - withheld_s))


def _count_waits() -> int:
    """Return how often this thread has given its processor away to wait."""
    return resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
