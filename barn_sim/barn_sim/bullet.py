"""PyBullet: imported without the line that it prints on standard error, its engines, bodies and rays."""

import importlib
import os
import sys
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import numpy as np

from barn_worlds.arrays import Floats
from barn_worlds.types import Pose2D, Scan
from barn_worlds.world import World


def _silenced_import() -> Any:
    sys.stderr.flush()
    try:
        kept = os.dup(2)
    except OSError:  # standard error is closed
        return importlib.import_module("pybullet")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        return importlib.import_module("pybullet")
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


bullet = _silenced_import()

_RENDERER = 2  # PyBullet's own number of the plug-in that draws
_MOVING, _STANDING = (1, -1), (2, ~2)  # PyBullet's groups and masks of bodies that move and of those that do not
_FAR_AWAY, _UPRIGHT = (0.0, 0.0, -1000.0), (0.0, 0.0, 0.0, 1.0)


class PhysicsClient:
    """A physics engine, begun when it is first used. An emptied one behaves exactly like a new one and is ready sooner.

    draws: whether pictures can be taken. Without, a body is ready in a tenth of the time: no mesh is made of it.
    ticks: simulated since the engine was new or reset; resumed: how often since then.

    Guests are bodies that come and go. Those that stand and are alike are kept far away until they are needed again.
    shapes: of cylinders, by radius and height.
    """

    def __init__(self, *, draws: bool = False) -> None:
        self._draws = draws
        self._id = -1
        self._stale = False
        self._begin()

    def _begin(self) -> None:
        self.ticks = self.resumed = 0
        self._residents: tuple[object, int, int] | None = None
        self._guests: dict[int, Hashable] = {}  # kinds of those that are here, None of those that move
        self._kept: dict[Hashable, list[int]] = {}  # bodies of a kind that are far away
        self.shapes: dict[tuple[float, float], int] = {}

    @property
    def id(self) -> int:
        """PyBullet's number of the engine, which is ready then."""
        if self._stale and not bullet.isConnected(self._id):  # somebody else in the process has ended it
            self._id = -1
        if self._id < 0:
            self._id = bullet.connect(bullet.DIRECT)
            self._begin()
            if self._id < 0:
                raise RuntimeError("PyBullet has no room for another physics client")
            if not self._draws:
                bullet.unloadPlugin(_RENDERER, physicsClientId=self._id)
        elif self._stale:
            bullet.resetSimulation(physicsClientId=self._id)
            self._begin()
        self._stale = False
        return self._id

    def tick(self) -> None:
        """Simulate a tick."""
        bullet.stepSimulation(self._id)
        self.ticks += 1

    def settle(self, kind: object, ground: int, robot: int) -> None:
        """Take note of ground and robot, which stay when an engine is emptied that nobody has used otherwise."""
        self._residents = kind, ground, robot

    def resume(self, kind: object) -> tuple[int, int] | None:
        """Send away the guests of an emptied engine and return ground and robot, if they are of this kind."""
        settled = self._residents is not None and self._residents[0] == kind
        if not self._stale or not settled or not bullet.isConnected(self._id):
            return None
        for body in list(self._guests):
            self.send_away(body)
        self.resumed += 1
        self._stale = False
        assert self._residents is not None
        return self._residents[1:]

    def receive(self, make: Callable[[], int]) -> int:
        """Have a guest made, and return its body.

        Before the first, Bullet's broad phase is told of the robot as if it were new. In which order contacts are
        solved then does not depend on where the robot has been.
        """
        if not self._guests:
            assert self._residents is not None
            self._renew(self._residents[2], _MOVING)
        body = make()
        self._guests[body] = None
        return body

    def receive_standing(self, kind: Hashable, position: Sequence[float], make: Callable[[], int]) -> int:
        """Have a guest that stands upright; kind: what decides how it is made. Bodies of a kind are used again."""
        kept = self._kept.get(kind, [])
        again = bool(kept)
        body = self.receive(kept.pop if again else make)
        self._guests[body] = kind
        if again:
            bullet.resetBasePositionAndOrientation(body, position, _UPRIGHT, physicsClientId=self._id)
            self._renew(body, _STANDING)
        return body

    def send_away(self, body: int) -> None:
        """Let a guest go."""
        kind = self._guests.pop(body)
        if kind is None:
            bullet.removeBody(body, physicsClientId=self._id)
            return
        bullet.resetBasePositionAndOrientation(body, _FAR_AWAY, _UPRIGHT, physicsClientId=self._id)
        self._renew(body, _STANDING)
        self._kept.setdefault(kind, []).append(body)

    def _renew(self, body: int, filters: tuple[int, int]) -> None:
        """Let the broad phase forget a body and find it anew."""
        bullet.setCollisionFilterGroupMask(body, -1, *filters, physicsClientId=self._id)

    def empty(self) -> None:
        """Remove everything before the next use; bodies are numbered from 0 again."""
        self._stale = self._id >= 0

    def close(self) -> None:
        """Release the engine; closing again does nothing."""
        if self._id >= 0:
            bullet.disconnect(physicsClientId=self._id)
            self._id = -1
            self._begin()


def add_body(
    client: int, shape: int, position: Sequence[float], attitude: Sequence[float], mass_kg: float, **dynamics: Any
) -> int:
    """Add one rigid body of a collision shape, its centre at `position` (3,), m, and return its number.

    attitude: quaternion x, y, z, w. mass_kg: 0 for a fixed body. dynamics: further arguments of PyBullet's
    changeDynamics, such as lateralFriction.
    """
    body: int = bullet.createMultiBody(
        mass_kg, shape, -1, position, attitude, useMaximalCoordinates=True, physicsClientId=client
    )
    bullet.changeDynamics(body, -1, mass=mass_kg, linearDamping=0.0, physicsClientId=client, **dynamics)
    # so that Bullet uses the inertia just set from the first tick on
    bullet.resetBasePositionAndOrientation(body, position, attitude, physicsClientId=client)
    return body


class BulletRays:
    """A world's upright cylinders in a physics client of their own: a slower, independent reference for the lidar."""

    def __init__(self, world: World) -> None:
        self._client = bullet.connect(bullet.DIRECT)
        height = world.cylinder_height_m
        shape = bullet.createCollisionShape(
            bullet.GEOM_CYLINDER, radius=world.cylinder_radius_m, height=height, physicsClientId=self._client
        )
        for x, y in world.cylinders_m.tolist():
            bullet.createMultiBody(0.0, shape, -1, [x, y, height / 2.0], physicsClientId=self._client)

    def rays(self, scan: Scan, sensor: Pose2D, height_m: float = 0.3) -> tuple[list[list[float]], list[list[float]]]:
        """Return start and end of each beam of a scan, for a sensor at this pose in the map frame."""
        angles = scan.angles() + sensor.yaw
        reach = np.array([sensor.x, sensor.y]) + scan.range_max * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        return [[sensor.x, sensor.y, height_m]] * len(angles), [[x, y, height_m] for x, y in reach.tolist()]

    def ranges(self, starts: list[list[float]], ends: list[list[float]], range_max: float) -> Floats:
        """Return the distance (n,) to the first hit of each ray, +inf without one."""
        hits = bullet.rayTestBatch(starts, ends, physicsClientId=self._client)
        return np.array([hit[2] * range_max if hit[0] >= 0 else np.inf for hit in hits])

    def close(self) -> None:
        """Release the physics client."""
        bullet.disconnect(physicsClientId=self._client)
