"""The elastic band (E-Band) for a differential drive, as in eband_local_planner, which ran in the paper's trials."""

import math

import numpy as np

from barn_planners.costmap.config import CostmapConfig
from barn_planners.costmap.costmap import Costmap
from barn_planners.costmap.kernels import INSCRIBED, LETHAL
from barn_planners.eband import forces, kernels
from barn_planners.eband.config import EBandConfig, EBandPlannerConfig
from barn_planners.global_plan.planner import visible_slice
from barn_planners.interface import FloatArray, PlannerView
from barn_planners.navigation.loop import (
    Control,
    ControlInput,
    Controller,
    NavigationPlanner,
)
from barn_planners.registry import PlannerEntry
from barn_planners.robots import fitted
from barn_worlds.base.compute import Compute
from barn_worlds.base.config import read_presets
from barn_worlds.base.types import STOP, Pose2D, Velocity2D, wrap_angle

_FULL_COST = 252.0
_FINAL_TURN_SHARE = 0.6


def bubble_radii(cost_weight_per_m: float) -> FloatArray:
    """Return the radius in metres by cost, (256,): 0 for lethal and inscribed; free and unknown as for cost 1."""
    costs = np.maximum(np.arange(256, dtype=np.float64), 1.0)
    radii = -np.log(costs / _FULL_COST) / cost_weight_per_m
    radii[INSCRIBED : LETHAL + 1] = 0.0
    radii[255] = radii[0]
    return radii


class ElasticBand:
    """A chain of overlapping bubbles. An operation that fails leaves the band as it was and returns the reason."""

    def __init__(self, config: EBandConfig):
        self._config = config
        self._radii = bubble_radii(config.cost_weight_per_m)
        self._work = kernels.band_work(config.capacity)
        self._band = np.zeros((config.capacity, 4))
        self._trial = np.zeros((config.capacity, 4))
        self._count = 0
        self._gains_for: CostmapConfig | None = None

    @property
    def bubbles(self) -> FloatArray:
        """The bubbles (n, 3): x, y, radius in metres, robot first."""
        return self._band[: self._count, : kernels.YAW]

    def clear(self) -> None:
        """Forget the band."""
        self._count = 0

    def follow_plan(self, poses: FloatArray, costmap: Costmap) -> str:
        """Make the band from a plan (n, 3), one bubble per pose, refined; return why it failed."""
        if len(poses) > len(self._trial):
            return kernels.REASONS[kernels.FULL]
        return self._adopt(
            forces.from_plan(self._trial, poses, *self._context(costmap))
        )

    def optimise(self, costmap: Costmap) -> str:
        """Adapt the band to the costmap; return why it failed. What fails while it moves leaves it refined."""
        bands = (self._band, self._trial, self._count)
        renewed, moved = forces.optimise(
            *bands, *self._context(costmap), self._config.sweeps
        )
        if renewed >= 0:
            self._count = renewed
        return self._adopt(moved)

    def advance(
        self, pose: Pose2D, ahead: FloatArray, costmap: Costmap
    ) -> tuple[bool, str]:
        """Connect the front to the robot, append poses (n, 3) and adapt; return if appended, and why a step failed."""
        yaw = wrap_angle(pose.yaw) if self._config.headings else 0.0
        task = (self._band, self._trial, self._count, (pose.x, pose.y, yaw), ahead)
        self._count, moved, appended = forces.advance(
            *task, *self._context(costmap), self._config.sweeps
        )
        return appended, self._adopt(moved)

    def _context(
        self, costmap: Costmap
    ) -> tuple[
        tuple[object, float, float, float, FloatArray],
        kernels.BandGains,
        kernels.BandWork,
    ]:
        if costmap.config is not self._gains_for:
            self._gains_for, self._gains = (
                costmap.config,
                self._config.gains(costmap.config.circumscribed_m),
            )
        return (costmap.costs, *costmap.grid, self._radii), self._gains, self._work

    def _adopt(self, count: int) -> str:
        if count < 0:
            return kernels.REASONS[count]
        self._band, self._trial = self._trial, self._band
        self._count = count
        return ""


class EBandController(Controller):
    """Follows a band: turns in place towards the next bubble, or drives at a speed set by the robot's bubble."""

    def __init__(self, config: EBandConfig):
        self.config = config
        self._band = ElasticBand(config)
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Begin a new trial and forget the last one; nothing is random."""
        del seed
        self._band.clear()
        self._visible_end = 0
        self._banded = False
        self._final_turn = False
        self._heading = 0.0

    def control(self, inputs: ControlInput) -> Control:
        """Update the band and steer along it."""
        problem = self._update(inputs)
        if problem:
            return Control(None, reason=problem)
        self._heading = inputs.pose.yaw
        return self._steer(inputs.pose, float(inputs.plan[self._visible_end - 1, 2]))

    def view(self) -> PlannerView:
        """Return the band and, as local plan, its centre line."""
        bubbles = self._band.bubbles.copy()
        if len(bubbles) < 2:
            return PlannerView()
        local_plan = bubbles.copy()
        local_plan[:-1, 2] = np.arctan2(np.diff(bubbles[:, 1]), np.diff(bubbles[:, 0]))
        local_plan[0, 2], local_plan[-1, 2] = self._heading, local_plan[-2, 2]
        return PlannerView(local_plan=local_plan, band=bubbles)

    def _update(self, inputs: ControlInput) -> str:
        """Update the band; return the reason if that fails, else an empty text."""
        if len(inputs.visible) == 0:
            return "no part of the plan is near the robot"
        # costmap_2d's size in metres leaves out half a cell
        reach_m = (
            0.5 * (max(inputs.costmap.costs.shape) - 0.5) * inputs.costmap.resolution
        )
        shown = visible_slice(inputs.plan, inputs.pose, reach_m)
        shown = slice(
            shown.start, min(shown.stop + 1, len(inputs.plan))
        )  # the first pose beyond belongs to it
        if inputs.new_plan or not self._banded:
            self._banded = False
            problem = self._take_plan(inputs, inputs.plan[shown])
            if problem:
                return problem
            self._banded, self._visible_end = True, shown.stop
        ahead = inputs.plan[max(self._visible_end, shown.start) : shown.stop]
        appended, problem = self._band.advance(inputs.pose, ahead, inputs.costmap)
        if appended:
            self._visible_end = max(self._visible_end, shown.stop)
        return problem

    def _take_plan(self, inputs: ControlInput, shown: FloatArray) -> str:
        """Make a new band; if the plan is in collision, clear the marks once and try again."""
        points = shown
        if len(points) < 2:
            points = np.vstack(
                [[inputs.pose.x, inputs.pose.y, inputs.pose.yaw], points]
            )
        problem = self._band.follow_plan(points, inputs.costmap)
        if problem and self.config.reset_costmap_once:
            inputs.costmap.reset()
            problem = self._band.follow_plan(points, inputs.costmap)
        if not problem and self.config.relax_new_plan:
            self._band.optimise(inputs.costmap)
        return problem

    def _steer(self, pose: Pose2D, goal_yaw: float) -> Control:
        config, bubbles = self.config, self._band.bubbles
        (_, _, robot_radius_m), (x, y, radius_m) = bubbles[:2].tolist()
        end_x, end_y, _ = bubbles[-1].tolist()
        to_end = math.hypot(end_x - pose.x, end_y - pose.y)
        distance = math.hypot(x - pose.x, y - pose.y)
        bearing = wrap_angle(math.atan2(y - pose.y, x - pose.x) - pose.yaw)
        figures = {
            "bubbles": float(len(bubbles)),
            "robot_radius_m": robot_radius_m,
            "bearing_rad": bearing,
            "distance_to_band_end_m": to_end,
        }
        if self._turns_finally(pose, (end_x, end_y, goal_yaw), to_end):
            turn = wrap_angle(goal_yaw - pose.yaw)
            if abs(turn) <= config.yaw_tolerance_rad:
                self._final_turn = False
                return Control(STOP, goal_reached=True, diagnostics=figures)
            return Control(
                Velocity2D(0.0, self._rate(turn, config.min_turn_in_place_radps)),
                diagnostics=figures,
            )
        threshold = config.rotation_threshold_multiplier * math.atan2(
            config.min_overlap * radius_m, distance
        )
        if abs(bearing) > threshold:
            return Control(
                Velocity2D(0.0, self._rate(bearing, config.min_turn_in_place_radps)),
                diagnostics=figures,
            )
        highest = config.max_speed_mps * (
            config.slow_share if to_end < config.slow_distance_m else 1.0
        )
        speed = (
            config.bubble_velocity_multiplier_per_m
            * config.min_overlap
            * robot_radius_m
            * highest
            * math.cos(bearing)
        )
        speed = min(max(speed, config.min_speed_mps), config.max_speed_mps)
        return Control(
            Velocity2D(float(speed), self._rate(bearing)), diagnostics=figures
        )

    def _turns_finally(
        self, pose: Pose2D, end: tuple[float, float, float], to_end_m: float
    ) -> bool:
        """Tell whether the band's end is reached, ahead and aside; once it is, the full tolerance applies."""
        limit_m = (
            1.0 if self._final_turn else _FINAL_TURN_SHARE
        ) * self.config.xy_tolerance_m
        self._final_turn = False
        if to_end_m <= 2.0 * limit_m:
            off = pose.inverse() @ Pose2D(*end)
            self._final_turn = max(abs(off.x), abs(off.y)) <= limit_m
        return self._final_turn

    def _rate(self, turn: float, slowest: float = 0.0) -> float:
        rate = self.config.k_prop_per_s * turn
        rate = math.copysign(slowest, turn) if abs(rate) < slowest else rate
        return min(max(rate, -self.config.max_turn_radps), self.config.max_turn_radps)


ENTRY = PlannerEntry(
    lambda config: NavigationPlanner(config, EBandController(config.band)),
    read_presets("barn_planners", "presets/eband.yaml", EBandPlannerConfig()),
    "elastic band of Quinlan and Khatib for a differential drive, as in the paper's trials",
    fitted,
    compute=Compute(delay_s=0.0005),
)
