"""Speed figures of the suite on this machine, mostly as ratios, so that they can be followed over time."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from barn_eval.bags.recorder import Recorder
from barn_eval.experiments.direct import run_direct_trial
from barn_eval.experiments.runs import RunFolder, RunPlan
from barn_eval.trials.protocol import PAPER
from barn_eval.trials.spec import TrialSpec, simulator_config
from barn_metrics.report import metrics_table
from barn_sim.bullet_rays import BulletRays
from barn_sim.config import SimulatorConfig
from barn_sim.lidar import Lidar
from barn_sim.simulator import Simulator
from barn_worlds.dataset import Dataset, open_dataset
from barn_worlds.generate import DatasetParameters, generate_dataset
from barn_worlds.types import Pose2D, Scan, Velocity2D
from barn_worlds.world import World

if TYPE_CHECKING:
    from barn_eval.learning.environment import JackalEnv

AGREEMENT_M = 0.01


@dataclass(frozen=True)
class Figure:
    """One measured figure; `better` says which way is better, for those who compare machines or versions."""

    name: str
    value: float
    unit: str
    better: str = "higher"


class Bench:
    """Measures; each figure is the best of some repetitions, since others use the machine as well."""

    def __init__(self, dataset: Dataset, world: int, planners: list[str], repeats: int) -> None:
        self._dataset = dataset
        self._world = world
        self._planners = planners
        self._repeats = repeats

    def figures(self, *, ros: bool) -> Iterator[Figure]:
        """Yield figure after figure."""
        for planner in self._planners:
            yield from self._direct(planner)
        yield from self._simulator()
        yield from self._rays()
        yield from self._worlds()
        if find_spec("gymnasium") is not None:
            yield from self._environment()
        if ros:
            yield from self._ros()

    def _direct(self, planner: str) -> Iterator[Figure]:
        """Measure whole trials in one process: without and with a bag, and the planner's share."""
        spec = self._spec(planner)
        plain = [run_direct_trial(spec).result.wall_clock for _ in range(self._repeats + 1)]
        yield Figure(f"direct trial, {planner}", max(one.real_time_factor or 0.0 for one in plain), "x real time")
        with TemporaryDirectory() as folder:
            recorded = [self._recorded(spec, Path(folder)) for _ in range(self._repeats)]
        yield Figure(f"direct trial with bag, {planner}", max(recorded), "x real time")
        for name in ("p50", "p95"):
            value = min(getattr(one, f"compute_{name}_ms") for one in plain)
            yield Figure(f"planner cycle {name}, {planner}", value, "ms", "lower")

    def _recorded(self, spec: TrialSpec, folder: Path) -> float:
        with Recorder(folder / "bag") as recorder:
            factor = run_direct_trial(spec, recorder).result.wall_clock.real_time_factor
        shutil.rmtree(folder / "bag")
        return factor or 0.0

    def _simulator(self) -> Iterator[Figure]:
        """Measure the simulator alone, static and movable obstacles, driving in a circle at the start."""
        spec = self._spec(self._planners[0])
        for name, movable in (("static", False), ("movable", True)):
            config = replace(spec.simulator, obstacles=replace(spec.simulator.obstacles, movable=movable))
            with closing(Simulator(spec.world, config, spec.course.start, 0)) as simulator:
                wall_s = self._best(lambda one=simulator: _drive(one, 200))  # type: ignore[misc]
            yield Figure(f"simulator alone, {name} obstacles", 200 * config.control_period_s / wall_s, "x real time")

    def _rays(self) -> Iterator[Figure]:
        """Measure our rays against PyBullet's in the densest world of the data set."""
        world = max(
            (self._dataset.load(index) for index in self._dataset.indices), key=lambda one: len(one.cylinders_m)
        )
        config = replace(SimulatorConfig().lidar, noise_m=0.0)
        lidar = Lidar(config, np.random.default_rng(0))
        mount = Pose2D(config.mount_x_m, 0.0, 0.0)
        poses = [Pose2D(x, y, 1.57) for x, y in world.path_m()[::3].tolist()]
        radius = world.cylinder_radius_m
        ours_s = self._best(lambda: [lidar.scan(0, pose, world.cylinders_m, radius) for pose in poses]) / len(poses)
        scans = [lidar.scan(0, pose, world.cylinders_m, radius) for pose in poses]
        with closing(BulletRays(world)) as bullet:
            beams = [bullet.rays(scan, pose @ mount) for scan, pose in zip(scans, poses, strict=True)]
            theirs_s = self._best(lambda: [bullet.ranges(*one, config.range_max_m) for one in beams]) / len(poses)
            theirs = [bullet.ranges(*one, config.range_max_m) for one in beams]
        yield Figure(f"scan of {config.beams} beams, densest world", 1e3 * ours_s, "ms", "lower")
        yield Figure("the same by PyBullet's rays", 1e3 * theirs_s, "ms", "lower")
        yield Figure("PyBullet's rays by ours", theirs_s / ours_s, "x faster")
        same = np.mean([_agreement(scan, ranges) for scan, ranges in zip(scans, theirs, strict=True)])
        yield Figure("beams that agree within 1 cm", 100.0 * float(same), "%")

    def _worlds(self) -> Iterator[Figure]:
        """Measure the generation of worlds by Table I, and the five metrics of worlds."""
        parameters = DatasetParameters(name="bench", worlds_per_set=2)
        made: list[World] = generate_dataset(parameters)
        yield Figure("worlds generated", len(made) / self._best(lambda: generate_dataset(parameters)), "per second")
        metrics_table(made)
        yield Figure("metrics of worlds", len(made) / self._best(lambda: metrics_table(made)), "per second")

    def _environment(self) -> Iterator[Figure]:
        """Measure the learning environment with all beams under random commands, new episodes included."""
        from barn_eval.learning.environment import JackalEnv  # noqa: PLC0415 (needs Gymnasium, which is optional)

        actions = np.random.default_rng(0).uniform(-1.0, 1.0, (500, 2))
        with closing(JackalEnv(dataset=self._dataset.name)) as environment:
            wall_s = self._best(lambda: _learn(environment, actions))
        beams = environment.config.observation.beams
        yield Figure(f"environment steps, {beams} beams", len(actions) / wall_s, "per second")

    def _ros(self) -> Iterator[Figure]:
        """Measure a trial over ROS in lockstep: three processes, bag included."""
        from barn_eval.ros.supervision import run_ros_trials  # noqa: PLC0415 (needs rclpy in its processes)

        planner = self._planners[0]
        with TemporaryDirectory() as folder:
            plan = replace(self._plan(planner), mode="ros", repetitions=max(2, self._repeats))
            results = list(run_ros_trials(RunFolder.create(Path(folder) / "run", plan)))
        factors = [result.wall_clock.real_time_factor or 0.0 for result in results]
        yield Figure(f"trial over ROS in lockstep, {planner}", max(factors), "x real time")

    def _best(self, work: Callable[[], object]) -> float:
        """Return the shortest wall-clock time in seconds, after one run to warm up."""
        work()
        return min(_timed(work) for _ in range(self._repeats))

    def _spec(self, planner: str) -> TrialSpec:
        plan = self._plan(planner)
        return next(plan.trials())

    def _plan(self, planner: str) -> RunPlan:
        return RunPlan(
            dataset=self._dataset.name, worlds=str(self._world), planner=planner, simulator=simulator_config(PAPER)
        )


def bench(source: str, world: int | None, planners: list[str], repeats: int, *, ros: bool) -> Iterator[Figure]:
    """Yield the figures; `world` None takes the one in the middle of the data set."""
    dataset = replace(open_dataset(source), name=source)
    chosen = dataset.indices[len(dataset.indices) // 2] if world is None else world
    dataset.load(chosen)
    return Bench(dataset, chosen, planners, repeats).figures(ros=ros)


def _drive(simulator: Simulator, cycles: int) -> None:
    for _ in range(cycles):
        simulator.step(Velocity2D(0.3, 1.0))


def _learn(environment: JackalEnv, actions: npt.NDArray[np.float64]) -> None:
    """Give the actions, in as many episodes as it takes."""
    environment.reset(seed=0)
    for action in actions:
        _, _, terminated, truncated, _ = environment.step(action)
        if terminated or truncated:
            environment.reset()


def _timed(work: Callable[[], object]) -> float:
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def _agreement(scan: Scan, bullet: object) -> float:
    theirs = np.asarray(bullet)
    with np.errstate(invalid="ignore"):
        return float(np.mean((np.abs(scan.ranges - theirs) <= AGREEMENT_M) | (scan.ranges == theirs)))
