"""Configuration of the drive, lidar and odometry of a robot.

Defaults without another source are those of a Clearpath Jackal J100 with a Hokuyo
UST-10LX, from the configuration of its drivers and models.
"""

import math
from dataclasses import dataclass

from barn_worlds.base.config import Checked, optional, quantity


@dataclass(frozen=True)
class DriveConfig(Checked):
    """The controller from commands to wheels; on a Jackal, diff_drive_controller."""

    max_speed_m_s: float = quantity(2.0, "largest forward speed", "m/s", 0.0, 10.0)
    max_acceleration_m_s2: float = quantity(
        20.0, "largest acceleration", "m/s2", 0.01, 1000.0
    )
    max_yaw_rate_rad_s: float = quantity(4.0, "largest yaw rate", "rad/s", 0.0, 20.0)
    max_yaw_acceleration_rad_s2: float = quantity(
        25.0, "largest yaw acceleration", "rad/s2", 0.01, 1000.0
    )
    wheel_separation_multiplier: float = quantity(
        1.5, "factor on the track width for wheels that skid", "", 0.1, 10.0
    )
    command_timeout_s: float = quantity(
        0.5, "age at which a command expires (ROS 1 Jackal: 0.25)", "s", 0.01, 60.0
    )
    command_latency_s: float = quantity(
        0.08, "time until a command takes effect (assumed)", "s", 0.0, 1.0
    )
    motor_lag_s: float = optional(
        0.0, "time constant of the wheels' lag behind the controller", "s", 0.0, 10.0
    )
    max_reverse_m_s: float = optional(
        10.0, "largest reverse speed, if below max_speed_m_s", "m/s", 0.0, 10.0
    )
    turn_deadband_rad_s: float = optional(
        0.0,
        "yaw rate lost in every turn; a smaller command does not turn the robot",
        "rad/s",
        0.0,
        10.0,
    )


@dataclass(frozen=True)
class LidarConfig(Checked):
    """A planar laser scanner.

    It takes all beams of a scan at one instant, unless it sweeps.
    """

    beams: int = quantity(720, "number of beams", "", 1, 20000)
    # 270 degrees, as in the driver of the UST-10LX.
    angle_min_rad: float = quantity(
        -2.35619, "direction of the first beam", "rad", -math.pi, math.pi
    )
    angle_max_rad: float = quantity(
        2.35619, "direction of the last beam", "rad", -math.pi, math.pi
    )
    range_min_m: float = quantity(0.1, "shorter ranges read -inf", "m", 0.0, 10.0)
    range_max_m: float = quantity(30.0, "longer ranges read +inf", "m", 0.1, 1000.0)
    rate_hz: float = quantity(50.0, "scans per second", "Hz", 0.1, 200.0)
    noise_m: float = quantity(0.001, "standard deviation of a range", "m", 0.0, 1.0)
    mount_x_m: float = quantity(0.055, "distance ahead of base_link", "m", -10.0, 10.0)
    mount_z_m: float = quantity(0.241, "height above base_link", "m", -1.0, 10.0)
    mount_y_m: float = optional(0.0, "distance left of base_link", "m", -10.0, 10.0)
    mount_yaw_rad: float = optional(
        0.0, "angle from base_link's x to angle 0 of a scan", "rad", -3.15, 3.15
    )
    noise_share: float = optional(
        0.0, "standard deviation as a share of the range, if larger", "", 0.0, 0.5
    )
    sweeps: bool = optional(
        False, "whether beams are taken in turn while the mirror rotates"
    )
    mixed_share: float = optional(
        0.0,
        "share of beams at edges that read a mix of near and far (mixed pixels)",
        "",
        0.0,
        1.0,
    )
    dropout_share: float = optional(
        0.0, "share of the beams that read +inf at random", "", 0.0, 1.0
    )
    masked_from_rad: float = optional(
        0.0,
        "start of a masked sector, where beams read +inf; no sector if it ends here",
        "rad",
        -math.pi,
        math.pi,
    )
    masked_to_rad: float = optional(
        0.0, "end of the masked sector", "rad", -math.pi, math.pi
    )
    blackout_share: float = optional(
        0.0, "share of the scans, in bursts, that read +inf everywhere", "", 0.0, 0.9
    )
    blackout_s: float = optional(
        0.5,
        "mean duration of a blackout, which lasts at least one scan",
        "s",
        0.0,
        60.0,
    )
    unseen_share: float = optional(
        0.0,
        "share of the cylinders, drawn for each trial, that are invisible, like glass",
        "",
        0.0,
        1.0,
    )

    def check_rules(self) -> None:
        """Raise ConfigError unless angle, range and mask end above their beginnings."""
        self.require_order("angle_max_rad", "above", "angle_min_rad")
        self.require_order("range_max_m", "above", "range_min_m")
        self.require_order("masked_to_rad", "at least", "masked_from_rad")


@dataclass(frozen=True)
class OdometryConfig(Checked):
    """Odometry as an EKF fuses it.

    The speed comes from the wheels, absolute yaw and yaw rate from the IMU.
    """

    rate_hz: float = quantity(50.0, "updates per second", "Hz", 1.0, 1000.0)
    yaw_noise_rad: float = quantity(
        0.005, "standard deviation of the yaw", "rad", 0.0, 1.0
    )
    yaw_rate_noise_rad_s: float = quantity(
        0.005, "standard deviation of the yaw rate", "rad/s", 0.0, 1.0
    )
    gyro_bias_rad_s: float = optional(
        0.0, "standard deviation of the gyro's bias over trials", "rad/s", 0.0, 1.0
    )
    wheel_radius_error: float = optional(
        0.0,
        "relative standard deviation of the wheels' radius over trials",
        "",
        0.0,
        0.5,
    )
