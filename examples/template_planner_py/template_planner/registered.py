"""The algorithm as a planner of the suite: `barn run --planner template`, in one process or in the suite's node.

setup.py announces ENTRY in the entry point group `barn_planners.planners`; installing the package is all it takes.
"""

from dataclasses import dataclass

from barn_planners.interface import Decision, Observation, Planner, Task
from barn_planners.registry import PlannerEntry
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.types import Velocity2D
from template_planner.core import decide


@dataclass(frozen=True)
class TemplateConfig(Checked):
    """Settings: `--set max_speed_mps=0.8`, and ROS parameters of the same names and limits."""

    max_speed_mps: float = quantity(
        0.5, "highest forward speed", "m/s", minimum=0.0, maximum=2.0
    )
    max_turn_radps: float = quantity(
        1.5, "highest yaw rate", "rad/s", minimum=0.0, maximum=4.0
    )


class TemplatePlanner(Planner):
    """Goal and pose are both in the planning frame: map where the task has a map, else odom."""

    def __init__(self, config: TemplateConfig) -> None:
        self.config = config

    def start(self, task: Task, seed: int) -> None:  # noqa: ARG002
        """Begin a trial; whatever is random has to come from the seed."""
        self._goal = task.goal

    def step(self, observation: Observation) -> Decision:
        """Decide on one command."""
        goal = observation.pose.inverse() @ self._goal
        scan, config = observation.scan, self.config
        speed, turn = decide(
            (goal.x, goal.y),
            scan.ranges,
            scan.angles(),
            config.max_speed_mps,
            config.max_turn_radps,
        )
        return Decision(Velocity2D(float(speed), float(turn)))


ENTRY = PlannerEntry(
    TemplatePlanner,
    {"default": TemplateConfig()},
    "drives to the freest heading near the goal's",
)
