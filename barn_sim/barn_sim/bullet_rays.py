"""PyBullet's own ray casting, a slower and independent reference for `barn_sim.lidar`."""

import numpy as np
import numpy.typing as npt

from barn_sim.bullet import bullet
from barn_worlds.types import Pose2D, Scan
from barn_worlds.world import World


class BulletRays:
    """The upright cylinders of a world as separate bodies in a physics client of their own."""

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

    def ranges(self, starts: list[list[float]], ends: list[list[float]], range_max: float) -> npt.NDArray[np.float64]:
        """Return the distance (n,) to the first hit of each ray, +inf without one."""
        hits = bullet.rayTestBatch(starts, ends, physicsClientId=self._client)
        return np.array([hit[2] * range_max if hit[0] >= 0 else np.inf for hit in hits])

    def close(self) -> None:
        """Release the physics client."""
        bullet.disconnect(physicsClientId=self._client)
