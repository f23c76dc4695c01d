"""A learned policy as a planner.

Observations and actions are those of the learning environment, so what was trained
there drives here; see docs/learning.md.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from barn_planners.interface import Decision, Observation, PlannerStatus, Task
from barn_planners.navigation.observation_check import ObservationCheckConfig
from barn_planners.navigation.progress import ProgressCheck
from barn_planners.navigation.scan_planner import ScanPlanner
from barn_planners.policy.collision_check import CollisionCheckConfig, avoid_collision
from barn_planners.policy.file import load_network
from barn_planners.policy.space import FrameStack, ObservationEncoder
from barn_planners.registry import ANY_PROTOCOL, PlannerEntry
from barn_planners.robots import fit_to_robot
from barn_worlds.base.compute import Compute
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.files import package_data
from barn_worlds.base.types import STOP, Pose2D, Scan, Velocity2D
from barn_worlds.robots.robot import Robot

# Policies that come with the package, by what `policy_path` says.
SHIPPED = {
    "": "policy.npz",
    "static": "policy_static.npz",
    "moving": "policy_moving.npz",
}

# The planner's own robot, in arrays of many.
_ONLY = np.zeros(1, np.intp)


@dataclass(frozen=True)
class PolicyConfig(Checked):
    """The policy file, goal tolerance and checks."""

    policy_path: str = quantity(
        "",
        "policy file (.npz or .onnx) or a shipped policy: empty (static worlds, one scan),"
        " static (static worlds, three scans) or moving (moving obstacles)",
    )
    goal_tolerance_m: float = quantity(
        0.25, "distance within which the goal counts as reached", "m", 0.01, 10.0
    )
    progress_distance_m: float = quantity(
        0.3, "the robot is stuck if it does not move this far", "m", 0.01, 10.0
    )
    progress_limit_s: float = quantity(
        8.0, "time limit for moving progress_distance_m", "s", 0.1, 1000.0
    )
    safety: CollisionCheckConfig = field(default_factory=CollisionCheckConfig)
    guard: ObservationCheckConfig = field(default_factory=ObservationCheckConfig)

    @property
    def path(self) -> Path:
        """Path of the policy file; a name in `SHIPPED` stands for a shipped one."""
        if self.policy_path in SHIPPED:
            return shipped_policy(self.policy_path)
        return Path(self.policy_path)


class PolicyPlanner(ScanPlanner):
    """Evaluates the policy in every cycle and checks its command for collisions."""

    def __init__(self, config: PolicyConfig):
        """Read the policy file and make its network.

        Raises:
            BarnError: If its file cannot be read.
        """
        super().__init__(config.guard, config.goal_tolerance_m)
        self.config = config
        self.policy = load_network(config.path)
        self._encoder = ObservationEncoder(self.policy.observation)
        self._stack = FrameStack(1, self.policy.observation)
        # The command that holds, and for how many more cycles.
        self._command = STOP
        self._cycles_left = 0
        self._progress = ProgressCheck(
            config.progress_distance_m, config.progress_limit_s
        )

    def start(self, task: Task, seed: int) -> None:
        """Begin a new trial and forget the last one; map and seed are ignored.

        Args:
            task: Goal in the planning frame; its map is ignored.
            seed: Ignored: the policy is deterministic.
        """
        super().start(task, seed)
        self._progress.reset()
        self._stack.clear(0)
        self.policy.reset()
        self._cycles_left = 0

    def problem(self, scan: Scan) -> str:
        """Return why the policy cannot use a scan's angles, or an empty string."""
        return self._encoder.problem(scan)

    def drive(self, observation: Observation, goal: Pose2D) -> Decision:
        """Return the policy's checked command, STOP if NaN; BLOCKED if unsafe or stuck.

        Args:
            observation: Readings that passed all checks.
            goal: Goal in the planning frame.
        """
        config = self.config
        if self._cycles_left == 0:
            self._command = self._ask_policy(observation, goal)
            self._cycles_left = self.policy.action.repeat
        self._cycles_left -= 1

        # Files come from anybody: an answer that is not finite must stop the robot.
        policy_command = self._command
        if not policy_command.is_finite():
            return Decision(
                STOP, PlannerStatus.BLOCKED, "the policy's answer is not finite"
            )

        command = policy_command
        if config.safety.enabled:
            command = avoid_collision(
                policy_command,
                observation.odometry.velocity,
                observation.scan,
                config.safety,
            )
        reason = ""
        # Only the check can have done that; the trial's log tells it apart from a
        # policy that stops by itself.
        if command.linear == 0.0 and policy_command.linear != 0.0:
            reason = "an obstacle is too near to drive on"
        elif self._progress.is_stuck(observation.stamp_ns, observation.odometry.pose):
            reason = f"the policy made no progress for {config.progress_limit_s:g} s"
        return Decision(
            command,
            PlannerStatus.BLOCKED if reason else PlannerStatus.RUNNING,
            reason,
            diagnostics={
                "goal_distance_m": observation.pose.distance(goal),
                "wanted_mps": policy_command.linear,
                "wanted_radps": policy_command.angular,
            },
        )

    def _ask_policy(self, observation: Observation, goal: Pose2D) -> Velocity2D:
        """Add a frame; return the policy's command, whose numbers may be NaN."""
        frame = self._encoder.encode(observation, goal)
        vectors = np.empty((1, self.policy.observation.size), np.float32)
        self._stack.push(_ONLY, frame[None], vectors)
        return self.policy.action.command(self.policy.act(vectors[0]))


def shipped_policy(name: str = "") -> Path:
    """Return the path of a policy that comes with the package, by name in `SHIPPED`."""
    return package_data("barn_planners") / SHIPPED[name]


def _fit_to_robot(config: PolicyConfig, robot: Robot) -> dict[str, Any]:
    """Return parameters that change for a robot; ConfigError for a shipped policy."""
    # A network learns one body: what is narrow for another is not in its weights.
    if config.policy_path in SHIPPED:
        raise ConfigError(
            "the shipped policy was trained only for the Jackal; "
            f"set policy_path to one for {robot.name}"
        )
    return fit_to_robot(config, robot)


ENTRY = PlannerEntry(
    build=PolicyPlanner,
    presets={ANY_PROTOCOL: PolicyConfig()},
    summary="a learned policy from a file, with a stop before collisions",
    fit=_fit_to_robot,
    # The file decides the speed class, not a parameter of the planner.
    speed_cap=lambda config: load_network(config.path).action.cap_mps,
    compute=Compute(delay_s=0.0001),
)
