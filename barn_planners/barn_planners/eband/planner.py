"""The elastic band (E-Band) for a differential drive as a controller.

It is eband_local_planner, which ran in the paper's trials.
"""

import math

import numpy as np

from barn_planners.costmap.config import CostmapConfig
from barn_planners.costmap.costmap import Costmap
from barn_planners.costmap.kernels import INSCRIBED, LETHAL, Pose
from barn_planners.eband import forces, kernels
from barn_planners.eband.config import EBandConfig, EBandPlannerConfig
from barn_planners.global_plan.kernels import visible_points
from barn_planners.interface import PlannerView
from barn_planners.navigation.loop import (
    Control,
    ControlInput,
    Controller,
    NavigationPlanner,
)
from barn_planners.registry import PlannerEntry
from barn_planners.robots import fit_to_robot
from barn_worlds.base.arrays import Floats
from barn_worlds.base.compute import Compute
from barn_worlds.base.config import read_presets
from barn_worlds.base.types import STOP, Pose2D, Velocity2D, wrap_angle

# Highest cost of a cell that is neither inscribed nor lethal.
_FULL_COST = 252.0
_FINAL_TURN_SHARE = 0.6


def bubble_radii(cost_weight_per_m: float) -> Floats:
    """Return the radii (256,) in m of bubbles, indexed by the cost at their centers.

    It is 0 for lethal and inscribed cells. Free and unknown cells count as cost 1.
    """
    # The logarithm has no value at cost 0; the original takes 1 instead.
    costs = np.maximum(np.arange(256, dtype=np.float64), 1.0)
    radii = -np.log(costs / _FULL_COST) / cost_weight_per_m
    radii[INSCRIBED : LETHAL + 1] = 0.0
    radii[255] = radii[0]
    return radii


class ElasticBand:
    """A chain of overlapping bubbles.

    An operation returns why it failed, or an empty string. If it fails, the band stays
    as it was.
    """

    def __init__(self, config: EBandConfig):
        """Allocate memory for `capacity` bubbles; the band is empty."""
        self._config = config
        self._radii = bubble_radii(config.cost_weight_per_m)
        self._work = kernels.new_band_work(config.capacity)
        self._band = np.zeros((config.capacity, 4))
        self._trial = np.zeros((config.capacity, 4))
        self._count = 0
        self._costmap_config: CostmapConfig | None = None

    @property
    def bubbles(self) -> Floats:
        """View (n, 3) of the bubbles: x, y and radius in m, robot first."""
        return self._band[: self._count, : kernels.YAW]

    def clear(self) -> None:
        """Empty the band."""
        self._count = 0

    def follow_plan(self, poses: Floats, costmap: Costmap) -> str:
        """Make a refined band from a plan; return why that fails, else an empty string.

        Args:
            poses: Poses (n, 3), x and y in m, yaw in rad, in the frame of the costmap.
            costmap: Local costmap.
        """
        if len(poses) > len(self._trial):
            return kernels.REASONS[kernels.FULL]

        return self._adopt(forces.from_plan(self._trial, poses, self._context(costmap)))

    def optimize(self, costmap: Costmap) -> str:
        """Renew and relax the band; return why that fails, else an empty string.

        If only the forces fail, the band is refined; else it stays as it was.
        """
        count, trial_count = forces.optimize(
            self._band, self._trial, self._count, self._context(costmap)
        )
        if count >= 0:
            self._count = count
        return self._adopt(trial_count)

    def advance(
        self, pose: Pose2D, ahead: Floats, costmap: Costmap
    ) -> tuple[bool, str]:
        """Connect the band, append poses, relax; return if appended and why not.

        Args:
            pose: Pose of the robot in the frame of the costmap.
            ahead: Poses (n, 3) to append, x and y in m, yaw in rad.
            costmap: Local costmap.

        Returns:
            Whether the poses are part of the band, and why a step failed.
        """
        yaw = wrap_angle(pose.yaw) if self._config.headings else 0.0
        self._count, trial_count, is_appended = forces.advance(
            self._band,
            self._trial,
            self._count,
            Pose(*pose.position, yaw),
            ahead,
            self._context(costmap),
        )
        return is_appended, self._adopt(trial_count)

    def _context(self, costmap: Costmap) -> kernels.Context:
        """Return the costmap's radii, the forces' constants and memory for kernels."""
        # The footprint changes only with the costmap's configuration.
        if costmap.config is not self._costmap_config:
            self._costmap_config = costmap.config
            self._gains = self._config.gains(costmap.config.circumscribed_m)

        clearance = kernels.Clearance(costmap.costs, costmap.grid, self._radii)
        return kernels.Context(clearance, self._gains, self._work)

    def _adopt(self, count: int) -> str:
        """Make the trial band the band and return "", or why its length is negative."""
        if count < 0:
            return kernels.REASONS[count]

        # Two arrays in turns, which spares a copy and leaves the band on failure.
        self._band, self._trial = self._trial, self._band
        self._count = count
        return ""


class EBandController(Controller):
    """Follows a band: turns toward the next bubble, or drives as fast as is safe."""

    def __init__(self, config: EBandConfig):
        """Allocate an empty band; `reset` begins each trial."""
        self.config = config
        self._band = ElasticBand(config)
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Forget band and plan of the last trial; `seed` is ignored."""
        del seed
        self._band.clear()
        self._has_band = False
        self._plan_end = 0  # number of the plan's poses that the band has covered
        self._is_final_turn = False
        self._yaw = 0.0

    def control(self, inputs: ControlInput) -> Control:
        """Update the band; return the command along it, or none and the reason."""
        problem = self._update(inputs)
        if problem:
            return Control(None, reason=problem)

        self._yaw = inputs.pose.yaw
        return self._steer(inputs.pose, float(inputs.plan[self._plan_end - 1, 2]))

    def view(self) -> PlannerView:
        """Return the band, and its center line as local plan; none below 2 bubbles."""
        bubbles = self._band.bubbles.copy()
        if len(bubbles) < 2:
            return PlannerView()

        steps = np.diff(bubbles, axis=0)
        local_plan = bubbles.copy()
        # Bubbles have no headings unless a quirk asks for them, so those of the line
        # count.
        local_plan[:-1, 2] = np.arctan2(steps[:, 1], steps[:, 0])
        local_plan[-1, 2] = local_plan[-2, 2]
        local_plan[0, 2] = self._yaw
        return PlannerView(local_plan=local_plan, band=bubbles)

    def _update(self, inputs: ControlInput) -> str:
        """Take any new plan, then advance; return why not or ""; may reset the costmap."""
        if len(inputs.visible) == 0:
            return "no part of the plan is near the robot"

        # costmap_2d's size in meters leaves out half a cell.
        costmap = inputs.costmap
        reach_m = 0.5 * (max(costmap.costs.shape) - 0.5) * costmap.resolution
        pose = inputs.pose
        start, end = visible_points(inputs.plan, *pose.position, reach_m)
        # The first pose beyond it belongs to the plan that the original sees.
        end = min(end + 1, len(inputs.plan))
        if inputs.new_plan or not self._has_band:
            self._has_band = False
            problem = self._take_plan(inputs, inputs.plan[start:end])
            if problem:
                return problem
            self._has_band = True
            self._plan_end = end

        ahead = inputs.plan[max(self._plan_end, start) : end]
        is_appended, problem = self._band.advance(pose, ahead, costmap)
        if is_appended:
            self._plan_end = max(self._plan_end, end)
        return problem

    def _take_plan(self, inputs: ControlInput, poses: Floats) -> str:
        """Make a band from poses, if set again with cleared marks; return why not.

        With `reset_costmap_once` a failure clears the costmap for a second attempt.
        """
        # A band has two bubbles at least.
        if len(poses) < 2:
            poses = np.vstack([inputs.pose.numbers, poses])

        problem = self._band.follow_plan(poses, inputs.costmap)
        if problem and self.config.reset_costmap_once:
            # Marks may be stale: the original clears them once before it gives up a
            # plan.
            inputs.costmap.reset()
            problem = self._band.follow_plan(poses, inputs.costmap)
        if not problem and self.config.relax_new_plan:
            self._band.optimize(inputs.costmap)
        return problem

    def _steer(self, pose: Pose2D, goal_yaw: float) -> Control:
        """Return the command along the band: turn, drive, or STOP at the goal.

        Follows `EBandTrajectoryCtrl::getTwistDifferentialDrive`
        (eband_trajectory_controller.cpp).
        """
        config = self.config
        bubbles = self._band.bubbles
        robot_radius_m = float(bubbles[0, 2])
        x, y, radius_m = bubbles[1].tolist()
        end_x, end_y, _ = bubbles[-1].tolist()
        end_distance_m = math.hypot(end_x - pose.x, end_y - pose.y)
        distance_m = math.hypot(x - pose.x, y - pose.y)
        bearing = wrap_angle(math.atan2(y - pose.y, x - pose.x) - pose.yaw)
        diagnostics = {
            "bubbles": float(len(bubbles)),
            "robot_radius_m": robot_radius_m,
            "bearing_rad": bearing,
            "distance_to_band_end_m": end_distance_m,
        }

        if self._is_at_end(pose, Pose2D(end_x, end_y, goal_yaw), end_distance_m):
            angle = wrap_angle(goal_yaw - pose.yaw)
            if abs(angle) <= config.yaw_tolerance_rad:
                self._is_final_turn = False
                return Control(STOP, goal_reached=True, diagnostics=diagnostics)
            return Control(self._turn(angle), diagnostics=diagnostics)

        # Within this angle the robot drives into the part where both bubbles overlap.
        half_angle = math.atan2(config.min_overlap * radius_m, distance_m)
        if abs(bearing) > config.rotation_threshold_multiplier * half_angle:
            return Control(self._turn(bearing), diagnostics=diagnostics)

        # The radius of the robot's bubble sets the speed: small near obstacles.
        slow_share = 1.0
        if end_distance_m < config.slow_distance_m:
            slow_share = config.slow_share
        speed = (
            config.bubble_velocity_multiplier_per_m
            * config.min_overlap
            * robot_radius_m
            * (config.max_speed_mps * slow_share)
            * math.cos(bearing)
        )
        speed = min(max(speed, config.min_speed_mps), config.max_speed_mps)
        command = Velocity2D(speed, self._turn_rate(bearing, 0.0))
        return Control(command, diagnostics=diagnostics)

    def _is_at_end(self, pose: Pose2D, end: Pose2D, distance_m: float) -> bool:
        """Return whether the robot is at the band's end, and remember that.

        Both coordinates count by themselves, in the robot's frame. Once the robot is
        there, the full tolerance applies.
        """
        share = 1.0 if self._is_final_turn else _FINAL_TURN_SHARE
        limit_m = share * self.config.xy_tolerance_m
        self._is_final_turn = False
        # Cheaper than the transform, which only nearby robots need.
        if distance_m <= 2.0 * limit_m:
            offset = pose.inverse() @ end
            self._is_final_turn = max(abs(offset.x), abs(offset.y)) <= limit_m
        return self._is_final_turn

    def _turn(self, angle: float) -> Velocity2D:
        """Return the command that turns in place by an angle in rad that remains."""
        slowest = self.config.min_turn_in_place_radps
        return Velocity2D(0.0, self._turn_rate(angle, slowest))

    def _turn_rate(self, angle: float, slowest: float) -> float:
        """Return the yaw rate (rad/s) for an angle (rad), at least `slowest`."""
        # A proportional law: bearings are small while the robot follows the band.
        rate = self.config.k_prop_per_s * angle
        if abs(rate) < slowest:
            rate = math.copysign(slowest, angle)
        fastest = self.config.max_turn_radps
        return min(max(rate, -fastest), fastest)


ENTRY = PlannerEntry(
    build=lambda config: NavigationPlanner(config, EBandController(config.band)),
    presets=read_presets("barn_planners", "presets/eband.yaml", EBandPlannerConfig()),
    summary="elastic band of Quinlan and Khatib for a differential drive, as in the "
    "paper's trials",
    fit=fit_to_robot,
    compute=Compute(delay_s=0.0005),
)
