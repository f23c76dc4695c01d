"""How a body that `barn_sim.motion.ticks` moves without Bullet comes back to it."""

from numba import njit

from barn_sim.motion.free_motion import Quaternion, Triple, quaternion, still_turning, triple
from barn_sim.motion.state import Record, Records

Placed = tuple[Triple, Quaternion, Triple, Triple]

LEVEL, STILL = (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0)


@njit(cache=True)
def come_back(robots: Records, settings: Records, index: int, level: bool) -> tuple[Placed, Triple, Placed]:
    """Return how to bring a body in Bullet, with all that Bullet stores of it, to where the robot has gone without it.

    level: whether Bullet has left it level and still in the tick before; else where the robot was then. Returns where
    the body starts the last tick, which makes its inertia, the torque in it, and where the body then has to be. Places
    are position, heading, velocity and spin.
    """
    robot: Record = robots[index]
    fixed: Record = settings[0]
    heading, velocity, spin = quaternion(robot.heading), triple(robot.velocity), triple(robot.spin)
    before = quaternion(robot.heading_before)
    _, torque = still_turning(
        quaternion(robot.attitude_before), spin, heading, LEVEL if level else before, triple(fixed.inverse_inertia),
        fixed.tick_s,
    )  # fmt: skip
    start = triple(robot.position_before), before, velocity, spin
    return start, torque, (triple(robot.position), heading, velocity, spin)
