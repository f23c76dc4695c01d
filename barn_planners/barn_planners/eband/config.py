"""Settings of the elastic band and its presets."""

import math
from dataclasses import dataclass, field, replace
from typing import Any

from barn_planners.costmap.costmap import CostmapConfig, GlobalCostmapConfig
from barn_planners.eband.kernels import BandGains
from barn_planners.global_plan.planner import GlobalPlanConfig
from barn_planners.navigation.loop import PAPER_HOLD_S, NavigationConfig
from barn_planners.navigation.recovery import RecoveryConfig
from barn_worlds.base.config import Checked, quantity


@dataclass(frozen=True)
class EBandConfig(Checked):
    """The band and its control law; the defaults are those of the paper's trials."""

    max_speed_mps: float = quantity(0.5, "highest forward speed", "m/s", 0.0, 5.0)
    min_speed_mps: float = quantity(0.1, "lowest forward speed while driving", "m/s", 0.0, 5.0)
    max_turn_radps: float = quantity(1.57, "highest yaw rate", "rad/s", 0.0, 10.0)
    min_turn_in_place_radps: float = quantity(0.0, "lowest yaw rate when turning in place", "rad/s", 0.0, 10.0)
    xy_tolerance_m: float = quantity(0.1, "the final turn starts within 0.6 times this from the goal", "m", 0.01, 5.0)
    yaw_tolerance_rad: float = quantity(0.05, "the goal is reached when turned to within this", "rad", 0.001, math.pi)
    min_overlap: float = quantity(0.7, "bubbles overlap if nearer than this share of their radii", "", 0.1, 1.0)
    tiny_bubble_m: float = quantity(0.01, "bubbles up to this radius cannot be inserted", "m", 0.001, 1.0)
    cost_weight_per_m: float = quantity(10.0, "cost c gives the radius -ln(c / 252) / weight", "1/m", 0.1, 1000.0)
    internal_gain: float = quantity(1.0, "strength of the contracting force", "", 0.0, 100.0)
    external_gain: float = quantity(2.0, "strength of the force away from obstacles", "", 0.0, 100.0)
    sweeps: int = quantity(3, "sweeps of forces per cycle, each forward and backward", "", 0, 100)
    halvings: int = quantity(4, "how often a step that overshoots is halved again", "", 0, 20)
    overshoot: float = quantity(0.75, "share of the force that a step may keep when it reverses", minimum=0.0)
    significant_force: float = quantity(0.15, "weaker forces count as balanced", "", 0.0, 10.0)
    bubble_velocity_multiplier_per_m: float = quantity(2.0, "share of top speed per m of bubble", "1/m", minimum=0.0)
    rotation_threshold_multiplier: float = quantity(1.0, "turn in place beyond this many bubble angles", "", 0.0, 10.0)
    k_prop_per_s: float = quantity(4.0, "yaw rate per radian of bearing", "1/s", 0.0, 100.0)
    slow_distance_m: float = quantity(0.75, "the speed is reduced nearer to the goal than this", "m", 0.0, 10.0)
    slow_share: float = quantity(0.5, "share of the highest speed there", "", 0.0, 1.0)
    relax_new_plan: bool = quantity(False, "apply one cycle of forces to a new plan before it is used")
    reset_costmap_once: bool = quantity(False, "clear the marks once if a new plan is in collision (a quirk)")
    headings: bool = quantity(False, "true: bubbles have headings, which count in forces (a quirk)", optional=True)
    weighs_x_twice: bool = quantity(False, "take x twice and no y for a force's strength (a quirk)", optional=True)
    capacity: int = quantity(4096, "largest number of bubbles", "", 16, 100_000)

    def __post_init__(self) -> None:
        super().__post_init__()
        slower = f"must be at most max_speed_mps = {self.max_speed_mps:g}"
        self.require(self.min_speed_mps <= self.max_speed_mps, "min_speed_mps", slower)

    def gains(self, circumscribed_m: float) -> BandGains:
        """Return the gains for the kernels and a robot whose padded footprint has this circumscribed radius."""
        named = [getattr(self, name) for name in BandGains._fields[1:]]
        return BandGains(circumscribed_m if self.headings else 0.0, *named)


@dataclass(frozen=True)
class EBandPlannerConfig(NavigationConfig):
    """The navigation loop with E-Band in it."""

    prune_m: float = quantity(0.0, "drop points of the plan before one nearer than this; 0: none", "m", minimum=0.0)
    band: EBandConfig = field(default_factory=EBandConfig)


# The one constant of paper2020 that is not known: the launch files say 0.1 m, with which plans on cells of the map miss
# the robot in worlds where published trials succeeded every time; docs/fidelity.md has the evidence.
_PADDING_M = 0.04


def eband_presets() -> dict[str, EBandPlannerConfig]:
    """Return the presets: the challenge and the paper's trials."""
    challenge = EBandPlannerConfig(recovery=RecoveryConfig(clearing_clears=False))
    tight: dict[str, Any] = {"footprint_padding_m": _PADDING_M, "as_costmap_2d": True, "inflates_by_front": True}
    paper_2020 = replace(
        challenge,
        lidar_x_m=0.12,
        goal_republish_period_s=0.1,
        hold_s=PAPER_HOLD_S,
        local_costmap_in_map=True,
        first_plan_waits=True,
        local_costmap=CostmapConfig(**tight),
        global_costmap=GlobalCostmapConfig(map_resolution=True, **tight),
        global_plan=GlobalPlanConfig(
            half_cell_offset=False, zero_intermediate_yaw=True, as_navfn=True, unfinished_plans=True
        ),
        band=EBandConfig(reset_costmap_once=True, relax_new_plan=True, headings=True, weighs_x_twice=True),
    )
    return {"challenge": challenge, "paper2020": paper_2020}
