"""Speed of the suite on this machine, mostly as ratios, so that it can be followed over time.

Everything is measured in rounds, one after the other, so that what else the machine does meanwhile is spread over all
figures. A figure is the best of its rounds; how much they differ tells how exact it is.
"""

from __future__ import annotations

import math
import timeit
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
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
from barn_eval.trials.run_config import PlannerChoice, RunConfig
from barn_eval.trials.spec import TrialSpec
from barn_planners.policy.space import PolicyObservation
from barn_planners.registry import planner_config
from barn_sim.simulator import Simulator
from barn_worlds.base.arrays import Floats
from barn_worlds.base.config import Checked, quantity, replace_dotted
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.text_files import read_json
from barn_worlds.base.types import Velocity2D
from barn_worlds.datasets.dataset import open_dataset

if TYPE_CHECKING:
    from barn_eval.learning.environment import JackalEnv
_CYCLES = 200  # of the simulator alone
_STEPS, _BATCH, _WARM_UP = 500, 64, 300  # of environments


@dataclass(frozen=True)
class Measurement:
    """One measured figure; `better` says which way is better, for those who compare machines or versions.

    samples: the values of all rounds, of which `value` is the best.
    """

    name: str
    value: float
    unit: str
    better: str = "higher"
    samples: tuple[float, ...] = ()

    @property
    def noise(self) -> float:
        """Range of the samples as a share of the value, 0 for one sample."""
        return (
            (max(self.samples) - min(self.samples)) / abs(self.value)
            if self.samples and self.value
            else 0.0
        )


def best_of(rounds: Sequence[Measurement]) -> Measurement:
    """Return the best of measurements of the same figure."""
    values = tuple(one.value for one in rounds)
    return replace(
        rounds[0],
        value=(max if rounds[0].better == "higher" else min)(values),
        samples=values,
    )


@dataclass(frozen=True)
class Change:
    """How many times as good a figure has become, and how much of that may be noise (both as shares of 1)."""

    name: str
    ratio: float
    noise: float

    @property
    def slower(self) -> bool:
        """Whether it has become worse by more than the noise."""
        return self.ratio < 1.0 - self.noise


def changes(now: Sequence[Measurement], before: Sequence[Measurement]) -> list[Change]:
    """Return the change of every figure that both have."""
    earlier = {one.name: one for one in before if one.value > 0.0}
    found = []
    for one in now:
        other = earlier.get(one.name)
        if other is not None and one.value > 0.0:
            ratio = (
                other.value / one.value
                if one.better == "lower"
                else one.value / other.value
            )
            found.append(Change(one.name, ratio, math.hypot(one.noise, other.noise)))
    return found


def read_figures(path: Path) -> list[Measurement]:
    """Return the figures of a file that `barn bench --json` has printed; ConfigError if it is none."""
    try:
        figures = read_json(path)["figures"]
        return [
            Measurement(**{**one, "samples": tuple(one.get("samples", ()))})
            for one in figures
        ]
    except (ConfigError, KeyError, TypeError) as error:
        raise ConfigError(
            f"--against {path}: not a result of barn bench --json ({error})"
        ) from None


@dataclass(frozen=True)
class BenchSetup(Checked):
    """What `bench` measures."""

    dataset: str = quantity("barn300", "data set that the world is from")
    world: int = quantity(
        -1, "world of the trials, -1 for the one in the middle", "", -1, 1_000_000_000
    )
    repeats: int = quantity(3, "the best of so many counts", "", 1, 100)
    ros: bool = quantity(True, "a trial over ROS is measured, if rclpy is installed")


def bench(
    planners: Sequence[str] = ("dwa", "eband"),
    settings: Mapping[str, object] | None = None,
    *,
    note: Callable[[str], None] = lambda _: None,
) -> Iterator[Measurement]:
    """Yield figures of the suite's speed on this machine, each the best of some rounds.

    Args:
        planners: Planners to measure.
        settings: Fields of `BenchSetup`.
        note: Gets a line about each measurement of each round.

    Raises:
        BarnError: A planner or a setting is not known.
    """
    for name in planners:
        planner_config(name)
    setup = replace_dotted(BenchSetup(), settings or {}, "settings")
    rounds: list[list[Measurement]] = [[] for _ in range(setup.repeats)]
    for number, figures in enumerate(rounds, start=1):
        for one in _round(setup, planners):
            note(
                f"round {number} of {setup.repeats}: {one.name}, {one.value:.3g} {one.unit}"
            )
            figures.append(one)
    yield from (best_of(figures) for figures in zip(*rounds, strict=True))


def _round(setup: BenchSetup, planners: Sequence[str]) -> Iterator[Measurement]:
    """Yield every measurement once."""
    source, indices = setup.dataset, open_dataset(setup.dataset).world_numbers
    worlds = str(indices[len(indices) // 2] if setup.world < 0 else setup.world)
    experiments = [
        RunConfig(dataset=source, worlds=worlds, planners=(PlannerChoice(name),))
        for name in planners
    ]
    yield from (
        one for experiment in experiments for one in _direct(experiment.trials()[0])
    )
    yield from _simulator(experiments[0].trials()[0])
    if find_spec("gymnasium") is not None:
        yield from _environments(source)
    if setup.ros and not ros_problem():
        yield _ros(experiments[0])


def _direct(spec: TrialSpec) -> Iterator[Measurement]:
    """Measure whole trials in one process: without and with a bag, and the planner's cycles."""
    plain = [run_direct_trial(spec).result.wall_clock for _ in range(2)]
    yield Measurement(
        f"direct trial, {spec.planner}",
        max(one.real_time_factor or 0.0 for one in plain),
        "x real time",
    )
    with TemporaryDirectory() as folder, Recorder(Path(folder) / "bag") as recorder:
        factor = run_direct_trial(spec, recorder).result.wall_clock.real_time_factor
    yield Measurement(
        f"direct trial with bag, {spec.planner}", factor or 0.0, "x real time"
    )
    for name in ("p50", "p95"):
        value = min(getattr(one, f"compute_{name}_ms") for one in plain)
        yield Measurement(f"planner cycle {name}, {spec.planner}", value, "ms", "lower")


def _simulator(spec: TrialSpec) -> Iterator[Measurement]:
    """Measure the simulator alone, static and movable obstacles, driving in a circle at the start."""
    for name, movable in (("static", False), ("movable", True)):
        config = replace(
            spec.simulator, obstacles=replace(spec.simulator.obstacles, movable=movable)
        )
        with closing(Simulator(spec.world, config, spec.course.start, 0)) as simulator:
            wall_s = _time(
                lambda: [simulator.step(Velocity2D(0.3, 1.0)) for _ in range(_CYCLES)]
            )
        factor = _CYCLES * config.control_period_s / wall_s
        yield Measurement(f"simulator alone, {name} obstacles", factor, "x real time")


def _environments(source: str) -> Iterator[Measurement]:
    """Measure the learning environment, one and a batch, under random commands, new episodes included."""
    from barn_eval.learning.environment import JackalEnv  # noqa: PLC0415 (needs Gymnasium, which is optional)
    from barn_eval.learning.vector import JackalVectorEnv  # noqa: PLC0415

    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (_STEPS, _BATCH, 2))
    for beams in (720, 90):
        config = EnvConfig(
            dataset=source,
            simulator={"lidar.beams": beams},
            observation=PolicyObservation(beams=beams),
        )
        with closing(JackalEnv(config)) as environment:
            wall_s = _time(partial(_act, environment, actions[:, 0]))
        yield Measurement(
            f"environment steps, {beams} beams", _STEPS / wall_s, "per second"
        )
        with closing(JackalVectorEnv(_BATCH, config)) as environments:
            environments.reset(seed=0)
            for action in actions[
                :_WARM_UP
            ]:  # until most worlds have been read, and enough engines begun
                environments.step(action)
            wall_s = _time(
                lambda: [environments.step(action) for action in actions[: _STEPS // 5]]
            )
        rate = _STEPS // 5 * _BATCH / wall_s
        yield Measurement(
            f"environment steps, batch of {_BATCH}, {beams} beams", rate, "per second"
        )


def _act(environment: JackalEnv, actions: Floats) -> None:
    """Give the actions, in as many episodes as it takes."""
    environment.reset(seed=0)
    for action in actions:
        _, _, terminated, truncated, _ = environment.step(action)
        if terminated or truncated:
            environment.reset()


def _ros(experiment: RunConfig) -> Measurement:
    """Measure a trial over ROS in lockstep: three processes, bag included."""
    from barn_eval.ros.supervision.supervisor import run_ros_trials  # noqa: PLC0415 (needs rclpy in its processes)

    with TemporaryDirectory() as folder:
        over_ros = replace(experiment, mode="ros", repetitions=2)
        records = list(
            run_ros_trials(
                over_ros, over_ros.trials(), BagStore(Path(folder), bags="all")
            )
        )
    factors = [record.result.wall_clock.real_time_factor or 0.0 for record in records]
    return Measurement(
        f"trial over ROS in lockstep, {experiment.planners[0].name}",
        max(factors),
        "x real time",
    )


def _time(work: Callable[[], object]) -> float:
    """Return the wall-clock time of work in seconds, after one run to warm up."""
    work()
    return timeit.timeit(work, number=1)
