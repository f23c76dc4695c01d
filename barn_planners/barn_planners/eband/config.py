"""Settings of the elastic band; its presets are in data/presets/eband.yaml."""

import math
from dataclasses import dataclass

from barn_planners.eband.kernels import BandGains
from barn_planners.navigation.loop import NavigationConfig
from barn_planners.navigation.speeds import SpeedConfig
from barn_worlds.base.config import optional, quantity


@dataclass(frozen=True)
class EBandConfig(SpeedConfig):
    """The band and its control law; the defaults are those of the paper's trials."""

    min_turn_in_place_radps: float = quantity(
        0.0, "lowest yaw rate when turning in place", "rad/s", 0.0, 10.0
    )
    xy_tolerance_m: float = quantity(
        0.1,
        "the final turn starts within 0.6 times this distance of the goal",
        "m",
        0.01,
        5.0,
    )
    yaw_tolerance_rad: float = quantity(
        0.05,
        "angle within which the goal's heading counts as reached",
        "rad",
        0.001,
        math.pi,
    )
    min_overlap: float = quantity(
        0.7,
        "bubbles overlap if their centers are nearer than this share of both radii",
        "",
        0.1,
        1.0,
    )
    tiny_bubble_m: float = quantity(
        0.01, "bubbles up to this radius cannot be inserted", "m", 0.001, 1.0
    )
    cost_weight_per_m: float = quantity(
        10.0, "cost c gives the radius -ln(c / 252) / weight", "1/m", 0.1, 1000.0
    )
    internal_gain: float = quantity(
        1.0, "strength of the contracting force", "", 0.0, 100.0
    )
    external_gain: float = quantity(
        2.0, "strength of the force away from obstacles", "", 0.0, 100.0
    )
    sweeps: int = quantity(
        3, "sweeps of forces per cycle, each forward and backward", "", 0, 100
    )
    halvings: int = quantity(
        4, "how many times a step that overshoots is halved", "", 0, 20
    )
    overshoot: float = quantity(
        0.75, "share of the force that a step may keep when it reverses", minimum=0.0
    )
    significant_force: float = quantity(
        0.15, "weaker forces count as balanced", "", 0.0, 10.0
    )
    bubble_velocity_multiplier_per_m: float = quantity(
        2.0, "share of the top speed per meter of bubble radius", "1/m", minimum=0.0
    )
    rotation_threshold_multiplier: float = quantity(
        1.0,
        "turn in place if the next bubble's bearing exceeds this many times the angle that"
        " the overlap with it spans",
        "",
        0.0,
        10.0,
    )
    k_prop_per_s: float = quantity(
        4.0, "yaw rate per radian of bearing", "1/s", 0.0, 100.0
    )
    slow_distance_m: float = quantity(
        0.75, "reduce the speed within this distance of the goal", "m", 0.0, 10.0
    )
    slow_share: float = quantity(
        0.5, "share of the highest speed within slow_distance_m", "", 0.0, 1.0
    )
    relax_new_plan: bool = quantity(
        False, "apply one cycle of forces to a new plan before it is used"
    )
    reset_costmap_once: bool = quantity(
        False, "clear the marks once if a new plan is in collision (a quirk)"
    )
    headings: bool = optional(
        False, "true: bubbles have headings, which count in forces (a quirk)"
    )
    weighs_x_twice: bool = optional(
        False, "compute a force's strength from x twice, never y (a quirk)"
    )
    capacity: int = quantity(4096, "largest number of bubbles", "", 16, 100_000)

    def gains(self, circumscribed_m: float) -> BandGains:
        """Return the constants of forces for kernels; headings count if configured.

        Args:
            circumscribed_m: Circumscribed radius of the padded footprint, by which the
                original turns an angle into a distance.
        """
        # Both classes name their fields alike.
        fields = [getattr(self, name) for name in BandGains._fields[1:]]
        return BandGains(circumscribed_m if self.headings else 0.0, *fields)


@dataclass(frozen=True)
class EBandPlannerConfig(NavigationConfig):
    """The navigation loop with E-Band in it."""

    prune_m: float = quantity(
        0.0,
        "drop the plan's points before the first within this distance; 0: keep all",
        "m",
        minimum=0.0,
    )
    band: EBandConfig = EBandConfig()
