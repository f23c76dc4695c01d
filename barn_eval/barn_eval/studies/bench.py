"""Measure the speed of the suite on this machine, mostly as multiples of real time.

Figures use the processor time of one process, so other work on the machine changes them
little; trials over ROS use wall-clock time. All figures are measured once per round. A
figure is the best of its rounds; their range shows how exact it is.
"""

from __future__ import annotations

import math
import time
import timeit
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from barn_eval.learning.config import EnvConfig
from barn_eval.results.bags.recorder import Recorder
from barn_eval.results.store import BagStore
from barn_eval.ros.isolation import ros_problem
from barn_eval.running.direct import run_direct_trial
from barn_eval.trials.result import WallClock
from barn_eval.trials.run_config import PlannerChoice, RunConfig
from barn_eval.trials.spec import TrialSpec
from barn_planners.policy.space import PolicyObservation
from barn_planners.registry import planner_config
from barn_sim.simulator import Simulator
from barn_worlds.base.arrays import Floats
from barn_worlds.base.config import Checked, from_dict, quantity, replace_dotted
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.files import read_json
from barn_worlds.base.types import Velocity2D
from barn_worlds.datasets.dataset import open_dataset

if TYPE_CHECKING:
    from barn_eval.learning.environment import JackalEnv

_SIMULATOR_CYCLES = 200
_ENVIRONMENT_STEPS = 500
_BATCH = 64
_BATCH_STEPS = _ENVIRONMENT_STEPS // 5
_BATCH_WARM_UP_STEPS = 300
_REAL_TIME = "x real time"


@dataclass(frozen=True)
class Measurement:
    """One measured figure."""

    name: str
    value: float
    unit: str
    # Which values are better: "higher" or "lower".
    better: str = "higher"
    # Values of all rounds; `value` is the best of them.
    samples: tuple[float, ...] = ()

    @property
    def noise(self) -> float:
        """Range of the samples as a share of the value, 0 for one sample."""
        if not self.samples or not self.value:
            return 0.0
        return (max(self.samples) - min(self.samples)) / abs(self.value)


def best_of(rounds: Sequence[Measurement]) -> Measurement:
    """Return a figure's best measurement, with the values of all as its samples."""
    values = tuple(measurement.value for measurement in rounds)
    best = max(values) if rounds[0].better == "higher" else min(values)
    return replace(rounds[0], value=best, samples=values)


@dataclass(frozen=True)
class Change:
    """How a figure has changed; a ratio above 1 is an improvement."""

    name: str
    ratio: float
    # Part of the ratio that may be noise.
    noise: float

    @property
    def slower(self) -> bool:
        """Whether the figure has become worse by more than the noise."""
        return self.ratio < 1.0 - self.noise


def changes(now: Sequence[Measurement], before: Sequence[Measurement]) -> list[Change]:
    """Return changes of figures that are positive in both; a ratio above 1 is better.

    Args:
        now: Figures of the newer benchmark.
        before: Figures of the older one.

    Returns:
        A change for each figure that is positive in both.
    """
    earlier = {figure.name: figure for figure in before if figure.value > 0.0}
    compared = []
    for figure in now:
        if figure.name not in earlier or figure.value <= 0.0:
            continue
        base = earlier[figure.name]
        ratio = figure.value / base.value
        if figure.better == "lower":
            ratio = base.value / figure.value
        # The noises of both benchmarks are independent of each other.
        noise = math.hypot(figure.noise, base.noise)
        compared.append(Change(figure.name, ratio, noise))
    return compared


def read_figures(path: Path) -> list[Measurement]:
    """Read the figures of `barn bench --json`; ConfigError if the file has others.

    Raises:
        ConfigError: If the file has other content.
    """
    try:
        figures = read_json(path)["figures"]
        return [
            from_dict(Measurement, figure, f"figures[{number}]")
            for number, figure in enumerate(figures)
        ]
    except (ConfigError, KeyError, TypeError) as error:
        raise ConfigError(
            f"--against {path}: not a result of barn bench --json ({error})"
        ) from None


@dataclass(frozen=True)
class BenchSetup(Checked):
    """What `bench` measures."""

    dataset: str = quantity("barn300", "data set that contains the world")
    world: int = quantity(
        -1,
        "world of the trials; -1: the world in the middle of the data set",
        "",
        -1,
        1_000_000_000,
    )
    repeats: int = quantity(3, "number of rounds; the best round counts", "", 1, 100)
    ros: bool = quantity(True, "measure a trial over ROS if rclpy is installed")


def bench(
    planners: Sequence[str] = ("dwa", "eband"),
    settings: Mapping[str, object] | None = None,
    *,
    note: Callable[[str], None] = lambda _: None,
) -> Iterator[Measurement]:
    """Measure the suite's speed in rounds, then yield each figure, the best of its rounds.

    Args:
        planners: Planners to measure.
        settings: Fields of `BenchSetup`.
        note: Called with a line about each measurement of each round.

    Raises:
        BarnError: If a planner or a setting is unknown.
    """
    for name in planners:
        planner_config(name)
    setup = replace_dotted(BenchSetup(), settings or {}, "settings")

    # A round measures all figures, so a slow minute of the machine affects each once.
    rounds = []
    for number in range(1, setup.repeats + 1):
        figures = []
        for figure in _measure_all(setup, planners):
            progress = f"round {number} of {setup.repeats}"
            note(f"{progress}: {figure.name}, {figure.value:.3g} {figure.unit}")
            figures.append(figure)
        rounds.append(figures)
    for same_figure in zip(*rounds, strict=True):
        yield best_of(same_figure)


def _measure_all(setup: BenchSetup, planners: Sequence[str]) -> Iterator[Measurement]:
    """Measure every figure once and yield it; optional parts only if installed."""
    world = setup.world
    if world < 0:
        world_numbers = open_dataset(setup.dataset).world_numbers
        world = world_numbers[len(world_numbers) // 2]
    runs = [
        RunConfig(
            dataset=setup.dataset, worlds=str(world), planners=(PlannerChoice(name),)
        )
        for name in planners
    ]
    for run in runs:
        yield from _measure_direct(run.trials()[0])
    yield from _measure_simulator(runs[0].trials()[0])
    if find_spec("gymnasium") is not None:
        yield from _measure_environments(setup.dataset)
    if setup.ros and not ros_problem():
        yield _measure_ros(runs[0])


def _measure_direct(spec: TrialSpec) -> Iterator[Measurement]:
    """Yield figures of direct trials without and with a bag, and of planner cycles."""
    planner = spec.planner
    # The first trial compiles and loads what the second one uses.
    trials = [_run_direct(spec) for _ in range(2)]
    factor = max(factor for _, factor in trials)
    yield Measurement(f"direct trial, {planner}", factor, _REAL_TIME)

    with TemporaryDirectory() as folder, Recorder(Path(folder) / "bag") as recorder:
        _, factor = _run_direct(spec, recorder)
    yield Measurement(f"direct trial with bag, {planner}", factor, _REAL_TIME)

    for name in ("p50", "p95"):
        value = min(getattr(clock, f"compute_{name}_ms") for clock, _ in trials)
        yield Measurement(f"planner cycle {name}, {planner}", value, "ms", "lower")


def _run_direct(
    spec: TrialSpec, recorder: Recorder | None = None
) -> tuple[WallClock, float]:
    """Drive a trial; return (its wall-clock figures, simulated s per processor s)."""
    start_s = time.process_time()
    result = run_direct_trial(spec, recorder).result
    processor_s = time.process_time() - start_s
    return result.wall_clock, result.scores.duration_s / processor_s


def _measure_simulator(spec: TrialSpec) -> Iterator[Measurement]:
    """Yield the simulator's speed, static and movable obstacles, driving in a circle."""
    # Around a circle.
    commands = [Velocity2D(0.3, 1.0)] * _SIMULATOR_CYCLES
    for name, movable in (("static", False), ("movable", True)):
        obstacles = replace(spec.simulator.obstacles, movable=movable)
        config = replace(spec.simulator, obstacles=obstacles)
        with closing(Simulator(spec.world, config, spec.course.start, 0)) as simulator:
            processor_s = _time(
                lambda: [simulator.step(command) for command in commands]
            )
        factor = _SIMULATOR_CYCLES * config.control_period_s / processor_s
        yield Measurement(f"simulator alone, {name} obstacles", factor, _REAL_TIME)


def _measure_environments(dataset: str) -> Iterator[Measurement]:
    """Yield steps per second of the learning environment, single and as a batch."""
    # Gymnasium is optional.
    from barn_eval.learning.environment import (  # noqa: PLC0415
        JackalEnv,
        JackalVectorEnv,
    )

    generator = np.random.default_rng(0)
    actions = generator.uniform(-1.0, 1.0, (_ENVIRONMENT_STEPS, _BATCH, 2))
    for beams in (720, 90):
        config = EnvConfig(
            dataset=dataset,
            simulator={"lidar.beams": beams},
            observation=PolicyObservation(beams=beams),
        )
        with closing(JackalEnv(config)) as environment:
            processor_s = _time(lambda: _act(environment, actions[:, 0]))
        rate = _ENVIRONMENT_STEPS / processor_s
        yield Measurement(f"environment steps, {beams} beams", rate, "per second")

        with closing(JackalVectorEnv(_BATCH, config)) as environments:
            environments.reset(seed=0)
            # Warm up until most worlds are loaded and physics clients have started.
            for action in actions[:_BATCH_WARM_UP_STEPS]:
                environments.step(action)
            processor_s = _time(
                lambda: [environments.step(action) for action in actions[:_BATCH_STEPS]]
            )
        rate = _BATCH_STEPS * _BATCH / processor_s
        name = f"environment steps, batch of {_BATCH}, {beams} beams"
        yield Measurement(name, rate, "per second")


def _act(environment: JackalEnv, actions: Floats) -> None:
    """Step an environment through all actions, resetting it after each episode."""
    environment.reset(seed=0)
    for action in actions:
        _, _, terminated, truncated, _ = environment.step(action)
        if terminated or truncated:
            environment.reset()


def _measure_ros(run: RunConfig) -> Measurement:
    """Return a measurement: the better real-time factor of two lockstep ROS trials."""
    # Only here: it needs rclpy.
    from barn_eval.ros.supervision.supervisor import run_ros_trials  # noqa: PLC0415

    ros_run = replace(run, mode="ros", repetitions=2)
    with TemporaryDirectory() as folder:
        store = BagStore(Path(folder), bags="all")
        records = list(run_ros_trials(ros_run, ros_run.trials(), store))
    factor = max(record.result.wall_clock.real_time_factor or 0.0 for record in records)
    planner = run.planners[0].name
    return Measurement(f"trial over ROS in lockstep, {planner}", factor, _REAL_TIME)


def _time(work: Callable[[], object]) -> float:
    """Call `work` twice; return the processor time of the second call [s]."""
    work()
    return timeit.timeit(work, time.process_time, number=1)
