"""A learned policy as a planner, with the observations and actions of the learning environment.

No map, no plan, no memory. The default is the policy that comes with the package (see docs/learning.md).
"""

import importlib.resources
import math
from dataclasses import dataclass, field
from pathlib import Path

from barn_planners.guard import GuardConfig, ObservationGuard
from barn_planners.interface import Decision, Observation, Planner, PlannerStatus, Task
from barn_planners.policy_file import Policy, PolicyNetwork, read_policy
from barn_planners.policy_safety import SafetyConfig, safe_command
from barn_planners.policy_space import ObservationEncoder
from barn_planners.progress import ProgressCheck
from barn_planners.registry import ANY_PROTOCOL, PlannerEntry
from barn_worlds.config import Checked, quantity
from barn_worlds.types import STOP


@dataclass(frozen=True)
class PolicyConfig(Checked):
    """The policy file, goal tolerance and progress check."""

    policy_path: str = quantity("", "policy file (.npz); empty: the one that comes with the package")
    goal_tolerance_m: float = quantity(0.25, "the goal is reached within this", "m", minimum=0.01, maximum=10.0)
    progress_distance_m: float = quantity(
        0.3, "the robot is stuck if it does not move this far", "m", minimum=0.01, maximum=10.0
    )
    progress_limit_s: float = quantity(8.0, "within this time", "s", minimum=0.1, maximum=1000.0)
    safety: SafetyConfig = field(default_factory=SafetyConfig)
    guard: GuardConfig = field(default_factory=GuardConfig)


class PolicyPlanner(Planner):
    """Queries the policy in every cycle."""

    def __init__(self, config: PolicyConfig):
        """Read the policy; PolicyError if it cannot be."""
        self.config = config
        self.policy: Policy = read_policy(Path(config.policy_path) if config.policy_path else shipped_policy())
        self._network = PolicyNetwork(self.policy)
        self._encoder = ObservationEncoder(self.policy.observation)
        self._guard = ObservationGuard(config.guard)
        self._progress = ProgressCheck(config.progress_distance_m, config.progress_limit_s)
        self._task: Task | None = None

    def start(self, task: Task, seed: int) -> None:  # noqa: ARG002  nothing is random here
        """Begin a new trial; a map is ignored."""
        self._task = task
        self._guard.reset()
        self._progress.reset()

    def step(self, observation: Observation) -> Decision:
        """Return the policy's command, made safe if configured."""
        if self._task is None:
            return Decision(STOP, PlannerStatus.BLOCKED, "no task yet")
        goal = self._task.goal
        problem = self._guard.problem(observation) or self._encoder.problem(observation.scan)
        if problem:
            return Decision(STOP, PlannerStatus.BLOCKED, problem)
        distance_m = math.hypot(goal.x - observation.pose.x, goal.y - observation.pose.y)
        if not math.isfinite(distance_m):
            return Decision(STOP, PlannerStatus.BLOCKED, "the goal is not at a usable position")
        if distance_m <= self.config.goal_tolerance_m:
            return Decision(STOP, PlannerStatus.GOAL_REACHED, "the goal is reached")
        return self._drive(observation, distance_m)

    def _drive(self, observation: Observation, distance_m: float) -> Decision:
        assert self._task is not None
        action = self._network.act(self._encoder.encode(observation, self._task.goal))
        wanted = given = self.policy.action.command(action)
        if not wanted.is_finite():
            return Decision(STOP, PlannerStatus.BLOCKED, "the policy's answer is not a number")
        if self.config.safety.enabled:
            given = safe_command(wanted, observation.odometry.velocity, observation.scan, self.config.safety)
        figures = {"goal_distance_m": distance_m, "wanted_mps": wanted.linear, "wanted_radps": wanted.angular}
        status, reason = PlannerStatus.RUNNING, ""
        if given.linear == 0.0 != wanted.linear:
            status, reason = PlannerStatus.BLOCKED, "an obstacle is too near to drive on"
        elif self._progress.stuck(observation.stamp_ns, observation.odometry.pose):
            limit_s = self.config.progress_limit_s
            status, reason = PlannerStatus.BLOCKED, f"the policy has not got anywhere for {limit_s:g} s"
        return Decision(given, status, reason, diagnostics=figures)


def shipped_policy() -> Path:
    """Return the policy that comes with the package."""
    return Path(str(importlib.resources.files("barn_planners"))) / "data" / "policy.npz"


ENTRY = PlannerEntry(
    PolicyPlanner, {ANY_PROTOCOL: PolicyConfig()}, "a learned policy from a file, with a stop before collisions"
)
