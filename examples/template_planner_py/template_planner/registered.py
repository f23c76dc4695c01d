"""The algorithm as a planner of the suite: `barn run --planner template`.

It runs in the process of a direct trial, or in the suite's node. setup.py announces
ENTRY in the entry point group `barn_planners.planners`, so installing the package is
enough.
"""

from dataclasses import dataclass

from barn_planners.interface import Decision, Observation, Planner, Task
from barn_planners.registry import PlannerEntry
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.types import Velocity2D
from template_planner.core import decide


@dataclass(frozen=True)
class TemplateConfig(Checked):
    """Settings: `--set max_speed_mps=0.8`, and ROS parameters of the same names."""

    max_speed_mps: float = quantity(
        0.5, "highest forward speed", "m/s", minimum=0.0, maximum=2.0
    )
    max_turn_radps: float = quantity(
        1.5, "highest yaw rate", "rad/s", minimum=0.0, maximum=4.0
    )


class TemplatePlanner(Planner):
    """Drives to the goal without a map."""

    def __init__(self, config: TemplateConfig) -> None:
        self.config = config

    def start(self, task: Task, seed: int) -> None:
        """Begin a trial.

        Args:
            task: Goal in the planning frame; its map is not used.
            seed: Source of anything random; nothing is random here.
        """
        del seed
        self._goal = task.goal

    def step(self, observation: Observation) -> Decision:
        """Decide on one command."""
        # Pose and goal are in the same frame: map if the task has a map, else odom.
        goal = observation.pose.inverse() @ self._goal
        speed, turn = decide(
            (goal.x, goal.y),
            observation.scan.ranges,
            observation.scan.angles(),
            self.config.max_speed_mps,
            self.config.max_turn_radps,
        )
        return Decision(Velocity2D(float(speed), float(turn)))


ENTRY = PlannerEntry(
    TemplatePlanner,
    {"default": TemplateConfig()},
    "drives to the freest heading near the goal's",
)
