"""A PyBullet physics engine in this process."""

from collections.abc import Sequence
from typing import Any

from barn_sim.bullet import bullet


class PhysicsClient:
    """A physics engine. An emptied one behaves exactly like a new one and is ready in a thirtieth of the time.

    id: PyBullet's number of it, -1 once closed.
    """

    def __init__(self) -> None:
        self.id: int = bullet.connect(bullet.DIRECT)
        if self.id < 0:
            raise RuntimeError("PyBullet has no room for another physics client")

    def empty(self) -> None:
        """Remove everything; bodies are numbered from 0 again."""
        bullet.resetSimulation(physicsClientId=self.id)

    def close(self) -> None:
        """Release the engine; closing again does nothing."""
        if self.id >= 0:
            bullet.disconnect(physicsClientId=self.id)
            self.id = -1


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
