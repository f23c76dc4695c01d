"""A small flat world to drive planners in: cylinders, a ray-cast lidar and a robot that does nearly what it is told."""

import math
from dataclasses import dataclass, field

import numpy as np
import pytest
from shared_fixtures import private_domain

from barn_planners.interface import Decision, Observation, PlannerStatus, Task
from barn_worlds.base.types import (
    ORIGIN,
    STOP,
    Odometry,
    Pose2D,
    Scan,
    Velocity2D,
    nanoseconds,
)

__all__ = ["private_domain"]
ANGLES = np.linspace(-2.35619, 2.35619, 360)
LIDAR_X_M = 0.055


@dataclass
class FlatWorld:
    """cylinders: (n, 3) x, y, radius. The odometry frame is the world's; time starts at `stamp_ns`."""

    cylinders: np.ndarray
    pose: Pose2D = ORIGIN
    velocity: Velocity2D = STOP
    stamp_ns: int = 7_000_000_000
    period_s: float = 0.05
    track: list[tuple[float, float, float]] = field(default_factory=list)
    decisions: list[Decision] = field(default_factory=list)
    clearance: float = math.inf
    angles: np.ndarray = field(default_factory=lambda: ANGLES)

    def scan(self):
        sensor = self.pose @ Pose2D(LIDAR_X_M, 0.0, 0.0)
        angles = self.angles + sensor.yaw
        ranges = np.full(len(angles), np.inf)
        for x, y, radius in self.cylinders:
            dx = x - sensor.x
            dy = y - sensor.y
            along = dx * np.cos(angles) + dy * np.sin(angles)
            across2 = dx**2 + dy**2 - along**2
            hit = (along > 0.0) & (across2 < radius**2)
            edge = along[hit] - np.sqrt(radius**2 - across2[hit])
            ranges[hit] = np.minimum(ranges[hit], edge)
        first, second = self.angles[:2]
        ranges = ranges.astype(np.float32)
        return Scan(self.stamp_ns, ranges, first, second - first, 0.1, 30.0)

    def observe(self):
        odometry = Odometry(self.stamp_ns, self.pose, self.velocity)
        return Observation(self.stamp_ns, odometry, self.scan(), self.pose)

    def advance(self, command):
        target = self.velocity if command is None else command
        limit = 5.0 * self.period_s
        speed = self.velocity.linear
        speed += float(np.clip(target.linear - speed, -limit, limit))
        self.velocity = Velocity2D(speed, target.angular)
        half = self.pose.yaw + 0.5 * target.angular * self.period_s
        moved = speed * self.period_s
        self.pose = Pose2D(
            self.pose.x + moved * math.cos(half),
            self.pose.y + moved * math.sin(half),
            self.pose.yaw + target.angular * self.period_s,
        )
        self.stamp_ns += nanoseconds(self.period_s)
        self.track.append(self.pose.numbers)
        for x, y, radius in self.cylinders:
            gap = math.hypot(x - self.pose.x, y - self.pose.y) - radius
            self.clearance = min(self.clearance, gap)

    def drive(self, planner, goal, limit_s):
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


def wall(start, end):
    """Return a row of cylinders of 0.075 m radius, 0.15 m apart."""
    count = max(2, round(math.dist(start, end) / 0.15) + 1)
    return [(x, y, 0.075) for x, y in np.linspace(start, end, count)]


@pytest.fixture
def ring():
    """Return the function that makes cylinders all around the origin."""

    def make(radius_m, post_radius_m=0.075, count=40):
        angles = np.linspace(0.0, 2.0 * math.pi, count)
        along = radius_m * np.cos(angles)
        across = radius_m * np.sin(angles)
        return np.column_stack([along, across, np.full(count, post_radius_m)])

    return make


@pytest.fixture
def flat_world():
    """Return the function that makes a FlatWorld of walls, each a pair of end points, and single cylinders."""

    def make(walls=(), cylinders=(), **kwargs):
        shapes = [cylinder for ends in walls for cylinder in wall(*ends)]
        shapes.extend(cylinders)
        return FlatWorld(np.array(shapes, dtype=np.float64).reshape(-1, 3), **kwargs)

    return make
