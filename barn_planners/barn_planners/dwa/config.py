"""Settings of the dynamic window approach; its presets are in data/presets/dwa.yaml."""

from dataclasses import dataclass

from barn_planners.navigation.loop import NavigationConfig
from barn_planners.navigation.speeds import SpeedConfig
from barn_worlds.base.config import optional, quantity


@dataclass(frozen=True)
class DwaConfig(SpeedConfig):
    """The dynamic window approach; the defaults are the Jackal's."""

    max_speed_mps: float = quantity(0.5, "fastest forward speed", "m/s", 0.01, 10.0)
    min_speed_mps: float = quantity(
        0.1, "slowest forward speed that is sampled", "m/s", 0.0, 10.0
    )
    max_turn_radps: float = quantity(
        1.57, "highest yaw rate sampled", "rad/s", 0.01, 20.0
    )
    min_turn_in_place_radps: float = quantity(
        0.314, "slowest turn in place", "rad/s", 0.0, 20.0
    )
    max_goal_turn_radps: float = quantity(
        1.0, "fastest turn in place at the goal", "rad/s", 0.01, 20.0
    )
    acceleration_mps2: float = quantity(
        10.0, "assumed acceleration", "m/s2", 0.01, 1000.0
    )
    turn_acceleration_radps2: float = quantity(
        20.0, "assumed yaw acceleration", "rad/s2", 0.01, 1000.0
    )
    window_period_s: float = quantity(
        0.05, "time over which the dynamic window opens", "s", 0.005, 1.0
    )
    sim_time_s: float = quantity(2.0, "duration of a rollout", "s", 0.1, 10.0)
    granularity_m: float = quantity(
        0.02, "distance between poses of a rollout", "m", 0.001, 1.0
    )
    turn_granularity_rad: float = quantity(
        0.02, "turn between poses of a rollout", "rad", 0.001, 1.0
    )
    speed_samples: int = quantity(6, "number of sampled forward speeds", "", 2, 200)
    turn_samples: int = quantity(
        20, "number of sampled yaw rates for each speed, and in place", "", 3, 200
    )
    sample_highest_turn: bool = quantity(
        True, "false: the sample straight ahead replaces the sharpest turn (a quirk)"
    )
    path_weight: float = quantity(
        0.75, "weight of the distance from the plan", "", 0.0, 1000.0
    )
    goal_weight: float = quantity(
        1.0, "weight of the distance from the end of the plan", "", 0.0, 1000.0
    )
    obstacle_weight: float = quantity(
        0.1, "weight of the highest cost under the footprint's edges", "", 0.0, 1000.0
    )
    distances_in_metres: bool = quantity(
        False, "true: distances in meters; false: in cells (the original does both)"
    )
    heading_lookahead_m: float = quantity(
        0.325,
        "distance ahead at which a turn in place is compared with the goal",
        "m",
        0.0,
        5.0,
    )
    oscillation_reset_m: float = quantity(
        0.05, "distance after which a turn in place may change direction", "m", 0.0, 5.0
    )
    turn_past_blocked: bool = optional(
        False,
        "true: a turn in place may win even if no path continues from it (a quirk)",
    )
    skip_slow_turns: bool = optional(
        False, "true: no turns in place slower than one sampling step (a quirk)"
    )
    robot_blocks_goal: bool = optional(
        False, "true: the robot's own cells block the goal (a quirk)"
    )
    single_precision: bool = optional(
        False, "true: samples are summed up in single precision (a quirk)"
    )
    escape_speed_mps: float = quantity(
        -0.5,
        "speed of an escape, used if no other motion is allowed; limited by max_speed_mps",
        "m/s",
        -10.0,
        0.0,
    )
    escape_through: bool = quantity(
        False, "escape even into an obstacle (a quirk of the original)"
    )
    escape_reset_m: float = quantity(
        0.1, "an escape ends after this distance", "m", 0.0, 5.0
    )
    escape_reset_rad: float = quantity(
        0.1, "an escape also ends after this turn", "rad", 0.0, 3.2
    )
    xy_tolerance_m: float = quantity(
        0.25,
        "distance within which the goal's position counts as reached",
        "m",
        minimum=0.01,
    )
    yaw_tolerance_rad: float = quantity(
        0.157,
        "angle within which the goal's heading counts as reached",
        "rad",
        minimum=0.001,
    )
    roll_out_goal_turn: bool = optional(
        False, "true: rollouts include braking and turning at the goal"
    )
    stopped_mps: float = quantity(
        0.05, "a lower speed counts as stopped", "m/s", 0.0001, 1.0
    )
    stopped_radps: float = quantity(
        0.05, "a lower yaw rate counts as stopped", "rad/s", minimum=0.0001
    )


@dataclass(frozen=True)
class DwaPlannerConfig(NavigationConfig):
    """The navigation loop with the dynamic window approach in it."""

    dwa: DwaConfig = DwaConfig()
