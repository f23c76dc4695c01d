"""A learned policy as a planner, with the observations and actions of the learning environment; see docs/learning.md.

A shield replaces a command that, driven until the robot could have stopped, brings an obstacle nearer to the outline
than a margin (and than it is) by the most similar safe one, or by a stop. It does not see behind the robot.
"""

import importlib.resources
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from numba import njit

from barn_planners.gap.planner import returns
from barn_planners.interface import Decision, Observation, PlannerStatus, Task
from barn_planners.navigation.guard import (
    GuardConfig,
    LidarPlace,
    ProgressCheck,
    ScanPlanner,
)
from barn_planners.policy.file import Policy, PolicyNetwork, read_policy
from barn_planners.policy.space import ObservationEncoder
from barn_planners.registry import ANY_PROTOCOL, PlannerEntry
from barn_planners.robots import fitted
from barn_worlds.base.compute import Compute
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.types import STOP, Pose2D, Scan, Velocity2D
from barn_worlds.robots.robot import Robot

_SPACING_M = (
    0.04  # between checked poses, along the path of the outline's fastest corner
)
# Factors of the speed and offsets of the yaw rate in rad/s, least change first; a full stop counts like 2 rad/s.
_CHANGES = sorted(
    (
        (share, turn)
        for share in (1.0, 0.75, 0.5, 0.25, 0.0)
        for turn in (0.0, 0.4, -0.4, 0.8, -0.8, 1.2, -1.2)
    ),
    key=lambda change: 2.0 * (1.0 - change[0]) + abs(change[1]),
)


@dataclass(frozen=True)
class SafetyConfig(LidarPlace):
    """A shield against collisions, for a Jackal."""

    enabled: bool = quantity(True, "avoid collisions; false: the policy alone drives")
    margin_m: float = quantity(0.03, "margin around the robot", "m", 0.0, 1.0)
    reaction_s: float = quantity(
        0.15, "time until a new command takes effect", "s", 0.0, 2.0
    )
    braking_mps2: float = quantity(4.0, "assumed deceleration", "m/s2", 0.1, 20.0)
    half_length_m: float = quantity(0.254, "half the robot's length", "m", 0.01, 5.0)
    half_width_m: float = quantity(0.215, "half the robot's width", "m", 0.01, 5.0)


@dataclass(frozen=True)
class PolicyConfig(Checked):
    """The policy file, goal tolerance and progress check."""

    policy_path: str = quantity(
        "", "policy file (.npz); empty: the one that comes with the package"
    )
    goal_tolerance_m: float = quantity(
        0.25, "the goal is reached within this", "m", 0.01, 10.0
    )
    progress_distance_m: float = quantity(
        0.3, "the robot is stuck if it does not move this far", "m", 0.01, 10.0
    )
    progress_limit_s: float = quantity(8.0, "within this time", "s", 0.1, 1000.0)
    safety: SafetyConfig = field(default_factory=SafetyConfig)
    guard: GuardConfig = field(default_factory=GuardConfig)


class PolicyPlanner(ScanPlanner):
    """Queries the policy in every cycle."""

    def __init__(self, config: PolicyConfig):
        """Read the policy; PolicyError if it cannot be."""
        super().__init__(config.guard, config.goal_tolerance_m)
        self.config = config
        self.policy: Policy = read_policy(
            Path(config.policy_path) if config.policy_path else shipped_policy()
        )
        self._network, self._encoder = (
            PolicyNetwork(self.policy),
            ObservationEncoder(self.policy.observation),
        )
        self._progress = ProgressCheck(
            config.progress_distance_m, config.progress_limit_s
        )

    def start(self, task: Task, seed: int) -> None:
        """Begin a new trial."""
        super().start(task, seed)
        self._progress.reset()

    def problem(self, scan: Scan) -> str:
        """Return in one line why the policy cannot use a scan, or an empty text."""
        return self._encoder.problem(scan)

    def drive(self, observation: Observation, goal: Pose2D) -> Decision:
        """Return the policy's command, made safe if configured."""
        action = self._network.act(self._encoder.encode(observation, goal))
        wanted = given = self.policy.action.command(action)
        if not wanted.is_finite():
            return Decision(
                STOP, PlannerStatus.BLOCKED, "the policy's answer is not a number"
            )
        if self.config.safety.enabled:
            given = safe_command(
                wanted,
                observation.odometry.velocity,
                observation.scan,
                self.config.safety,
            )
        figures = {"goal_distance_m": observation.pose.distance(goal)}
        figures |= {"wanted_mps": wanted.linear, "wanted_radps": wanted.angular}
        status, reason = PlannerStatus.RUNNING, ""
        if given.linear == 0.0 != wanted.linear:
            status, reason = (
                PlannerStatus.BLOCKED,
                "an obstacle is too near to drive on",
            )
        elif self._progress.stuck(observation.stamp_ns, observation.odometry.pose):
            limit_s = self.config.progress_limit_s
            status, reason = (
                PlannerStatus.BLOCKED,
                f"the policy has not got anywhere for {limit_s:g} s",
            )
        return Decision(given, status, reason, diagnostics=figures)


def shipped_policy() -> Path:
    """Return the policy that comes with the package."""
    return Path(str(importlib.resources.files("barn_planners"))) / "data" / "policy.npz"


def safe_command(
    wanted: Velocity2D, moving: Velocity2D, scan: Scan, config: SafetyConfig
) -> Velocity2D:
    """Return the wanted command if it is safe, else its safe replacement; moving: velocity of the robot now."""
    speed = max(abs(wanted.linear), abs(moving.linear))
    time_s = config.reaction_s + 0.5 * speed / config.braking_mps2
    reach_m = math.hypot(config.half_length_m, config.half_width_m)
    lidar = config.lidar
    points = returns(
        scan,
        lidar,
        speed * time_s + reach_m + config.margin_m + math.hypot(lidar.x, lidar.y),
    )
    if not len(points):
        return wanted
    half_sizes = (config.half_length_m, config.half_width_m)
    now_m = least_gap(points, 0.0, 0.0, 1, 0.0, *half_sizes)
    for share, turn in _CHANGES:
        linear, angular = share * wanted.linear, wanted.angular + turn
        steps = 1 + math.ceil(
            (abs(linear) + reach_m * abs(angular)) * time_s / _SPACING_M
        )
        gap_m = least_gap(points, linear, angular, steps, time_s / steps, *half_sizes)
        if gap_m >= config.margin_m or gap_m >= now_m:
            return Velocity2D(linear, angular)
    return STOP


@njit(cache=True)
def least_gap(points, linear, angular, steps, step_s, half_length, half_width):  # type: ignore[no-untyped-def]
    """Return the least distance of points (n, 2) from the outline at `steps` poses driven to; 0 for points inside."""
    least = math.inf
    for k in range(1, steps + 1):
        time_s = k * step_s
        yaw = angular * time_s
        if abs(yaw) < 1e-9:
            x, y = linear * time_s, 0.0
        else:
            x, y = (
                linear / angular * math.sin(yaw),
                linear / angular * (1.0 - math.cos(yaw)),
            )
        c, s = math.cos(yaw), math.sin(yaw)
        for i in range(len(points)):
            dx, dy = points[i, 0] - x, points[i, 1] - y
            ahead = max(abs(c * dx + s * dy) - half_length, 0.0)
            aside = max(abs(c * dy - s * dx) - half_width, 0.0)
            least = min(least, math.hypot(ahead, aside))
    return least


def _speed_cap_mps(config: PolicyConfig) -> float:
    return read_policy(
        Path(config.policy_path) if config.policy_path else shipped_policy()
    ).action.cap_mps


def _fitted(config: PolicyConfig, robot: Robot) -> dict[str, Any]:
    """Return the shield and the distances for a robot; what its policy sees and commands is in the policy's file."""
    if not config.policy_path:
        raise ConfigError(
            f"the shipped policy was trained for the Jackal alone; give one for {robot.name} (policy_path)"
        )
    return fitted(config, robot)


ENTRY = PlannerEntry(
    PolicyPlanner,
    {ANY_PROTOCOL: PolicyConfig()},
    "a learned policy from a file, with a stop before collisions",
    _fitted,
    _speed_cap_mps,
    compute=Compute(delay_s=0.0001),
)
