"""Odometry as the robot's extended Kalman filter fuses it."""

import math

from numpy.random import Generator

from barn_sim.body.state import Fleet, Record, Records
from barn_sim.config import OdometryConfig
from barn_worlds.base.arrays import Floats, kernel
from barn_worlds.base.types import Odometry, Pose2D, Velocity2D, nanoseconds, wrap_angle

# As a kernel, to the same bits.
wrap = kernel(wrap_angle)


class FusedOdometry:
    """Speed of the wheels integrated along the yaw of the IMU, from the start pose.

    The filter trusts the IMU's absolute yaw. So the heading has that sensor's noise but
    does not drift, while the position drifts with every slip of the wheels. A biased
    gyro without a compass makes the heading drift, too, in proportion to time. Noise is
    drawn once per update, at the odometry's own rate, whether or not the update is
    read.
    """

    def __init__(
        self,
        config: OdometryConfig,
        rng: Generator,
        start_yaw: float,
        fleet: Fleet,
        index: int,
    ):
        """Reset the odometry of a robot, which needs an `update` before it is read.

        Args:
            config: Rate and errors of the odometry.
            rng: Source of the noise.
            start_yaw: Yaw of the robot's start pose in the map frame, rad.
            fleet: Keeps the state.
            index: Row of the robot in the fleet.
        """
        self._fleet = fleet
        self._index = index
        self._rng = rng
        # The first update whose noise is not drawn yet.
        self._next_number = 0

        settings = fleet.settings
        settings["yaw_noise_rad"] = config.yaw_noise_rad
        settings["yaw_rate_noise_rad_s"] = config.yaw_rate_noise_rad_s
        settings["odometry_ns"] = nanoseconds(1.0 / config.rate_hz)
        fleet.robots[index]["start_yaw"] = start_yaw
        fleet.robots[index]["speed_factor"] = 1.0

    def draw_errors(self, config: OdometryConfig, rng: Generator) -> None:
        """Draw and set the trial's constant errors: gyro bias and wheel radius.

        Args:
            config: Standard deviations of both errors over trials.
            rng: Source of both; not the one of the noise.
        """
        # Both are drawn even if one is off, so that switching one does not change the
        # other.
        gyro, radius = rng.standard_normal(2)
        robot = self._fleet.robots[self._index]
        robot["gyro_bias"] = config.gyro_bias_rad_s * gyro
        robot["speed_factor"] = 1.0 + config.wheel_radius_error * radius

    def update(self, number: int) -> None:
        """Set yaw and yaw rate errors to those of update `number`, drawn if needed.

        Updates come in turn, from number 0.
        """
        self.supply_noise(number, number)
        fleet = self._fleet
        robot = fleet.robots[self._index]
        row = fleet.noise[self._index, number - robot["noise_from"]]
        renew_noise(robot, fleet.settings[0], row)

    def supply_noise(self, first: int, last: int) -> None:
        """Fill the robot's noise from update `first` on, unless `last` is drawn.

        Args:
            first: Number of the first update that is still needed.
            last: Number of the last one; there must be room for all between.
        """
        if last < self._next_number:
            return
        noise = self._fleet.noise[self._index]
        # Rows that were drawn but not used move to the front: each update keeps its
        # noise.
        unused = max(self._next_number - first, 0)
        if unused:
            noise[:unused] = noise[len(noise) - unused :].copy()
        noise[unused:] = self._rng.standard_normal((len(noise) - unused, 2))
        self._fleet.robots[self._index]["noise_from"] = first
        self._next_number = first + len(noise)

    def read(self, stamp_ns: int) -> Odometry:
        """Return the odometry now, in the odom frame, with a time stamp in ns."""
        x, y, yaw, speed, yaw_rate = read_odometry(self._fleet.robots, self._index)
        pose = Pose2D(x, y, yaw).through_quaternion()
        return Odometry(stamp_ns, pose, Velocity2D(speed, yaw_rate))


@kernel
def integrate_wheels(robot: Record, tick_s: float) -> None:
    """Set odometry speed from the wheels; move its x, y a tick along noisy heading.

    Args:
        robot: Record of the robot.
        tick_s: Duration of the tick.
    """
    robot.odometry_speed = 0.5 * (robot.left_m_s + robot.right_m_s) * robot.speed_factor
    # The filter takes the heading of the IMU as it is, noise included.
    heading = robot.yaw - robot.start_yaw + robot.yaw_error
    robot.odometry_x += tick_s * robot.odometry_speed * math.cos(heading)
    robot.odometry_y += tick_s * robot.odometry_speed * math.sin(heading)


@kernel
def renew_noise(robot: Record, settings: Record, row: Floats) -> None:
    """Set errors of yaw and yaw rate in a robot's record: noise plus the gyro's bias.

    Args:
        robot: Record of the robot.
        settings: Record of `barn_sim.body.state.SETTINGS`.
        row: Standard normal numbers (2,), for the yaw and the yaw rate.
    """
    # A constant bias adds up to an angle in proportion to time.
    drift = robot.gyro_bias * 1e-9 * robot.stamp_ns
    robot.yaw_error = settings.yaw_noise_rad * row[0] + drift
    robot.yaw_rate_error = settings.yaw_rate_noise_rad_s * row[1] + robot.gyro_bias


@kernel
def read_odometry(
    robots: Records, index: int
) -> tuple[float, float, float, float, float]:
    """Return x, y, yaw, forward speed and yaw rate of odometry; change nothing.

    Args:
        robots: Records (n,) of robots.
        index: Row of the robot.

    Returns:
        x, y (m), yaw (rad), forward speed (m/s) and yaw rate (rad/s) in the odom frame.
    """
    robot: Record = robots[index]
    yaw = wrap(robot.yaw - robot.start_yaw + robot.yaw_error)
    yaw_rate = robot.spin[2] + robot.yaw_rate_error
    return robot.odometry_x, robot.odometry_y, yaw, robot.odometry_speed, yaw_rate
