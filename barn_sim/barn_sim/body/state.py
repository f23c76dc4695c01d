"""The state of robots as records of arrays, which compiled code advances."""

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from barn_worlds.base.arrays import Floats
from barn_worlds.robots.robot import MOST_CASTERS

Records = npt.NDArray[np.void]
# One of them, whose fields numba knows.
Record: TypeAlias = Any

_NUMBER = np.float64
_WHOLE = np.int64
_FLAG = np.bool_

# Commands that there is room for at first.
_PENDING = 8
# Updates of the odometry whose noise is drawn at once.
_UPDATES = 128
_NEVER_NS = 2**62
# Contacts with the ground that there is room for: four wheels, or two and casters.
_CONTACTS = max(4, 2 + MOST_CASTERS)


def record_type(fields: Sequence[Any]) -> np.dtype[Any]:
    """Return an aligned NumPy record type of fields (name, type[, shape])."""
    return np.dtype((np.record, np.dtype(list(fields), align=True)))


# A wheel, or a caster, which has no friction.
WHEEL = record_type(
    [
        # Relative to the center of mass, in the body frame, m.
        ("hub", _NUMBER, 3),
        # Friction of the last tick, N s.
        ("impulse_x", _NUMBER),
        ("impulse_y", _NUMBER),
        # The contact in the present tick: from the center of mass, m; load, N; largest
        # friction, N s.
        ("arm_x", _NUMBER),
        ("arm_y", _NUMBER),
        ("arm_z", _NUMBER),
        ("load", _NUMBER),
        ("limit", _NUMBER),
        # Of the friction solver: change of the spin about x, y and z per impulse along
        # x and along y in turn; step, kg; what a step keeps of an impulse, 1 unless the
        # tire slips.
        ("levers", _NUMBER, 6),
        ("step", _NUMBER),
        ("keep", _NUMBER),
    ]
)

# The changing state of a robot. Units are m, rad and s. The body's frame is the
# world's, its point the center of mass.
ROBOT = record_type(
    [
        ("stamp_ns", _WHOLE),
        # The rigid body.
        ("position", _NUMBER, 3),
        ("velocity", _NUMBER, 3),
        ("spin", _NUMBER, 3),
        ("attitude", _NUMBER, 4),
        # Pose of base_link.
        ("x", _NUMBER),
        ("y", _NUMBER),
        ("yaw", _NUMBER),
        # Wheels, left and right in turn, then casters.
        ("wheels", WHEEL, _CONTACTS),
        # Whether PyBullet moves the body, since an obstacle is near.
        ("in_contact", _FLAG),
        # Cylinders: radius; distance of an axis from the robot's outline at which a
        # contact begins; pose at which the distance was last computed, and how far the
        # robot may go from there.
        ("radius_m", _NUMBER),
        ("near_m", _NUMBER),
        ("looked_from", _NUMBER, 3),
        ("clearance_m", _NUMBER),
        # Walls and moving obstacles: the same, where the clearance is infinite without
        # any; speed of the fastest; time of the look, and when one of them may jump.
        ("movers_looked_from", _NUMBER, 3),
        ("movers_clearance_m", _NUMBER),
        ("movers_speed_m_s", _NUMBER),
        ("movers_looked_ns", _WHOLE),
        ("movers_until_ns", _WHOLE),
        # Drive: number of commands on their way, the command in effect, speeds of the
        # controller, rim speeds and angles of the wheels.
        ("pending", _WHOLE),
        ("target_since_ns", _WHOLE),
        ("timed_out", _FLAG),
        ("target_speed", _NUMBER),
        ("target_turn", _NUMBER),
        ("speed", _NUMBER),
        ("turn", _NUMBER),
        ("left_m_s", _NUMBER),
        ("right_m_s", _NUMBER),
        ("left_rad", _NUMBER),
        ("right_rad", _NUMBER),
        # Odometry: pose and errors. `speed_factor` is the factor by which the wheels'
        # speed is misread, `noise_from` the update that the first row of noise is for.
        ("start_yaw", _NUMBER),
        ("yaw_error", _NUMBER),
        ("yaw_rate_error", _NUMBER),
        ("odometry_x", _NUMBER),
        ("odometry_y", _NUMBER),
        ("odometry_speed", _NUMBER),
        ("gyro_bias", _NUMBER),
        ("speed_factor", _NUMBER),
        ("noise_from", _WHOLE),
    ]
)

# What does not change, and is equal for all robots of a fleet.
SETTINGS = record_type(
    [
        ("tick_s", _NUMBER),
        ("tick_ns", _WHOLE),
        # The rigid body: moments of inertia and their inverses, kg m2; position of the
        # center of mass in base_link.
        ("gravity_m_s2", _NUMBER),
        ("inverse_mass", _NUMBER),
        ("inertia", _NUMBER, 3),
        ("inverse_inertia", _NUMBER, 3),
        ("center", _NUMBER, 3),
        # Tires: friction coefficient, slip at which all of it acts, spring (N/m) and
        # damper (N s/m) of each; contacts with the ground, and how many of them have
        # friction.
        ("friction", _NUMBER),
        ("slip_mps", _NUMBER),
        ("stiffness", _NUMBER),
        ("damping", _NUMBER),
        ("wheel_radius_m", _NUMBER),
        ("contacts", _WHOLE),
        ("grips", _WHOLE),
        # x_min, y_min, x_max, y_max of the shapes in base_link, and the distance from
        # there to the farthest corner.
        ("extent", _NUMBER, 4),
        ("reach_m", _NUMBER),
        # Drive. Steps are the largest changes in a tick; `lag_share` is the share of a
        # missing speed that a wheel gains in a tick.
        ("timeout_ns", _WHOLE),
        ("half_separation_m", _NUMBER),
        ("max_speed", _NUMBER),
        ("max_reverse", _NUMBER),
        ("max_turn", _NUMBER),
        ("turn_deadband", _NUMBER),
        ("speed_step", _NUMBER),
        ("turn_step", _NUMBER),
        ("lag_share", _NUMBER),
        # Odometry: time between updates and standard deviations.
        ("odometry_ns", _WHOLE),
        ("yaw_noise_rad", _NUMBER),
        ("yaw_rate_noise_rad_s", _NUMBER),
    ]
)


class Fleet(NamedTuple):
    """Robots with equal settings, which kernels take as a whole."""

    robots: Records
    """Records (n,) of `ROBOT`."""

    pending: Floats
    """Commands on their way (n, capacity, 3), the next one first: arrival in ns, speed
    in m/s, yaw rate in rad/s."""

    settings: Records
    """One record (1,) of `SETTINGS`."""

    noise: Floats
    """Standard normal numbers (n, k, 2) for the yaw and the yaw rate of the odometry's
    next k updates."""

    @classmethod
    def of(cls, count: int, capacity: int = _PENDING) -> "Fleet":
        """Return a fleet whose records are all zero, for simulators to fill in.

        Args:
            count: Number of robots.
            capacity: Number of commands that may be on their way to a robot.
        """
        settings = np.zeros(1, SETTINGS)
        settings["odometry_ns"] = _NEVER_NS
        return cls(
            robots=np.zeros(count, ROBOT),
            pending=np.zeros((count, capacity, 3)),
            settings=settings,
            noise=np.zeros((count, _UPDATES, 2)),
        )

    def is_full(self, index: int) -> bool:
        """Tell whether the queue of a robot has no room for another command."""
        return bool(self.robots["pending"][index] == self.pending.shape[1])

    def with_more_room(self) -> "Fleet":
        """Return a fleet with twice the room for commands; other arrays are shared."""
        room = np.zeros_like(self.pending)
        return self._replace(pending=np.concatenate([self.pending, room], axis=1))
