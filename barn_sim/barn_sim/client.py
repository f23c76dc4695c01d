"""A PyBullet physics engine in this process."""

from __future__ import annotations

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
