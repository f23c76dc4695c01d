"""The cylinders of a world. Only those near the robot are bodies of the physics client.

A cylinder is a row of an array and costs nothing while the robot is more than a few centimetres away. It becomes a body
when the robot, or another cylinder that is being pushed, comes near. Once it is at rest and the robot has gone, the
body is removed and the cylinder stays where it is.
"""

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from barn_sim.body.model import RobotModel
from barn_sim.config import ObstacleConfig, SimulatorConfig
from barn_sim.contact.bullet import PhysicsClient, add_body, bullet
from barn_sim.contact.cylinders import follow_cylinders, near_cylinders, see_cylinders
from barn_worlds.base.arrays import Bools, Floats, Integers
from barn_worlds.base.types import Pose2D
from barn_worlds.worlds.world import World

_LEAST_GAP_M = 0.03  # more than the Jackal covers in a tick
_FASTER = 1.1  # than it may drive, as a robot that slides or is pushed may be
# Groups of Bullet's collision filter: of moving obstacles, and of cylinders that can be pushed where there are such.
PASSED_BY, _PUSHED = 64, 32
TOUCH_GAP_M = 0.005  # a pushed cylinder this close pushes the next one
REST_GAP_M = 0.10
REST_TICKS = 50  # a cylinder stays a body for this long after anything that moves was last near it
MOVED_M = 1e-3
_SWEEP_TICKS = 10
_LIMITS = (1e-2, 1e-1, TOUCH_GAP_M, MOVED_M)  # m/s, rad/s, m, m: see `follow_cylinders`
_NONE_TILTED = np.empty((0, 7))
_UPRIGHT = math.cos(math.radians(0.5))
_ANGULAR_DAMPING = 0.6  # share of the spin lost per second, so that struck cylinders stop rocking and rolling


@dataclass(frozen=True, eq=False)
class Moved:
    """Displaced cylinders: indices (n,), positions (n, 3) m, quaternions (n, 4) x y z w."""

    indices: Integers
    positions: Floats
    quaternions: Floats


def tick_gap_m(config: SimulatorConfig) -> float:
    """Return more than any point of the robot covers in a tick.

    A cylinder becomes a body when it is this near. The hand-over to Bullet begins at least a tick before: in the very
    tick that makes a body, it matters to Bullet that the robot's was moved.
    """
    reach_m = max(math.hypot(x, y) for x, y in config.chassis.hull_m)
    fastest_m_s = config.drive.max_speed_m_s + config.drive.max_yaw_rate_rad_s * reach_m
    return max(_LEAST_GAP_M, _FASTER * fastest_m_s * config.physics.tick_s)


class Obstacles:
    """All cylinders of a world, and the bodies of those that are near the robot.

    segments (n, 4): ends of the cylinders' axes seen from above, m. undisturbed: whether every cylinder stands exactly
    where it stood. gap_m: how near the robot must be for a body. bodied (n,): which cylinders are bodies. radius_m: of
    every cylinder.
    """

    def __init__(
        self,
        client: PhysicsClient,
        model: RobotModel,
        world: World,
        config: ObstacleConfig,
        gap_m: float,
    ) -> None:
        self._client, self._extent, self._reach_m, self._config = (
            client,
            model.extent,
            model.reach_m,
            config,
        )
        self.gap_m, self._rest_gap_m = gap_m, max(REST_GAP_M, 2.0 * gap_m)
        self._passed = bool(world.moving)  # whether moving obstacles pass through
        self._centres, self.radius_m = world.cylinders_m, world.cylinder_radius_m
        self._half = 0.5 * world.cylinder_height_m
        count = len(self._centres)
        self._movable: Bools = np.full(count, config.movable)
        self._movable[len(world.obstacles_m) :] &= config.containment_movable
        self._states = np.zeros((count, 7))  # position and quaternion
        self._states[:, :2], self._states[:, 2], self._states[:, 6] = (
            self._centres,
            self._half,
            1.0,
        )
        self.segments = np.concatenate([self._centres, self._centres], axis=1)
        self._bodies: dict[int, int] = {}
        self.bodied, self._pushed, self._displaced = np.zeros((3, count), np.bool_)
        self.undisturbed = True
        self._ticks = 0
        # where the robot was when bodies were made last, and how far it may go from there until others are near
        self._looked_from, self._free_m = (0.0, 0.0, 0.0), 0.0
        self._needed = np.zeros(
            count, np.int64
        )  # tick at which a body was last near anything that moves

    def prepare(self, x: float, y: float, yaw: float) -> None:
        """Make bodies of the cylinders that could be touched in the next tick by a robot at this pose."""
        last_x, last_y, last_yaw = self._looked_from
        if (
            math.hypot(x - last_x, y - last_y) + abs(yaw - last_yaw) * self._reach_m
            < self._free_m
        ):
            return
        self._looked_from = x, y, yaw
        near, self._free_m = self._near(~self.bodied, x, y, yaw, self.gap_m)
        for index in near:
            self._bodies[index] = self._make(index)
            self.bodied[index] = True
            self._needed[index] = self._ticks

    def _near(
        self, among: Bools, x: float, y: float, yaw: float, robot_within_m: float
    ) -> tuple[list[int], float]:
        found, free_m = near_cylinders(
            self.segments,
            among,
            self._pushed,
            x,
            y,
            yaw,
            self._extent,
            self.radius_m,
            robot_within_m,
            TOUCH_GAP_M,
        )
        return found.tolist(), free_m

    def _make(self, index: int) -> int:
        client, config, state = self._client, self._config, self._states[index].tolist()
        if not self._movable[index]:
            kind = self.radius_m, 2.0 * self._half, config.friction
            return client.receive_standing(
                kind, state[:3], partial(self._add, state, 0.0)
            )
        tilt, spin = config.inertia_tilt_kg_m2, config.inertia_spin_kg_m2
        body = client.receive(
            partial(
                self._add,
                state,
                config.mass_kg,
                localInertiaDiagonal=[tilt, tilt, spin],
            )
        )
        if self._passed:
            bullet.setCollisionFilterGroupMask(
                body, -1, _PUSHED, ~PASSED_BY, physicsClientId=client.id
            )
        return body

    def _add(self, state: list[float], mass_kg: float, **dynamics: object) -> int:
        client, size = self._client, (self.radius_m, 2.0 * self._half)
        shapes = client.engine.shapes
        if size not in shapes:
            shapes[size] = bullet.createCollisionShape(
                bullet.GEOM_CYLINDER,
                radius=size[0],
                height=size[1],
                physicsClientId=client.id,
            )
        dynamics |= {
            "lateralFriction": self._config.friction,
            "angularDamping": _ANGULAR_DAMPING,
        }
        return add_body(
            client.id, shapes[size], state[:3], state[3:], mass_kg, **dynamics
        )

    @property
    def awake(self) -> bool:
        """Whether any cylinder is a body now."""
        return bool(self._bodies)

    def follow(self, robot: Pose2D) -> None:
        """Copy the bodies' states after a tick, and remove the bodies that nothing is near any more."""
        indices = (
            [index for index in self._bodies if self._movable[index]]
            if self._config.movable
            else []
        )
        if indices:
            self.undisturbed, self._free_m = False, 0.0
            bodies, client = [self._bodies[index] for index in indices], self._client.id
            places = [
                bullet.getBasePositionAndOrientation(body, client) for body in bodies
            ]
            motions = [bullet.getBaseVelocity(body, client) for body in bodies]
            states = np.array(
                [
                    np.concatenate([*at, *moves])
                    for at, moves in zip(places, motions, strict=True)
                ]
            )
            follow_cylinders(
                np.array(indices), states, robot.x, robot.y, robot.yaw, self._extent, self._centres,
                self.radius_m, self._half, _LIMITS, self._states, self.segments, self._pushed, self._displaced,
            )  # fmt: skip
        self._ticks += 1
        if self._ticks % _SWEEP_TICKS:
            return
        needed, _ = self._near(
            self.bodied, robot.x, robot.y, robot.yaw, self._rest_gap_m
        )
        self._needed[needed] = self._ticks
        for index in [
            index
            for index in self._bodies
            if self._ticks - self._needed[index] > REST_TICKS
        ]:
            self._client.send_away(self._bodies.pop(index))
            self.bodied[index] = self._pushed[index] = False
            self._free_m = 0.0

    def touched_by(self, robot: int) -> bool:
        """Tell whether the robot's body touches any cylinder."""
        contacts = bullet.getContactPoints(bodyA=robot, physicsClientId=self._client.id)
        return any(
            contact[8] <= 0.0 or contact[9] > 0.0 for contact in contacts
        )  # distance, normal force

    def moved(self) -> Moved:
        """Return the cylinders with an end displaced by more than a millimetre."""
        indices = np.flatnonzero(self._displaced)
        return Moved(indices, self._states[indices, :3], self._states[indices, 3:])

    def cross_section(self, height_m: float) -> tuple[Floats, Floats]:
        """Return the cylinders in a horizontal scan plane, as `Lidar.scan` takes them.

        Centres (n, 2) of upright cylinders (at most half a degree from the vertical) in the plane, infinite for
        the others; and the others (m, 7): centre x, y and height above the plane, unit vector of the axis, half length.
        """
        displaced = np.flatnonzero(self._displaced)
        if not len(displaced):
            return self._centres, _NONE_TILTED
        centres, tilted = self._centres.copy(), np.empty((len(displaced), 7))
        count = see_cylinders(
            displaced, self._states, self._half, height_m, _UPRIGHT, centres, tilted
        )
        return centres, tilted[:count]
