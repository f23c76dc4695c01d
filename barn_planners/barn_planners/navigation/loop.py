"""The navigation loop around a local planner, as in move_base: costmaps, global plan, control, recovery."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from barn_planners.costmap.config import CostmapConfig, GlobalCostmapConfig
from barn_planners.costmap.costmap import Costmap, RollingCostmap, global_costmap
from barn_planners.global_plan.planner import (
    GlobalPlanConfig,
    GlobalPlanner,
    count_passed_points,
    transform_plan,
    visible_slice,
)
from barn_planners.interface import (
    Decision,
    FloatArray,
    Observation,
    Planner,
    PlannerStatus,
    PlannerView,
    Task,
)
from barn_planners.navigation.guard import GuardConfig, LidarPlace, ObservationGuard
from barn_planners.navigation.recovery import Recovery, RecoveryConfig
from barn_worlds.base.config import quantity
from barn_worlds.base.types import STOP, Pose2D, Velocity2D, nanoseconds


@dataclass(frozen=True)
class NavigationConfig(LidarPlace):
    """Settings of all planners that follow a global plan."""

    control_period_s: float = quantity(
        0.05, "time between two commands; others are skipped", "s", 0.005, 1.0
    )
    plan_period_s: float = quantity(
        0.05, "time between two global plans", "s", 0.0, 60.0
    )
    goal_republish_period_s: float = quantity(
        0.0, "the goal is re-sent so often (a quirk); 0: once", "s", minimum=0.0
    )
    hold_s: float = quantity(
        0.0,
        "how long the last command holds while a goal waits for its plan",
        "s",
        minimum=0.0,
    )
    first_plan_waits: bool = quantity(
        False, "true: the first cycle only plans, as in move_base", optional=True
    )
    local_costmap_in_map: bool = quantity(
        False, "true: control is in the frame of the map, if one is given (a quirk)"
    )
    prune_m: float = quantity(
        1.0,
        "drop points of the plan before one nearer than this; 0: none",
        "m",
        minimum=0.0,
    )
    local_costmap: CostmapConfig = field(default_factory=CostmapConfig)
    global_costmap: GlobalCostmapConfig = field(default_factory=GlobalCostmapConfig)
    global_plan: GlobalPlanConfig = field(default_factory=GlobalPlanConfig)
    recovery: RecoveryConfig = field(default_factory=RecoveryConfig)
    guard: GuardConfig = field(default_factory=GuardConfig)


@dataclass(frozen=True, slots=True)
class ControlInput:
    """The input of a controller in one cycle, all in the odom frame."""

    stamp_ns: int
    pose: Pose2D
    velocity: Velocity2D
    costmap: Costmap
    plan: FloatArray  # (n, 3) x, y m, yaw rad, the whole global plan, ending in `goal`
    visible: FloatArray  # (m, 3), its part from the robot on that lies within the local costmap
    goal: Pose2D
    new_plan: bool  # since the controller was last called


@dataclass(frozen=True, slots=True)
class Control:
    """The output of a controller; `command` is None if no valid one was found, and `reason` says why."""

    command: Velocity2D | None
    goal_reached: bool = False
    reason: str = ""
    diagnostics: Mapping[str, float] = field(default_factory=dict)


class Controller(ABC):
    """A local planner that follows a plan, such as DWA or E-Band; one object serves trial after trial."""

    @abstractmethod
    def reset(self, seed: int) -> None:
        """Begin a new trial and forget the last one."""

    @abstractmethod
    def control(self, inputs: ControlInput) -> Control:
        """Return one command; must not raise, whatever the input."""

    def view(self) -> PlannerView:
        """Return the local plan, band or candidates of the last cycle, in the odom frame."""
        return PlannerView()


class NavigationPlanner(Planner):
    """Plans with or without a map and lets a controller follow the plan; one command per observation."""

    def __init__(self, config: NavigationConfig, controller: Controller):
        self.config = config
        self.controller = controller
        self._planner = GlobalPlanner(config.global_plan)
        self._recovery = Recovery(config.recovery)
        self._guard = ObservationGuard(config.guard)
        self._lidar = config.lidar
        periods_s = (
            config.control_period_s,
            config.plan_period_s,
            config.goal_republish_period_s,
        )
        self._control_ns, self._plan_ns, self._goal_ns = map(nanoseconds, periods_s)
        self._task: Task | None = None

    def start(self, task: Task, seed: int) -> None:
        """Begin a new trial: forget costmaps, plan and recovery."""
        self._task = task
        self._map_given = task.map is not None
        self._follows_in_map = self._map_given and self.config.local_costmap_in_map
        self._local = RollingCostmap(self.config.local_costmap)
        self._global = global_costmap(self.config.global_costmap, task.map, task.goal)
        self._global.beams = self._local.beams
        self._guard.reset()
        self._start_ns: int | None = None
        self._cycle = -1
        self._goal_count = 0
        self._hold_until_ns = 0
        self._planned_ns: int | None = None
        self._plan: FloatArray | None = None
        self._plan_is_new = False
        self._waiting = True
        self._done: Decision | None = None
        self._problem = self._cause = ""
        self.controller.reset(seed)

    def step(self, observation: Observation) -> Decision:
        """Return the decision for one observation; a stop with a reason if there is no other."""
        if self._task is None:
            return Decision(STOP, PlannerStatus.BLOCKED, "no task yet")
        problem = self._guard.problem(observation)
        if problem:
            return Decision(STOP, PlannerStatus.BLOCKED, problem)
        stamp = observation.stamp_ns
        if self._start_ns is None:
            self._start_ns = stamp
            self._recovery.restart(stamp)
        cycle = (
            stamp - self._start_ns + self._control_ns // 4
        ) // self._control_ns  # a quarter for jittering stamps
        if cycle == self._cycle:
            return Decision(None)
        self._cycle = cycle
        goal_again = self._goal_sent_again(stamp)
        if self._done is not None:
            return self._done
        self._local.update(self._robot(observation), observation.scan, self._lidar)
        self._global.update(observation.pose, observation.scan, self._lidar)
        self._prepare(observation)
        fresh = self._replan(observation, self._task.goal)
        first = cycle == 0 and self.config.first_plan_waits
        if (first or goal_again) and not self._waiting:
            return Decision(STOP if first else None, plan=fresh)
        return self._act(observation, self._task.goal, fresh)

    def view(self) -> PlannerView:
        """Return the plan and, in the frame of the local costmap, that costmap and what the controller shows."""
        if self._task is None:
            return PlannerView()
        plan = None if self._plan is None else self._plan[:, :2]
        costmap, in_map = self._local.as_map(), self._follows_in_map
        return replace(
            self.controller.view(), plan=plan, costmap=costmap, in_planning_frame=in_map
        )

    def _robot(self, observation: Observation) -> Pose2D:
        return observation.pose if self._follows_in_map else observation.odometry.pose

    def _prepare(self, observation: Observation) -> None: ...

    def _goal_sent_again(self, stamp_ns: int) -> bool:
        """Tell whether the goal was re-sent since the last cycle; it then waits for a plan and starts over."""
        if self._goal_ns == 0 or self._start_ns is None:
            return False
        count = (stamp_ns - self._start_ns) // self._goal_ns
        if count == self._goal_count:
            return False
        self._goal_count = count
        if not self._waiting:
            self._waiting = True
            self._hold_until_ns = stamp_ns + nanoseconds(self.config.hold_s)
        self._recovery.restart(stamp_ns)
        self._done = None
        return True

    def _replan(self, observation: Observation, goal: Pose2D) -> FloatArray | None:
        """Make a new plan if one is due and return its points, else None."""
        planned_ns = self._planned_ns
        if (
            not self._waiting
            and planned_ns is not None
            and observation.stamp_ns - planned_ns < self._plan_ns
        ):
            return None
        self._planned_ns = observation.stamp_ns
        found = self._planner.plan(self._global, observation.pose, goal)
        self._problem = found.reason
        if found.poses is None:
            return None
        self._plan, self._plan_is_new, self._waiting = found.poses, True, False
        self._recovery.found_plan(observation.stamp_ns)
        return found.poses[:, :2]

    def _act(
        self, observation: Observation, goal: Pose2D, fresh: FloatArray | None
    ) -> Decision:
        stamp = observation.stamp_ns
        if not self._waiting and not self._recovery.active:
            control = self._control(observation, goal)
            if control.goal_reached:
                self._done = Decision(
                    STOP, PlannerStatus.GOAL_REACHED, "the goal is reached"
                )
                return self._done
            if control.command is not None and control.command.is_finite():
                self._recovery.found_command(stamp)
                reason = (
                    f"following the last plan: {self._problem}" if self._problem else ""
                )
                return Decision(
                    control.command,
                    reason=reason,
                    plan=fresh,
                    diagnostics=control.diagnostics,
                )
            self._problem = control.reason or "no valid command"
            self._waiting, self._hold_until_ns = True, stamp
            self._recovery.missing_command(stamp)
        elif self._waiting:
            self._recovery.missing_plan(stamp)
        if self._recovery.active:
            self._cause = self._problem or self._cause
            return self._recover(observation, fresh)
        held = stamp < self._hold_until_ns
        return Decision(
            None if held else STOP, PlannerStatus.BLOCKED, self._problem, fresh
        )

    def _recover(self, observation: Observation, fresh: FloatArray | None) -> Decision:
        robot = self._robot(observation)
        clear = ((self._local, robot), (self._global, observation.pose))
        command = self._recovery.step(observation.stamp_ns, robot, self._local, clear)
        if self._recovery.aborted:
            self._done = Decision(
                STOP, PlannerStatus.FAILED, f"gave up after recovery: {self._cause}"
            )
            return self._done
        return Decision(command, PlannerStatus.RECOVERING, self._cause, fresh)

    def _control(self, observation: Observation, goal: Pose2D) -> Control:
        plan = self._plan
        if plan is None:
            return Control(None, reason=self._problem)
        robot = self._robot(observation)
        if self._map_given and not self._follows_in_map:
            odom_of_map = robot @ observation.pose.inverse()
            plan = transform_plan(plan, odom_of_map)
            goal = odom_of_map @ goal
        window = visible_slice(plan, robot, self._local.config.size_m / 2.0)
        if self.config.prune_m > 0.0:
            window = slice(
                window.start
                + count_passed_points(plan[window], robot, self.config.prune_m),
                window.stop,
            )
        new_plan, self._plan_is_new = self._plan_is_new, False
        if window.start == window.stop:
            return Control(None, reason="the plan does not come near the robot")
        stamp_ns, velocity = observation.stamp_ns, observation.odometry.velocity
        inputs = ControlInput(
            stamp_ns, robot, velocity, self._local, plan, plan[window], goal, new_plan
        )
        return self.controller.control(inputs)
