"""The types that users of `barn_eval` need, each defined in its own package."""

from barn_eval.trials.protocol import Protocol as Protocol
from barn_eval.trials.result import TrialResult as TrialResult
from barn_eval.trials.run_config import PlannerChoice as PlannerChoice
from barn_planners.interface import Decision as Decision
from barn_planners.interface import Observation as Observation
from barn_planners.interface import Planner as Planner
from barn_planners.interface import Task as Task
from barn_worlds.base.errors import BarnError as BarnError
from barn_worlds.base.types import Velocity2D as Velocity2D
from barn_worlds.robots.robot import Robot as Robot
from barn_worlds.worlds.world import World as World
