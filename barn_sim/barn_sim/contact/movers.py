"""Walls and moving obstacles: where they are, what the lidar sees of them, and bodies of those near the robot.

A moving obstacle pushes the robot and nothing pushes it. In PyBullet it is a body far heavier than the robot that is
set to its pose and velocity before every tick: unlike a fixed body, it hands its velocity on in a contact. It passes
through everything but the robot.
"""

import math
from functools import partial

import numpy as np
from numba import njit

from barn_sim.body.free_motion import fill
from barn_sim.body.state import Record, Records
from barn_sim.config import SimulatorConfig
from barn_sim.contact.bullet import PhysicsClient, add_body, bullet
from barn_sim.contact.obstacles import PASSED_BY
from barn_worlds.base.arrays import Floats
from barn_worlds.base.types import seconds
from barn_worlds.geometry.bodies import moving_bodies, wall_bodies
from barn_worlds.geometry.kernels import gaps_to_rectangle
from barn_worlds.moving.tracks import MotionTable, evaluate
from barn_worlds.worlds.world import World

_MASS_KG = 1e6
_LEAVE_GAP_M = 0.1  # beyond what makes a body
_ROBOT_GROUP = 1  # of Bullet's collision filter
_LONG_S = 1e6  # beyond any trial
_TICKS_AHEAD = (
    2  # that the hand-over to Bullet looks ahead, so that jumps are seen in time
)


class Movers:
    """Walls and moving obstacles of a world, the walls first in all arrays.

    phase_s: time into the motions at stamp 0. extent: x_min, y_min, x_max, y_max of the robot's shapes in base_link.
    gap_m: how near the robot must be for a body.
    """

    def __init__(
        self,
        client: PhysicsClient,
        extent: Floats,
        world: World,
        phase_s: float,
        config: SimulatorConfig,
        gap_m: float,
    ) -> None:
        self._client, self._extent, self._phase_s, self._tick_ns = (
            client,
            extent,
            phase_s,
            config.tick_ns,
        )
        self._friction = config.obstacles.friction
        self._lift_m_s = (
            config.physics.gravity_m_s2 * config.physics.tick_s
        )  # what a tick of free fall takes away
        walls, tracks = world.walls, world.tracks
        self._walls, self._tracks = len(walls), tracks
        self._shapes = np.concatenate(
            [wall_bodies(walls).shapes(), moving_bodies(tracks, phase_s).shapes()]
        )
        self._velocities = np.zeros((len(self._shapes), 2))
        self._heights = np.concatenate(
            [[wall.height_m for wall in walls], tracks.height_m]
        )
        self._fastest_m_s: Floats = np.concatenate(
            [np.zeros(len(walls)), tracks.fastest_mps]
        )
        self._gap_m, self._wake_m = (
            gap_m,
            gap_m + self._fastest_m_s * config.physics.tick_s,
        )
        half_rad = [
            0.5 * math.atan2(sine, cosine)
            for cosine, sine in self._shapes[:, 5:].tolist()
        ]
        self._attitudes = [
            (0.0, 0.0, math.sin(half), math.cos(half)) for half in half_rad
        ]
        self._bodies: dict[int, int] = {}
        self._kinds: dict[tuple[float, ...], int] = {}

    def at(self, stamp_ns: int) -> Floats:
        """Return the shapes (n, 7) at a time; the array is used again."""
        if len(self._tracks):
            moving, time_s = slice(self._walls, None), seconds(stamp_ns) + self._phase_s
            evaluate(
                time_s,
                self._tracks.table,
                self._shapes[moving, :2],
                self._velocities[moving],
            )
        return self._shapes

    def cross_section(self, stamp_ns: int, height_m: float) -> Floats:
        """Return the shapes (k, 7) in a horizontal plane at a time."""
        shapes = self.at(stamp_ns)
        return (
            shapes
            if (self._heights >= height_m).all()
            else shapes[self._heights >= height_m]
        )

    def look(self, robots: Records, index: int) -> None:
        """Write to a robot's record how far the nearest is now, and for how long that tells how near it may be."""
        reach_m = self._wake_m + self._gap_m
        _look(
            robots, index, self._phase_s, self._tick_ns, self._tracks.table, self._shapes, self._velocities,
            self._walls, reach_m, self._fastest_m_s, self._extent,
        )  # fmt: skip

    def prepare(self, x: float, y: float, yaw: float, stamp_ns: int) -> bool:
        """Set the bodies of those that a robot at this pose could touch in the next tick; tell whether there are any.

        Bodies of those that have gone are removed.
        """
        gaps: Floats = gaps_to_rectangle(self.at(stamp_ns), x, y, yaw, self._extent)
        for index in np.flatnonzero(gaps < self._wake_m).tolist():
            if index not in self._bodies:
                self._bodies[index] = self._make(index)
        for index in [
            index
            for index in self._bodies
            if gaps[index] > self._wake_m[index] + _LEAVE_GAP_M
        ]:
            self._client.send_away(self._bodies.pop(index))
        client = self._client.id
        for index, body in self._bodies.items():
            if index >= self._walls:
                velocity = (*self._velocities[index].tolist(), self._lift_m_s)
                bullet.resetBasePositionAndOrientation(
                    body, self._centre(index), self._attitudes[index], client
                )
                bullet.resetBaseVelocity(body, velocity, (0.0, 0.0, 0.0), client)
        return bool(self._bodies)

    def _centre(self, index: int) -> tuple[float, float, float]:
        x, y = self._shapes[index, :2].tolist()
        return x, y, 0.5 * float(self._heights[index])

    def _make(self, index: int) -> int:
        position, attitude = self._centre(index), self._attitudes[index]
        mass_kg = 0.0 if index < self._walls else _MASS_KG
        friction = {"lateralFriction": self._friction, "angularDamping": 0.0}
        make = partial(
            add_body,
            self._client.id,
            self._kind(index),
            position,
            attitude,
            mass_kg,
            **friction,
        )
        body = self._client.receive(make)
        if mass_kg:
            bullet.setCollisionFilterGroupMask(
                body, -1, PASSED_BY, _ROBOT_GROUP, physicsClientId=self._client.id
            )
        return body

    def _kind(self, index: int) -> int:
        """Return the collision shape of a size, made once."""
        _, _, radius, half_x, half_y, _, _ = self._shapes[index].tolist()
        height = float(self._heights[index])
        size = radius, half_x, half_y, height
        if size not in self._kinds:
            self._kinds[size] = bullet.createCollisionShape(
                bullet.GEOM_CYLINDER if radius else bullet.GEOM_BOX, radius=radius, height=height,
                halfExtents=[half_x, half_y, 0.5 * height], physicsClientId=self._client.id,
            )  # fmt: skip
        return self._kinds[size]


@njit(cache=True)
def _look(
    robots: Records, index: int, phase_s: float, tick_ns: int, table: MotionTable, shapes: Floats, velocities: Floats,
    walls: int, reach_m: Floats, fastest_m_s: Floats, extent: Floats,
) -> None:  # fmt: skip
    """See `Movers.look`; reach_m (n,): how near each may come to the robot without PyBullet; fastest_m_s (n,)."""
    robot: Record = robots[index]
    stamp_ns, nearest, left_s = robot.stamp_ns, math.inf, _LONG_S
    for ahead in range(_TICKS_AHEAD + 1):
        time_s = 1e-9 * (stamp_ns + ahead * tick_ns) + phase_s
        evaluate(time_s, table, shapes[walls:, :2], velocities[walls:])
        gaps = gaps_to_rectangle(shapes, robot.x, robot.y, robot.yaw, extent) - reach_m
        nearest = min(nearest, gaps.min())
    period, phase = table[4], table[5]
    for k in range(len(period)):
        left_s = min(
            left_s, period[k] - (1e-9 * stamp_ns + phase_s + phase[k]) % period[k]
        )
    fill(robot.movers_looked_from, (robot.x, robot.y, robot.yaw))
    robot.movers_looked_ns = stamp_ns
    robot.movers_clearance_m, robot.movers_speed_m_s = nearest, fastest_m_s.max()
    robot.movers_until_ns = (
        stamp_ns + math.floor(1e9 * left_s) - (_TICKS_AHEAD + 1) * tick_ns
    )
