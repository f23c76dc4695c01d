"""What is read of the state of robots in compiled code: poses and speeds."""

import math

from numba import njit

from barn_sim.body.tyres import offset_of_centre
from barn_sim.motion.free_motion import fill, quaternion, triple
from barn_sim.motion.state import Record, Records
from barn_sim.sensors.odometry import read_odometry, wrap
from barn_worlds.base.arrays import Floats, Integers


@njit(cache=True)
def read_all(
    robots: Records, indices: Integers, stamps_ns: Integers, truths: Floats, odometry: Floats, velocities: Floats
) -> None:
    """Fill the rows `indices` of stamps (n,), true and measured poses (n, 3) and measured velocities (n, 2)."""
    for index in indices:
        robot: Record = robots[index]
        x, y, yaw, speed, turn = read_odometry(robots, index)
        stamps_ns[index] = robot.stamp_ns
        fill(truths[index], (robot.x, robot.y, through_quaternion(robot.yaw)))
        fill(odometry[index], (x, y, through_quaternion(yaw)))
        velocities[index, 0], velocities[index, 1] = speed, turn


@njit(cache=True)
def through_quaternion(yaw: float) -> float:
    """Return a yaw as it comes out of a message, as `Pose2D.through_quaternion` does."""
    return wrap(2.0 * math.atan2(math.sin(0.5 * yaw), math.cos(0.5 * yaw)))


@njit(cache=True)
def motion(robots: Records, settings: Records, index: int) -> tuple[float, float, float, float, float]:
    """Return x, y, yaw, forward speed and yaw rate of base_link."""
    robot: Record = robots[index]
    x, y, z = offset_of_centre(triple(settings[0].centre), quaternion(robot.attitude))
    velocity, spin = robot.velocity, robot.spin
    vx = velocity[0] - (spin[1] * z - spin[2] * y)
    vy = velocity[1] - (spin[2] * x - spin[0] * z)
    return robot.x, robot.y, robot.yaw, vx * math.cos(robot.yaw) + vy * math.sin(robot.yaw), spin[2]
