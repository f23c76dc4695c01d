"""The state of robots as records of arrays, which compiled code advances without Python in between."""

import math
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from barn_sim.body.model import RobotModel
from barn_sim.config import DriveConfig, PhysicsConfig
from barn_worlds.base.arrays import Floats
from barn_worlds.base.types import nanoseconds
from barn_worlds.robots.robot import MOST_CASTERS

Records = npt.NDArray[np.void]
Record: TypeAlias = Any  # one of them, the fields of which numba knows

_NUMBER, _WHOLE, _YES = np.float64, np.int64, np.bool_
_PENDING = 8  # commands that there is room for at first
_NEVER_NS = 2**62
_UPDATES = 128  # of the odometry whose noise is drawn at once
_CONTACTS = max(4, 2 + MOST_CASTERS)  # with the ground that there is room for


def _fields(
    names: str, kind: type = _NUMBER, size: int | tuple[int, int] | None = None
) -> list[Any]:
    return [
        (name, kind) if size is None else (name, kind, size) for name in names.split()
    ]


# All of a robot that changes. Metres, radians, seconds; the body's frame is the world's, its point the centre of mass.
ROBOT = np.dtype(
    [
        *_fields("stamp_ns", _WHOLE),
        # body, see barn_sim.body.free_motion: attitude is the quaternion of the matrix of heading
        *_fields("position velocity spin", size=3),
        *_fields("heading attitude", size=4),
        *_fields("x y yaw"),  # of base_link
        *_fields(
            "wheels", size=(_CONTACTS, 17)
        ),  # see barn_sim.body.tires.stand; the first `contacts` of them
        # where Bullet has the body: it lags while the body is integrated without it
        *_fields(
            "in_bullet known", _YES
        ),  # has Bullet to move it in the next tick; is heading what Bullet has
        *_fields("away", _WHOLE),  # ticks since Bullet moved it
        *_fields("position_before", size=3),  # a tick ago
        *_fields("attitude_before heading_before", size=4),
        # obstacles: radius of cylinders; distance from the robot's outline to the axis of one that becomes a body of
        # Bullet; pose at which their distance was last computed, and how far the robot may go from there
        *_fields("radius_m near_m clearance_m"),
        *_fields("looked_from", size=3),
        # walls and moving obstacles, likewise (barn_sim.contact.movers): how far robot and movers may come together,
        # infinite without any; speed of the fastest; when that no longer holds, since one of them jumps
        *_fields("movers_looked_from", size=3),
        *_fields("movers_clearance_m movers_speed_m_s"),
        *_fields("movers_looked_ns movers_until_ns", _WHOLE),
        # drive; pending: commands on their way
        *_fields("pending target_since_ns", _WHOLE),
        *_fields("timed_out", _YES),
        *_fields(
            "target_speed target_turn speed turn left_m_s right_m_s left_rad right_rad"
        ),
        # odometry; gyro_bias: rad/s; speed_factor: by which the wheels' speed is misread
        *_fields(
            "start_yaw yaw_error yaw_rate_error odometry_x odometry_y odometry_speed gyro_bias speed_factor"
        ),
        *_fields("noise_from", _WHOLE),  # update that the first row of its noise is for
    ],
    align=True,
)

# All of a robot that does not change.
SETTINGS = np.dtype(
    [
        *_fields("tick_s inverse_mass weight"),
        *_fields("tick_ns odometry_ns timeout_ns", _WHOLE),
        *_fields(
            "inverse_inertia first_inverse_inertia centre", size=3
        ),  # the second in the first tick
        # tyres: friction coefficient, spring (N/m) and damper (N s/m) of each, radius of the wheels
        *_fields("friction stiffness damping wheel_radius_m"),
        *_fields(
            "contacts grips", _WHOLE
        ),  # with the ground: wheels, then casters; those of them with friction
        # turn of a wheel in a tick per m/s; lag_share: of what a wheel lacks of its speed, that it gains in a tick
        *_fields(
            "per_metre half_separation_m max_speed max_reverse max_turn speed_step turn_step lag_share"
        ),
        *_fields("lags", _YES),  # whether the motors do
        *_fields("yaw_noise_rad yaw_rate_noise_rad_s"),
        *_fields(
            "extent", size=4
        ),  # of the robot's shapes in base_link: x_min, y_min, x_max, y_max
        *_fields("reach_m"),  # from base_link to the farthest corner of that
    ],
    align=True,
)


@dataclass(frozen=True, eq=False)
class Fleet:
    """Robots with equal settings: `robots` (n,) of ROBOT, `settings` (1,) of SETTINGS.

    pending (n, capacity, 3): commands on their way, the next one first: arrival in ns, speed, yaw rate. noise
    (n, k, 2): standard normal, for the yaw and the yaw rate of an update of the odometry each.
    """

    robots: Records
    pending: Floats
    settings: Records
    noise: Floats

    @classmethod
    def of(cls, count: int, capacity: int = _PENDING) -> "Fleet":
        """Return a fleet of robots of which nothing is known yet."""
        settings = np.zeros(1, SETTINGS)
        settings["odometry_ns"] = _NEVER_NS
        noise = np.zeros((count, _UPDATES, 2))
        return cls(
            np.zeros(count, ROBOT), np.zeros((count, capacity, 3)), settings, noise
        )

    def with_room(self) -> "Fleet":
        """Return the same fleet with room for twice as many commands."""
        return replace(
            self,
            pending=np.concatenate([self.pending, np.zeros_like(self.pending)], axis=1),
        )


def set_drive(
    settings: Records, config: DriveConfig, track_m: float, tick_s: float
) -> None:
    """Fill in what the drive needs."""
    settings["half_separation_m"] = 0.5 * track_m * config.wheel_separation_multiplier
    settings["timeout_ns"] = nanoseconds(config.command_timeout_s)
    settings["max_speed"], settings["max_turn"] = (
        config.max_speed_m_s,
        config.max_yaw_rate_rad_s,
    )
    settings["max_reverse"] = min(config.max_reverse_m_s, config.max_speed_m_s)
    settings["lags"] = config.motor_lag_s > 0.0
    settings["lag_share"] = (
        -math.expm1(-tick_s / config.motor_lag_s) if config.motor_lag_s else 1.0
    )
    settings["speed_step"] = config.max_acceleration_m_s2 * tick_s
    settings["turn_step"] = config.max_yaw_acceleration_rad_s2 * tick_s


def set_body(
    settings: Records,
    model: RobotModel,
    config: PhysicsConfig,
    stiffness: float,
    damping: float,
) -> None:
    """Fill in what the body needs; stiffness (N/m), damping (N s/m): of a tyre."""
    settings["tick_s"], settings["tick_ns"] = config.tick_s, nanoseconds(config.tick_s)
    settings["friction"], settings["wheel_radius_m"] = (
        config.wheel_friction,
        model.wheel_radius_m,
    )
    settings["stiffness"], settings["damping"], settings["centre"] = (
        stiffness,
        damping,
        model.center_of_mass,
    )
    settings["grips"], settings["contacts"] = (
        len(model.wheels),
        len(model.wheels) + len(model.casters),
    )
    settings["inverse_mass"], settings["inverse_inertia"] = (
        1.0 / model.mass_kg,
        1.0 / model.inertia,
    )
    settings["weight"] = model.mass_kg * config.gravity_m_s2
    settings["per_metre"] = config.tick_s / model.wheel_radius_m
    settings["extent"], settings["reach_m"] = model.extent, model.reach_m
