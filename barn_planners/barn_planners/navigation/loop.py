"""The navigation loop around a local planner, as in move_base.

Each control cycle updates two costmaps from the scan, makes a global plan if one is
due, and lets a controller follow it. Recovery takes over where plan or command are
missing.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from barn_planners.costmap.config import CostmapConfig, GlobalCostmapConfig
from barn_planners.costmap.costmap import Costmap, RollingCostmap, global_costmap
from barn_planners.global_plan.kernels import passed_points, visible_points
from barn_planners.global_plan.planner import (
    GlobalPlanConfig,
    GlobalPlanner,
    transform_plan,
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
from barn_planners.navigation.observation_check import (
    LidarMountConfig,
    ObservationCheck,
    ObservationCheckConfig,
)
from barn_planners.navigation.recovery import Recovery, RecoveryConfig
from barn_worlds.base.config import optional, quantity
from barn_worlds.base.types import STOP, Pose2D, Velocity2D, nanoseconds


@dataclass(frozen=True)
class NavigationConfig(LidarMountConfig):
    """Settings of all planners that follow a global plan."""

    control_period_s: float = quantity(
        0.05,
        "time between two commands; readings in between are skipped",
        "s",
        0.005,
        1.0,
    )
    plan_period_s: float = quantity(
        0.05, "time between two global plans", "s", 0.0, 60.0
    )
    goal_republish_period_s: float = quantity(
        0.0,
        "period at which the goal is sent again (a quirk); 0: the goal is sent once",
        "s",
        minimum=0.0,
    )
    hold_s: float = quantity(
        0.0,
        "time for which the last command stays valid while a goal that was sent again waits for its plan",
        "s",
        minimum=0.0,
    )
    first_plan_waits: bool = optional(
        False, "true: the first cycle only plans, as in move_base"
    )
    local_costmap_in_map: bool = quantity(
        False, "true: the controller works in the map frame if there is a map (a quirk)"
    )
    prune_m: float = quantity(
        1.0,
        "drop the plan's points before the first within this distance; 0: keep all",
        "m",
        minimum=0.0,
    )
    local_costmap: CostmapConfig = field(default_factory=CostmapConfig)
    global_costmap: GlobalCostmapConfig = field(default_factory=GlobalCostmapConfig)
    global_plan: GlobalPlanConfig = field(default_factory=GlobalPlanConfig)
    recovery: RecoveryConfig = field(default_factory=RecoveryConfig)
    guard: ObservationCheckConfig = field(default_factory=ObservationCheckConfig)


@dataclass(frozen=True, slots=True)
class ControlInput:
    """What a controller gets in one cycle, all in the frame of the local costmap.

    That frame is odom, or map with the quirk `local_costmap_in_map`.
    """

    # Simulated time since the start of the trial, in ns.
    stamp_ns: int
    # Pose of the robot.
    pose: Pose2D
    # Speed and yaw rate as the odometry measures them.
    velocity: Velocity2D
    # Costs around the robot.
    costmap: Costmap
    # The whole global plan (n, 3): x and y in m, yaw in rad. It ends in `goal`.
    plan: FloatArray
    # The part of the plan (m, 3) from the robot on that lies within the local costmap.
    visible: FloatArray
    goal: Pose2D
    # Whether the global plan changed since the controller was last called.
    new_plan: bool


@dataclass(frozen=True, slots=True)
class Control:
    """What a controller answers in one cycle."""

    # Speed and yaw rate; None if no valid command exists.
    command: Velocity2D | None
    goal_reached: bool = False
    # One line that explains a missing command.
    reason: str = ""
    # Values of this cycle for logs, by name. Names end in SI units.
    diagnostics: Mapping[str, float] = field(default_factory=dict)


class Controller(ABC):
    """A local planner that follows a plan; one object serves all trials."""

    @abstractmethod
    def reset(self, seed: int) -> None:
        """Begin a new trial and forget the last one; draw only from `seed`."""

    @abstractmethod
    def control(self, inputs: ControlInput) -> Control:
        """Return one cycle's command, or None with a reason; must not raise."""

    def view(self) -> PlannerView:
        """Return what the last cycle considered, in the frame of the local costmap.

        It is empty by default.
        """
        return PlannerView()


class NavigationPlanner(Planner):
    """Plans with or without a map and lets a controller follow the plan."""

    def __init__(self, config: NavigationConfig, controller: Controller):
        """Make the parts of the loop; `start` begins each trial."""
        self.config = config
        self.controller = controller
        self._global_planner = GlobalPlanner(config.global_plan)
        self._recovery = Recovery(config.recovery)
        self._check = ObservationCheck(config.guard)
        self._lidar = config.lidar
        self._control_period_ns = nanoseconds(config.control_period_s)
        self._plan_period_ns = nanoseconds(config.plan_period_s)
        self._goal_period_ns = nanoseconds(config.goal_republish_period_s)
        self._task: Task | None = None

    def start(self, task: Task, seed: int) -> None:
        """Begin a new trial: forget costmaps, plan and recovery, reset the controller.

        Args:
            task: Goal in the planning frame, and the map to plan on if there is one.
            seed: Handed to the controller; the loop itself draws nothing.
        """
        config = self.config
        self._task = task
        self._goal = task.goal
        self._has_map = task.map is not None
        self._controls_in_map = self._has_map and config.local_costmap_in_map
        self._local_costmap = RollingCostmap(config.local_costmap)
        self._global_costmap = global_costmap(
            config.global_costmap, task.map, task.goal
        )
        # Both costmaps see the same scan: directions of its beams are computed once.
        self._global_costmap.beams = self._local_costmap.beams
        self._check.reset()
        self._start_ns: int | None = None
        self._cycle = -1
        self._goal_count = 0
        # Until then the last command holds while a re-sent goal waits for its plan.
        self._hold_until_ns = 0
        self._planned_ns: int | None = None
        self._plan: FloatArray | None = None
        self._plan_is_new = False
        self._waits_for_plan = True
        # Repeated in every cycle once the goal is reached or given up.
        self._final_decision: Decision | None = None
        self._problem = ""
        self._recovery_cause = ""
        self.controller.reset(seed)

    def step(self, observation: Observation) -> Decision:
        """Return a cycle's decision: drive, stop, recover; one command per period.

        Its command is None for further observations within one control period.
        """
        if self._task is None:
            return Decision(STOP, PlannerStatus.BLOCKED, "no task yet")
        problem = self._check.problem(observation)
        if problem:
            return Decision(STOP, PlannerStatus.BLOCKED, problem)

        stamp_ns = observation.stamp_ns
        if self._start_ns is None:
            self._start_ns = stamp_ns
            self._recovery.restart(stamp_ns)

        # A quarter of a period, so that a stamp that jitters stays in its own cycle.
        elapsed_ns = stamp_ns - self._start_ns + self._control_period_ns // 4
        cycle = elapsed_ns // self._control_period_ns
        if cycle == self._cycle:
            return Decision(None)
        self._cycle = cycle

        is_goal_resent = self._restart_for_resent_goal(stamp_ns)
        if self._final_decision is not None:
            return self._final_decision

        control_pose = self.control_pose(observation)
        self._local_costmap.update(control_pose, observation.scan, self._lidar)
        self._global_costmap.update(observation.pose, observation.scan, self._lidar)
        self.prepare_control(observation)
        new_plan = self._replan(observation)

        is_first = cycle == 0 and self.config.first_plan_waits
        if (is_first or is_goal_resent) and not self._waits_for_plan:
            return Decision(STOP if is_first else None, plan=new_plan)
        return self._act(observation, new_plan)

    def view(self) -> PlannerView:
        """Return plan, costmap and the controller's view; empty before `start`."""
        if self._task is None:
            return PlannerView()
        return replace(
            self.controller.view(),
            plan=None if self._plan is None else self._plan[:, :2],
            costmap=self._local_costmap.as_map(),
            in_planning_frame=self._controls_in_map,
        )

    def control_pose(self, observation: Observation) -> Pose2D:
        """Return the robot's pose in the frame of the local costmap, odom or map."""
        if self._controls_in_map:
            return observation.pose
        return observation.odometry.pose

    def prepare_control(self, observation: Observation) -> None:
        """Do nothing; derived planners prepare here, between costmaps and plan."""

    def _restart_for_resent_goal(self, stamp_ns: int) -> bool:
        """Start over if the goal is due to be sent again; return whether it is."""
        if self._goal_period_ns == 0 or self._start_ns is None:
            return False
        count = (stamp_ns - self._start_ns) // self._goal_period_ns
        if count == self._goal_count:
            return False

        self._goal_count = count
        if not self._waits_for_plan:
            self._waits_for_plan = True
            self._hold_until_ns = stamp_ns + nanoseconds(self.config.hold_s)
        self._recovery.restart(stamp_ns)
        self._final_decision = None
        return True

    def _replan(self, observation: Observation) -> FloatArray | None:
        """Make and keep a plan if one is due; return its points (n, 2), else None."""
        stamp_ns = observation.stamp_ns
        if (
            not self._waits_for_plan
            and self._planned_ns is not None
            and stamp_ns - self._planned_ns < self._plan_period_ns
        ):
            return None

        self._planned_ns = stamp_ns
        result = self._global_planner.plan(
            self._global_costmap, observation.pose, self._goal
        )
        self._problem = result.reason
        if result.poses is None:
            return None
        self._plan = result.poses
        self._plan_is_new = True
        self._waits_for_plan = False
        self._recovery.record_plan(stamp_ns)
        return result.poses[:, :2]

    def _act(self, observation: Observation, new_plan: FloatArray | None) -> Decision:
        """Return the controller's command, or what waiting or recovery does instead."""
        stamp_ns = observation.stamp_ns
        if not self._waits_for_plan and not self._recovery.active:
            control = self._run_controller(observation)
            if control.goal_reached:
                self._final_decision = Decision(
                    STOP, PlannerStatus.GOAL_REACHED, "the goal is reached"
                )
                return self._final_decision
            # A third-party controller may answer NaN, which must not reach a robot.
            if control.command is not None and control.command.is_finite():
                self._recovery.record_command(stamp_ns)
                reason = ""
                if self._problem:
                    reason = f"following the last plan: {self._problem}"
                return Decision(
                    control.command,
                    reason=reason,
                    plan=new_plan,
                    diagnostics=control.diagnostics,
                )
            self._problem = control.reason or "no valid command"
            self._waits_for_plan = True
            self._hold_until_ns = stamp_ns
            self._recovery.record_missing_command(stamp_ns)
        elif self._waits_for_plan:
            self._recovery.record_missing_plan(stamp_ns)

        if self._recovery.active:
            return self._recover(observation, new_plan)
        command = None if stamp_ns < self._hold_until_ns else STOP
        return Decision(command, PlannerStatus.BLOCKED, self._problem, new_plan)

    def _recover(
        self, observation: Observation, new_plan: FloatArray | None
    ) -> Decision:
        """Return the recovery's command of a cycle; FAILED for good if it gives up."""
        self._recovery_cause = self._problem or self._recovery_cause
        costmap_poses = (
            (self._local_costmap, self.control_pose(observation)),
            (self._global_costmap, observation.pose),
        )
        command = self._recovery.step(observation.stamp_ns, costmap_poses)
        cause = self._recovery_cause
        if self._recovery.aborted:
            self._final_decision = Decision(
                STOP, PlannerStatus.FAILED, f"gave up after recovery: {cause}"
            )
            return self._final_decision
        return Decision(command, PlannerStatus.RECOVERING, cause, new_plan)

    def _run_controller(self, observation: Observation) -> Control:
        """Return the controller's answer to the plan, or only a reason if none is near.

        The controller gets plan, pose and goal in the frame of the local costmap.
        """
        plan = self._plan
        if plan is None:
            return Control(None, reason=self._problem)

        pose = self.control_pose(observation)
        goal = self._goal
        if self._has_map and not self._controls_in_map:
            odom_from_map = pose @ observation.pose.inverse()
            plan = transform_plan(plan, odom_from_map)
            goal = odom_from_map @ goal

        reach_m = self._local_costmap.config.size_m / 2.0
        start, end = visible_points(plan, *pose.position, reach_m)
        prune_m = self.config.prune_m
        if prune_m > 0.0:
            start += passed_points(plan[start:end], *pose.position, prune_m)

        new_plan = self._plan_is_new
        self._plan_is_new = False
        if start == end:
            return Control(None, reason="the plan does not come near the robot")
        return self.controller.control(
            ControlInput(
                observation.stamp_ns,
                pose,
                observation.odometry.velocity,
                self._local_costmap,
                plan,
                plan[start:end],
                goal,
                new_plan,
            )
        )
