"""A small flat world to drive planners in: cylinders, a ray-cast lidar and a robot that does nearly what it is told."""

import math
from dataclasses import dataclass, field

import numpy as np
import pytest
from shared_fixtures import private_domain

from barn_planners.interface import Decision, Observation, Planner, PlannerStatus, Task
from barn_worlds.base.types import STOP, Odometry, Pose2D, Scan, Velocity2D, nanoseconds

__all__ = ["private_domain"]
ANGLES = np.linspace(-2.35619, 2.35619, 360)
LIDAR_X_M = 0.055


@dataclass
class FlatWorld:
    """cylinders: (n, 3) x, y, radius. The odometry frame is the world's; time starts at `stamp_ns`."""

    cylinders: np.ndarray
    pose: Pose2D = field(default_factory=lambda: Pose2D(0.0, 0.0, 0.0))
    velocity: Velocity2D = STOP
    stamp_ns: int = 7_000_000_000
    period_s: float = 0.05
    track: list[tuple[float, float, float]] = field(default_factory=list)
    decisions: list[Decision] = field(default_factory=list)
    clearance: float = math.inf
    angles: np.ndarray = field(default_factory=lambda: ANGLES)

    def scan(self) -> Scan:
        sensor = self.pose @ Pose2D(LIDAR_X_M, 0.0, 0.0)
        angles = self.angles + sensor.yaw
        ranges = np.full(len(angles), np.inf)
        for x, y, radius in self.cylinders:
            along = (x - sensor.x) * np.cos(angles) + (y - sensor.y) * np.sin(angles)
            across2 = (x - sensor.x) ** 2 + (y - sensor.y) ** 2 - along**2
            hit = (along > 0.0) & (across2 < radius**2)
            ranges[hit] = np.minimum(
                ranges[hit], along[hit] - np.sqrt(radius**2 - across2[hit])
            )
        first, second = self.angles[:2]
        return Scan(
            self.stamp_ns, ranges.astype(np.float32), first, second - first, 0.1, 30.0
        )

    def observe(self) -> Observation:
        odometry = Odometry(self.stamp_ns, self.pose, self.velocity)
        return Observation(self.stamp_ns, odometry, self.scan(), self.pose)

    def advance(self, command: Velocity2D | None) -> None:
        target = self.velocity if command is None else command
        limit = 5.0 * self.period_s
        speed = self.velocity.linear + float(
            np.clip(target.linear - self.velocity.linear, -limit, limit)
        )
        self.velocity = Velocity2D(speed, target.angular)
        half = self.pose.yaw + 0.5 * target.angular * self.period_s
        moved = speed * self.period_s
        self.pose = Pose2D(
            self.pose.x + moved * math.cos(half),
            self.pose.y + moved * math.sin(half),
            self.pose.yaw + target.angular * self.period_s,
        )
        self.stamp_ns += nanoseconds(self.period_s)
        self.track.append((self.pose.x, self.pose.y, self.pose.yaw))
        if len(self.cylinders):
            gaps = np.hypot(
                self.cylinders[:, 0] - self.pose.x, self.cylinders[:, 1] - self.pose.y
            )
            self.clearance = min(
                self.clearance, float((gaps - self.cylinders[:, 2]).min())
            )

    def drive(self, planner: Planner, goal: Pose2D, limit_s: float) -> PlannerStatus:
        """Drive until the planner is done or the time is over; returns its last status."""
        planner.start(Task(goal), seed=0)
        decision = Decision(STOP)
        for _ in range(round(limit_s / self.period_s)):
            decision = planner.step(self.observe())
            self.decisions.append(decision)
            assert decision.command is None or decision.command.is_finite()
            if decision.status in (PlannerStatus.GOAL_REACHED, PlannerStatus.FAILED):
                break
            self.advance(decision.command)
        return decision.status


def wall(
    start: tuple[float, float], end: tuple[float, float]
) -> list[tuple[float, float, float]]:
    """Return a row of cylinders of 0.075 m radius, 0.15 m apart."""
    count = max(2, round(math.dist(start, end) / 0.15) + 1)
    return [(x, y, 0.075) for x, y in np.linspace(start, end, count)]


@pytest.fixture
def flat_world():
    """Return the function that makes a FlatWorld of walls, each a pair of end points, and single cylinders."""

    def make(walls=(), cylinders=(), **kwargs) -> FlatWorld:
        shapes = [cylinder for ends in walls for cylinder in wall(*ends)] + list(
            cylinders
        )
        return FlatWorld(np.array(shapes, dtype=np.float64).reshape(-1, 3), **kwargs)

    return make
