"""Planners for tests: one that drives, and some that do what a planner must not.

And trials of them in one process.
"""

import math
import time
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

import barn_eval as barn
from barn_eval.results.bags.recorder import Recorder
from barn_eval.running.direct import run_direct_trial
from barn_eval.trials.protocol import CHALLENGE
from barn_eval.trials.spec import TrialSpec, simulator_config
from barn_planners.interface import (
    Decision,
    Observation,
    Planner,
    PlannerStatus,
    PlannerView,
    Task,
)
from barn_worlds.base.types import STOP, Velocity2D, wrap_angle
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.worlds.world import World

SHORT = replace(
    CHALLENGE, name="short", limit_s=3.0, timeout_time_s=3.0, first_motion_limit_s=3.0
)


def dataset_of(protocol):
    """The name of the data set whose worlds a protocol is made for."""
    return "dynabarn60" if protocol.arena else "barn300"


def spec_of(
    world=0, protocol=CHALLENGE, planner="gap", *, robot=None, repetition=0, **changes
):
    """A trial in a world, or in one of the protocol's data set by its number."""
    name = dataset_of(protocol)
    simulator = simulator_config(protocol, robot=robot)
    index, loaded_world = (
        (world, open_dataset(name).load(world))
        if isinstance(world, int)
        else (0, world)
    )
    preset = protocol.planner_preset
    return TrialSpec(
        name,
        index,
        loaded_world,
        planner,
        preset,
        {},
        protocol,
        simulator,
        5,
        repetition,
        **changes,
    )


def open_field():
    """A world with nothing but its side walls, and a straight path."""
    grid = np.zeros((30, 30), np.bool_)
    grid[[0, 29]] = True
    return World("open", grid, np.stack([np.full(30, 15), np.arange(30)], axis=1))


def run_inline(worlds, planners="gap", protocol=SHORT, **options):
    """Drive trials in this process, without a word, and return their results."""
    options = {"engine": "inline", "progress": False} | options
    return barn.run(worlds, planners, protocol, **options)


def recorded(spec, path, planner=None):
    """Drive a trial with a bag and return how it went."""
    with Recorder(path) as recorder:
        return run_direct_trial(spec, recorder, planner)


class Straight(Planner):
    """Drives straight at the goal; its noise shows that the seed arrives."""

    def start(self, task: Task, seed: int) -> None:
        self.goal = task.goal
        self.rng = np.random.default_rng(seed)
        self.plan = None

    def step(self, observation: Observation) -> Decision:
        pose = observation.pose
        bearing = math.atan2(self.goal.y - pose.y, self.goal.x - pose.x)
        turn = (
            max(-1.0, min(1.0, 2.0 * wrap_angle(bearing - pose.yaw)))
            + 0.01 * self.rng.standard_normal()
        )
        self.plan = np.array([pose.position, self.goal.position])
        return Decision(
            Velocity2D(0.5, turn), plan=self.plan, diagnostics={"turn_rad_s": turn}
        )

    def view(self) -> PlannerView:
        return PlannerView(
            band=np.array([[0.0, 0.0, 0.3], [1.0, 0.0, 0.2]]),
            local_plan=np.zeros((3, 3)),
        )


@dataclass
class Faulty(Straight):
    """Drives, and does `fault` after some cycles."""

    fault: str
    after: int = 20

    def start(self, task: Task, seed: int) -> None:
        super().start(task, seed)
        self.cycle = 0
        if self.fault == "raises at start":
            raise OSError("no such\nmodel")

    def step(self, observation: Observation) -> Decision:
        self.cycle += 1
        if self.cycle <= self.after:
            return super().step(observation)
        if self.fault == "raises":
            raise RuntimeError("out of ideas\nsecond line")
        if self.fault == "hangs":
            time.sleep(60.0)
        if self.fault == "hangs and catches":
            with suppress(Exception):
                time.sleep(60.0)
        waiting = PlannerStatus.RECOVERING if self.cycle % 2 else PlannerStatus.BLOCKED
        answers = {
            "nan": Decision(Velocity2D(math.nan, 0.0)),
            "nothing": Decision(None, PlannerStatus.BLOCKED),
            "no decision": "forward",
            "no velocity": Decision((0.5, 0.0)),
            "no number": Decision(Velocity2D("fast", 0.0)),
            "no status": Decision(STOP, "fast"),
            "no plan": Decision(STOP, plan="fast"),
            "stops": Decision(Velocity2D(0.0, 0.0), waiting),
        }
        return answers[self.fault]


def ahead(observation):
    return 0.4, 0.0


def at_the_goal(observation, task):
    return Velocity2D(0.4, 0.0 if task.goal.x > 0.0 else 0.1)


class Steady(Planner):
    """Drives straight on at a speed that it is made with."""

    def __init__(self, speed_mps=0.3):
        self.speed_mps = speed_mps

    def start(self, task, seed):
        self.task = task

    def step(self, observation):
        return Decision(Velocity2D(self.speed_mps, 0.0))
