"""The interface between the navigation loop and a local planner that follows its plan, such as DWA or E-Band."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field

from barn_planners.costmap.costmap import Costmap
from barn_planners.interface import FloatArray, PlannerView
from barn_worlds.base.types import Pose2D, Velocity2D


@dataclass(frozen=True, slots=True)
class ControlInput:
    """The input of a controller in one cycle, all in the odom frame.

    plan: (n, 3) x, y m, yaw rad, the whole global plan, ending in `goal`.
    visible: (m, 3), its part from the robot on that lies within the local costmap.
    new_plan: whether there is a new global plan since the controller was last called.
    """

    stamp_ns: int
    pose: Pose2D
    velocity: Velocity2D
    costmap: Costmap
    plan: FloatArray
    visible: FloatArray
    goal: Pose2D
    new_plan: bool


@dataclass(frozen=True, slots=True)
class Control:
    """The output of a controller; `command` is None if no valid one was found, and `reason` says why."""

    command: Velocity2D | None
    goal_reached: bool = False
    reason: str = ""
    diagnostics: Mapping[str, float] = field(default_factory=dict)


class Controller(ABC):
    """A local planner; one object serves trial after trial."""

    @abstractmethod
    def reset(self, seed: int) -> None:
        """Begin a new trial and forget the last one."""

    @abstractmethod
    def control(self, inputs: ControlInput) -> Control:
        """Return one command; must not raise, whatever the input."""

    def view(self) -> PlannerView:
        """Return the local plan, band or candidates of the last cycle, in the odom frame."""
        return PlannerView()
