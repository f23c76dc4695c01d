"""Planners for tests: one that drives, and some that do what a planner must not."""

import math
import time
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from barn_planners.interface import Decision, Observation, Planner, PlannerStatus, PlannerView, Task
from barn_worlds.base.types import Velocity2D, wrap_angle


class Straight(Planner):
    """Drives straight at the goal; its noise shows that the seed arrives."""

    def start(self, task: Task, seed: int) -> None:
        self.goal = task.goal
        self.rng = np.random.default_rng(seed)
        self.plan = None

    def step(self, observation: Observation) -> Decision:
        pose = observation.pose
        bearing = math.atan2(self.goal.y - pose.y, self.goal.x - pose.x)
        turn = max(-1.0, min(1.0, 2.0 * wrap_angle(bearing - pose.yaw))) + 0.01 * self.rng.standard_normal()
        self.plan = np.array([[pose.x, pose.y], [self.goal.x, self.goal.y]])
        return Decision(Velocity2D(0.5, turn), plan=self.plan, diagnostics={"turn_rad_s": turn})

    def view(self) -> PlannerView:
        return PlannerView(band=np.array([[0.0, 0.0, 0.3], [1.0, 0.0, 0.2]]), local_plan=np.zeros((3, 3)))


@dataclass
class Faulty(Straight):
    """Drives, and does `fault` after some cycles."""

    fault: str
    after: int = 20
    cycle: int = 0

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
        answers = {
            "nan": Decision(Velocity2D(math.nan, 0.0)),
            "infinity": Decision(Velocity2D(0.1, math.inf)),
            "nothing": Decision(None, PlannerStatus.BLOCKED),
            "no decision": "forward",
            "no velocity": Decision((0.5, 0.0)),
            "stops": Decision(
                Velocity2D(0.0, 0.0), PlannerStatus.RECOVERING if self.cycle % 2 else PlannerStatus.BLOCKED
            ),
        }
        return answers[self.fault]
