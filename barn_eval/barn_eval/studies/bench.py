"""Speed of the suite on this machine, mostly as ratios, so that it can be followed over time."""

from __future__ import annotations

import timeit
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from barn_eval.bags.recorder import Recorder
from barn_eval.experiments.direct import run_direct_trial
from barn_eval.experiments.experiment import Experiment, PlannerChoice
from barn_eval.experiments.store import Store
from barn_eval.trials.spec import TrialSpec
from barn_metrics.report import metrics_table
from barn_sim.bullet import BulletRays
from barn_sim.config import SimulatorConfig
from barn_sim.lidar import Lidar
from barn_sim.simulator import Simulator
from barn_worlds.arrays import Floats
from barn_worlds.dataset import Dataset, open_dataset
from barn_worlds.generate import DatasetParameters, generate_dataset
from barn_worlds.types import Pose2D, Velocity2D

if TYPE_CHECKING:
    from barn_eval.learning.environment import JackalEnv

AGREEMENT_M = 0.01
_CYCLES = 200  # of the simulator alone


@dataclass(frozen=True)
class Measurement:
    """One measured figure; `better` says which way is better, for those who compare machines or versions."""

    name: str
    value: float
    unit: str
    better: str = "higher"


def bench(source: str, world: int | None, planners: list[str], repeats: int, *, ros: bool) -> Iterator[Measurement]:
    """Yield measurements, each the best of some repetitions, since others use the machine as well.

    world: of the data set; None takes the one in the middle.
    """
    dataset = replace(open_dataset(source), name=source)
    chosen = dataset.indices[len(dataset.indices) // 2] if world is None else world
    dataset.load(chosen)
    experiments = [
        Experiment(dataset=source, worlds=str(chosen), planners=(PlannerChoice(planner),)) for planner in planners
    ]
    yield from (one for experiment in experiments for one in _direct(experiment.trials()[0], repeats))
    yield from _simulator(experiments[0].trials()[0], repeats)
    yield from _rays(dataset, repeats)
    yield from _worlds(repeats)
    if find_spec("gymnasium") is not None:
        yield _environment(source, repeats)
    if ros:
        yield _ros(experiments[0], repeats)


def _direct(spec: TrialSpec, repeats: int) -> Iterator[Measurement]:
    """Measure whole trials in one process: without and with a bag, and the planner's share."""
    plain = [run_direct_trial(spec).result.wall_clock for _ in range(repeats + 1)]
    factors = [one.real_time_factor or 0.0 for one in plain]
    yield Measurement(f"direct trial, {spec.planner}", max(factors), "x real time")
    recorded = [_with_bag(spec) for _ in range(repeats)]
    yield Measurement(f"direct trial with bag, {spec.planner}", max(recorded), "x real time")
    for name in ("p50", "p95"):
        value = min(getattr(one, f"compute_{name}_ms") for one in plain)
        yield Measurement(f"planner cycle {name}, {spec.planner}", value, "ms", "lower")


def _with_bag(spec: TrialSpec) -> float:
    with TemporaryDirectory() as folder, Recorder(Path(folder) / "bag") as recorder:
        return run_direct_trial(spec, recorder).result.wall_clock.real_time_factor or 0.0


def _simulator(spec: TrialSpec, repeats: int) -> Iterator[Measurement]:
    """Measure the simulator alone, static and movable obstacles, driving in a circle at the start."""
    for name, movable in (("static", False), ("movable", True)):
        config = replace(spec.simulator, obstacles=replace(spec.simulator.obstacles, movable=movable))
        with closing(Simulator(spec.world, config, spec.course.start, 0)) as simulator:
            wall_s = _best(partial(_drive, simulator), repeats)
        yield Measurement(
            f"simulator alone, {name} obstacles", _CYCLES * config.control_period_s / wall_s, "x real time"
        )


def _drive(simulator: Simulator) -> None:
    for _ in range(_CYCLES):
        simulator.step(Velocity2D(0.3, 1.0))


def _rays(dataset: Dataset, repeats: int) -> Iterator[Measurement]:
    """Measure our rays against PyBullet's in the densest world of the data set."""
    world = max((dataset.load(index) for index in dataset.indices), key=lambda one: len(one.cylinders_m))
    config = replace(SimulatorConfig().lidar, noise_m=0.0)
    lidar = Lidar(config, np.random.default_rng(0))
    mount = Pose2D(config.mount_x_m, 0.0, 0.0)
    poses = [Pose2D(x, y, 1.57) for x, y in world.path_m()[::3].tolist()]
    radius = world.cylinder_radius_m
    ours_s = _best(lambda: [lidar.scan(0, pose, world.cylinders_m, radius) for pose in poses], repeats) / len(poses)
    scans = [lidar.scan(0, pose, world.cylinders_m, radius) for pose in poses]
    with closing(BulletRays(world)) as bullet:
        beams = [bullet.rays(scan, pose @ mount) for scan, pose in zip(scans, poses, strict=True)]
        theirs_s = _best(lambda: [bullet.ranges(*one, config.range_max_m) for one in beams], repeats) / len(poses)
        theirs = [np.asarray(bullet.ranges(*one, config.range_max_m)) for one in beams]
    yield Measurement(f"scan of {config.beams} beams, densest world", 1e3 * ours_s, "ms", "lower")
    yield Measurement("the same by PyBullet's rays", 1e3 * theirs_s, "ms", "lower")
    yield Measurement("PyBullet's rays by ours", theirs_s / ours_s, "x faster")
    same = [np.isclose(scan.ranges, one, rtol=0.0, atol=AGREEMENT_M) for scan, one in zip(scans, theirs, strict=True)]
    yield Measurement("beams that agree within 1 cm", 100.0 * float(np.mean(same)), "%")


def _worlds(repeats: int) -> Iterator[Measurement]:
    """Measure the generation of worlds by Table I, and the five metrics of worlds."""
    parameters = DatasetParameters(name="bench", worlds_per_set=2)
    made = generate_dataset(parameters)
    generating_s = _best(lambda: generate_dataset(parameters), repeats)
    yield Measurement("worlds generated", len(made) / generating_s, "per second")
    yield Measurement("metrics of worlds", len(made) / _best(lambda: metrics_table(made), repeats), "per second")


def _environment(source: str, repeats: int) -> Measurement:
    """Measure the learning environment with all beams under random commands, new episodes included."""
    from barn_eval.learning.environment import JackalEnv  # noqa: PLC0415 (needs Gymnasium, which is optional)

    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (500, 2))
    with closing(JackalEnv(dataset=source)) as environment:
        wall_s = _best(partial(_act, environment, actions), repeats)
        beams = environment.config.observation.beams
    return Measurement(f"environment steps, {beams} beams", len(actions) / wall_s, "per second")


def _act(environment: JackalEnv, actions: Floats) -> None:
    """Give the actions, in as many episodes as it takes."""
    environment.reset(seed=0)
    for action in actions:
        _, _, terminated, truncated, _ = environment.step(action)
        if terminated or truncated:
            environment.reset()


def _ros(experiment: Experiment, repeats: int) -> Measurement:
    """Measure a trial over ROS in lockstep: three processes, bag included."""
    from barn_eval.ros.supervision import run_ros_trials  # noqa: PLC0415 (needs rclpy in its processes)

    with TemporaryDirectory() as folder:
        over_ros = replace(experiment, mode="ros", repetitions=max(2, repeats))
        records = list(run_ros_trials(over_ros, over_ros.trials(), Store(Path(folder), bags="all")))
    factors = [record.result.wall_clock.real_time_factor or 0.0 for record in records]
    return Measurement(f"trial over ROS in lockstep, {experiment.planners[0].name}", max(factors), "x real time")


def _best(work: Callable[[], object], repeats: int) -> float:
    """Return the shortest wall-clock time in seconds, after one run to warm up."""
    work()
    return min(timeit.repeat(work, number=1, repeat=repeats))
