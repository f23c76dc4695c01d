"""The elastic band as a local planner for a differential drive.

After Quinlan and Khatib, "Elastic bands: connecting path planning and control", ICRA 1993, with the bubbles, failures
and control law of the eband_local_planner package, whose times the paper publishes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from barn_planners import eband_kernels as kernels
from barn_planners.controller import Control, ControlInput, Controller
from barn_planners.costmap import INSCRIBED, LETHAL, Costmap
from barn_planners.interface import FloatArray, PlannerView
from barn_planners.plan_window import visible_slice
from barn_worlds.config import Checked, quantity
from barn_worlds.errors import ConfigError
from barn_worlds.types import Pose2D, Velocity2D, wrap_angle

_FULL_COST = 252.0
_FINAL_TURN_SHARE = 0.6


@dataclass(frozen=True)
class EBandConfig(Checked):
    """The band and its control law; the defaults are those of the paper's trials."""

    max_speed_mps: float = quantity(0.5, "highest forward speed", "m/s", minimum=0.0, maximum=5.0)
    min_speed_mps: float = quantity(0.1, "lowest forward speed while driving", "m/s", minimum=0.0, maximum=5.0)
    max_turn_radps: float = quantity(1.57, "highest yaw rate", "rad/s", minimum=0.0, maximum=10.0)
    min_turn_in_place_radps: float = quantity(
        0.0, "lowest yaw rate when turning in place", "rad/s", minimum=0.0, maximum=10.0
    )
    xy_tolerance_m: float = quantity(
        0.1, "the final turn starts within 0.6 of this from the goal", "m", minimum=0.01, maximum=5.0
    )
    yaw_tolerance_rad: float = quantity(
        0.05, "the goal is reached when turned to within this", "rad", minimum=0.001, maximum=math.pi
    )
    min_overlap: float = quantity(
        0.7, "bubbles overlap if nearer than this share of the sum of their radii", minimum=0.1, maximum=1.0
    )
    tiny_bubble_m: float = quantity(0.01, "bubbles up to this radius cannot be put in", "m", minimum=0.001, maximum=1.0)
    cost_weight_per_m: float = quantity(
        10.0, "a cell of cost c gives a bubble of radius -ln(c / 252) / weight", "1/m", minimum=0.1, maximum=1000.0
    )
    internal_gain: float = quantity(1.0, "strength of the contracting force", minimum=0.0, maximum=100.0)
    external_gain: float = quantity(2.0, "strength of the force away from obstacles", minimum=0.0, maximum=100.0)
    sweeps: int = quantity(3, "sweeps of forces per cycle, each forward and backward", minimum=0, maximum=100)
    halvings: int = quantity(4, "how often a step that overshoots is halved", minimum=0, maximum=20)
    overshoot: float = quantity(
        0.75, "a step overshoots if the force turns and keeps more than this share of its strength", minimum=0.0
    )
    significant_force: float = quantity(0.15, "weaker forces count as balanced", minimum=0.0, maximum=10.0)
    bubble_velocity_multiplier_per_m: float = quantity(
        2.0, "share of the highest speed per metre of the usable radius of the robot's bubble", "1/m", minimum=0.0
    )
    rotation_threshold_multiplier: float = quantity(
        1.0, "turn in place beyond this many times the angle that the next bubble fills", minimum=0.0, maximum=10.0
    )
    k_prop_per_s: float = quantity(4.0, "yaw rate per radian of bearing", "1/s", minimum=0.0, maximum=100.0)
    slow_distance_m: float = quantity(0.75, "nearer to the goal the speed is reduced", "m", minimum=0.0, maximum=10.0)
    slow_share: float = quantity(0.5, "share of the highest speed left there", minimum=0.0, maximum=1.0)
    relax_new_plan: bool = quantity(False, "apply one cycle's forces to a new plan before it is used")
    reset_costmap_once: bool = quantity(
        False, "forget the marks of the local costmap when a new plan is in collision, and try again (a quirk)"
    )
    capacity: int = quantity(4096, "most bubbles of a band", minimum=16, maximum=100_000)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.min_speed_mps > self.max_speed_mps:
            raise ConfigError(
                f"{type(self).__name__}.min_speed_mps must be at most max_speed_mps = {self.max_speed_mps:g},"
                f" got {self.min_speed_mps:g}"
            )

    def gains(self) -> kernels.BandGains:
        """Return what the kernels need."""
        return kernels.BandGains(
            self.min_overlap,
            self.tiny_bubble_m,
            self.internal_gain,
            self.external_gain,
            self.overshoot,
            self.significant_force,
            self.halvings,
        )


def bubble_radii(cost_weight_per_m: float) -> FloatArray:
    """Return the radius in metres by cost, (256,): lethal and inscribed 0, free and unknown as cost 1."""
    costs = np.maximum(np.arange(256, dtype=np.float64), 1.0)
    radii = -np.log(costs / _FULL_COST) / cost_weight_per_m
    radii[INSCRIBED : LETHAL + 1] = 0.0
    radii[255] = radii[0]
    return radii


class ElasticBand:
    """A chain of overlapping bubbles; an operation that fails leaves the band as it was and says why."""

    def __init__(self, config: EBandConfig):
        self._gains = config.gains()
        self._sweeps = config.sweeps
        self._radii = bubble_radii(config.cost_weight_per_m)
        self._work = kernels.band_work(config.capacity)
        self._band = np.zeros((config.capacity, 3))
        self._trial = np.zeros((config.capacity, 3))
        self._count = 0

    @property
    def bubbles(self) -> FloatArray:
        """The bubbles (n, 3): x, y, radius in metres, robot first."""
        return self._band[: self._count]

    def clear(self) -> None:
        """Forget the band."""
        self._count = 0

    def follow_plan(self, points: FloatArray, costmap: Costmap) -> str:
        """Make the band from a plan (n, 2 or more), one bubble per point, refined; return why not, or nothing."""
        if len(points) > len(self._trial):
            return kernels.REASONS[kernels.FULL]
        self._trial[: len(points), :2] = points[:, :2]
        return self._adopt(kernels.optimise(self._trial, len(points), *self._context(costmap), 0))

    def connect(self, pose: Pose2D, costmap: Costmap) -> str:
        """Let the band begin at the robot; return why not, or nothing."""
        self._copy()
        return self._adopt(kernels.connect_front(self._trial, self._count, pose.x, pose.y, *self._context(costmap)))

    def append(self, points: FloatArray, costmap: Costmap) -> str:
        """Continue the band through points (n, 2 or more); return why not, or nothing."""
        self._copy()
        ahead = np.ascontiguousarray(points[:, :2])
        return self._adopt(kernels.append_back(self._trial, self._count, ahead, *self._context(costmap)))

    def optimise(self, costmap: Costmap) -> str:
        """Adapt the band to the costmap; return why not, or nothing."""
        self._copy()
        return self._adopt(kernels.optimise(self._trial, self._count, *self._context(costmap), self._sweeps))

    def _context(
        self, costmap: Costmap
    ) -> tuple[tuple[object, float, float, float, FloatArray], kernels.BandGains, kernels.BandWork]:
        grid = (costmap.costs, costmap.origin_x, costmap.origin_y, costmap.resolution, self._radii)
        return grid, self._gains, self._work

    def _copy(self) -> None:
        self._trial[: self._count] = self._band[: self._count]

    def _adopt(self, count: int) -> str:
        if count < 0:
            return kernels.REASONS[count]
        self._band, self._trial = self._trial, self._band
        self._count = count
        return ""


class EBandController(Controller):
    """Drives along a band: turn in place towards the next bubble, else forward at a speed set by the robot's radius."""

    def __init__(self, config: EBandConfig):
        self.config = config
        self._band = ElasticBand(config)
        self.reset(0)

    def reset(self, seed: int) -> None:  # noqa: ARG002  nothing is random here
        """Begin a new trial and forget the last one."""
        self._band.clear()
        self._visible_end = 0
        self._banded = False
        self._final_turn = False
        self._heading = 0.0

    def control(self, inputs: ControlInput) -> Control:
        """Bring the band up to date and steer along it."""
        problem = self._update(inputs)
        if problem:
            return Control(None, reason=problem)
        self._heading = inputs.pose.yaw
        return self._steer(inputs.pose, float(inputs.plan[self._visible_end - 1, 2]))

    def view(self) -> PlannerView:
        """Return the band and its centre line with the direction of travel."""
        bubbles = self._band.bubbles.copy()
        if len(bubbles) < 2:
            return PlannerView()
        local_plan = bubbles.copy()
        local_plan[:-1, 2] = np.arctan2(np.diff(bubbles[:, 1]), np.diff(bubbles[:, 0]))
        local_plan[0, 2], local_plan[-1, 2] = self._heading, local_plan[-2, 2]
        return PlannerView(local_plan=local_plan, band=bubbles)

    def _update(self, inputs: ControlInput) -> str:
        """Bring the band up to date; return why it is not, or nothing."""
        if len(inputs.visible) == 0:
            return "no part of the plan is near the robot"
        shown = visible_slice(inputs.plan, inputs.pose, inputs.costmap.config.size_m / 2.0)
        if inputs.new_plan or not self._banded:
            self._banded = False
            problem = self._take_plan(inputs, inputs.plan[shown])
            if problem:
                return problem
            self._banded, self._visible_end = True, shown.stop
        problem = self._band.connect(inputs.pose, inputs.costmap)
        if not problem and shown.stop > self._visible_end:
            problem = self._band.append(inputs.plan[self._visible_end : shown.stop], inputs.costmap)
            if not problem:
                self._visible_end = shown.stop
        return problem or self._band.optimise(inputs.costmap)

    def _take_plan(self, inputs: ControlInput, shown: FloatArray) -> str:
        """Make the band anew; where the plan is in collision, forget the marks once and try again."""
        points = shown[:, :2]
        if len(points) < 2:
            points = np.vstack([[inputs.pose.x, inputs.pose.y], points])
        problem = self._band.follow_plan(points, inputs.costmap)
        if problem and self.config.reset_costmap_once:
            inputs.costmap.reset()
            problem = self._band.follow_plan(points, inputs.costmap)
        if not problem and self.config.relax_new_plan:
            self._band.optimise(inputs.costmap)
        return problem

    def _steer(self, pose: Pose2D, goal_yaw: float) -> Control:
        config, bubbles = self.config, self._band.bubbles
        robot, target, end = bubbles[0], bubbles[1], bubbles[-1]
        to_end = math.hypot(end[0] - pose.x, end[1] - pose.y)
        distance = math.hypot(target[0] - pose.x, target[1] - pose.y)
        bearing = wrap_angle(math.atan2(target[1] - pose.y, target[0] - pose.x) - pose.yaw)
        figures = {
            "bubbles": float(len(bubbles)),
            "robot_radius_m": float(robot[2]),
            "bearing_rad": bearing,
            "distance_to_band_end_m": to_end,
        }
        if self._turns_finally(to_end):
            turn = wrap_angle(goal_yaw - pose.yaw)
            if abs(turn) <= config.yaw_tolerance_rad:
                return Control(Velocity2D(), goal_reached=True, diagnostics=figures)
            return Control(Velocity2D(0.0, self._in_place(turn)), diagnostics=figures)
        threshold = config.rotation_threshold_multiplier * math.atan2(config.min_overlap * target[2], distance)
        if abs(bearing) > threshold:
            return Control(Velocity2D(0.0, self._in_place(bearing)), diagnostics=figures)
        highest = config.max_speed_mps * (config.slow_share if to_end < config.slow_distance_m else 1.0)
        speed = config.bubble_velocity_multiplier_per_m * config.min_overlap * robot[2] * highest * math.cos(bearing)
        speed = min(max(speed, config.min_speed_mps), config.max_speed_mps)
        return Control(Velocity2D(float(speed), self._clipped(config.k_prop_per_s * bearing)), diagnostics=figures)

    def _turns_finally(self, to_end: float) -> bool:
        """Tell whether the goal's position is reached; once it is, that holds within the whole tolerance."""
        share = 1.0 if self._final_turn else _FINAL_TURN_SHARE
        self._final_turn = to_end < share * self.config.xy_tolerance_m
        return self._final_turn

    def _in_place(self, turn: float) -> float:
        rate = self.config.k_prop_per_s * turn
        if abs(rate) < self.config.min_turn_in_place_radps:
            rate = math.copysign(self.config.min_turn_in_place_radps, turn)
        return self._clipped(rate)

    def _clipped(self, rate: float) -> float:
        return min(max(rate, -self.config.max_turn_radps), self.config.max_turn_radps)
