"""The cylinders of a world, with bodies in the physics client only near the robot.

A cylinder is a row of an array and costs nothing while the robot is more than a few
centimeters away. It becomes a body when the robot, or another cylinder that is being
pushed, comes near. The bodies are removed when the contact ends: everything is at rest
and the robot has gone. The cylinders stay where they are.
"""

import math
from dataclasses import dataclass

import numpy as np

from barn_sim.body.model import RobotModel
from barn_sim.config import ObstacleConfig, SimulatorConfig
from barn_sim.contact.cylinders import (
    TOUCH_GAP_M,
    follow_cylinders,
    intersect_cylinders,
    near_cylinders,
)
from barn_sim.contact.scene import ContactScene
from barn_worlds.base.arrays import Bools, Floats, Integers
from barn_worlds.base.types import Pose2D
from barn_worlds.worlds.world import World

# More than the Jackal covers in a tick.
_LEAST_GAP_M = 0.03
# A robot that slides or is pushed may be faster than it may drive.
_SPEED_MARGIN = 1.1
REST_GAP_M = 0.10
# A contact lasts for this long after anything that moves was near a body.
REST_TICKS = 50
_CHECK_TICKS = 10
# Share of the spin lost per second, so that struck cylinders stop rocking and rolling.
_ANGULAR_DAMPING = 0.6
# Bullet's filter group of cylinders that can be pushed; moving obstacles pass through.
_PUSHED_GROUP = 32
_NOTHING_TILTED = np.empty((0, 7))


@dataclass(frozen=True, eq=False)
class Moved:
    """Displaced cylinders."""

    indices: Integers
    """Rows (n,) of `World.cylinders_m`."""

    positions: Floats
    """Centers (n, 3), m."""

    quaternions: Floats
    """Attitudes (n, 4): x, y, z, w."""


def contact_gap_m(config: SimulatorConfig) -> float:
    """Return the gap (m) to an obstacle at which PyBullet takes over the robot.

    It is more than any point of the robot covers in a tick.
    """
    reach_m = max(math.hypot(x, y) for x, y in config.chassis.hull_m)
    drive = config.drive
    fastest_m_s = drive.max_speed_m_s + drive.max_yaw_rate_rad_s * reach_m
    return max(_LEAST_GAP_M, _SPEED_MARGIN * fastest_m_s * config.physics.tick_s)


class Obstacles:
    """All cylinders of a world, and the bodies of those that are near the robot."""

    radius_m: float
    """Radius of every cylinder."""

    segments: Floats
    """Ends (n, 4) of the cylinders' axes seen from above, m."""

    undisturbed: bool
    """Whether every cylinder stands exactly where it stood."""

    def __init__(
        self, model: RobotModel, world: World, config: ObstacleConfig, gap_m: float
    ):
        """Create the cylinders of a world, all upright at home and without bodies.

        Args:
            model: Size of the robot.
            world: Source of the cylinders.
            config: Which of them can be pushed, and how they slide.
            gap_m: Gap to the robot at which a cylinder becomes a body.
        """
        self._extent = model.extent
        self._reach_m = model.reach_m
        self._config = config
        self._gap_m = gap_m
        # Beyond the gap at which bodies are created, so that none comes and goes.
        self._rest_gap_m = max(REST_GAP_M, 2.0 * gap_m)

        self.radius_m = world.cylinder_radius_m
        self._height_m = world.cylinder_height_m
        self._homes = world.cylinders_m
        count = len(self._homes)
        self._movable: Bools = np.full(count, config.movable)
        # The containment follows the obstacles in `cylinders_m`.
        self._movable[len(world.obstacles_m) :] &= config.containment_movable

        # Position and quaternion of each.
        self._states = np.zeros((count, 7))
        self._states[:, :2] = self._homes
        self._states[:, 2] = 0.5 * self._height_m
        self._states[:, 6] = 1.0
        self.segments = np.concatenate([self._homes, self._homes], axis=1)
        self._displaced = np.zeros(count, np.bool_)
        self._hidden = np.zeros(count, np.bool_)
        self._visible_homes = self._homes
        self.undisturbed = True

        self._bodies: dict[int, int] = {}
        self._is_body = np.zeros(count, np.bool_)
        self._pushed = np.zeros(count, np.bool_)
        self.end_contact()

    @property
    def has_bodies(self) -> bool:
        """Whether any cylinder is a body in PyBullet now."""
        return bool(self._bodies)

    @property
    def is_contact_over(self) -> bool:
        """Whether nothing moving was near any body for over 50 ticks (True without)."""
        return all(self._is_at_rest(index) for index in self._bodies)

    def _is_at_rest(self, index: int) -> bool:
        """Tell whether nothing that moves has been near a body for over 50 ticks."""
        return self._ticks - self._needed_at[index] > REST_TICKS

    def end_contact(self) -> None:
        """Forget the numbers of the bodies; do not remove them from the scene."""
        self._bodies.clear()
        self._is_body[:] = False
        self._pushed[:] = False
        self._ticks = 0
        # Tick at which each body was last near anything that moves.
        self._needed_at: dict[int, int] = {}
        # Pose of the last look, and how far the robot may go from there.
        self._looked_from = (0.0, 0.0, 0.0)
        self._free_m = 0.0

    def prepare(self, scene: ContactScene, x: float, y: float, yaw: float) -> None:
        """Create bodies of near cylinders; do nothing while the last look still holds.

        Near are those that could be touched in the next tick.

        Args:
            scene: Scene of the contact.
            x: Position of base_link, m.
            y: Position of base_link, m.
            yaw: Yaw of base_link, rad.
        """
        last_x, last_y, last_yaw = self._looked_from
        distance_m = math.hypot(x - last_x, y - last_y)
        if distance_m + abs(yaw - last_yaw) * self._reach_m < self._free_m:
            return
        self._looked_from = (x, y, yaw)
        indices, self._free_m = self._near(~self._is_body, x, y, yaw, self._gap_m)
        for index in indices:
            self._bodies[index] = self._add_body(scene, index)
            self._is_body[index] = True
            self._needed_at[index] = self._ticks

    def _near(
        self, candidates: Bools, x: float, y: float, yaw: float, robot_within_m: float
    ) -> tuple[list[int], float]:
        """Return near candidates' rows, and how far (m) the robot may go unchecked."""
        indices, free_m = near_cylinders(
            self.segments,
            candidates,
            self._pushed,
            x,
            y,
            yaw,
            self._extent,
            self.radius_m,
            robot_within_m,
            TOUCH_GAP_M,
        )
        return indices.tolist(), free_m

    def _add_body(self, scene: ContactScene, index: int) -> int:
        """Create a cylinder in a scene, fixed or movable; return its number."""
        config = self._config
        state = self._states[index].tolist()
        # To PyBullet, a body without mass is fixed.
        mass_kg = 0.0
        dynamics: dict[str, object] = {
            "lateralFriction": config.friction,
            "angularDamping": _ANGULAR_DAMPING,
        }
        if self._movable[index]:
            mass_kg = config.mass_kg
            tilt = config.inertia_tilt_kg_m2
            spin = config.inertia_spin_kg_m2
            dynamics["localInertiaDiagonal"] = [tilt, tilt, spin]
        return scene.add(
            (self.radius_m, self._height_m),
            state[:3],
            state[3:],
            mass_kg,
            _PUSHED_GROUP,
            -1,
            **dynamics,
        )

    def follow(self, scene: ContactScene, robot: Pose2D) -> None:
        """Copy movable bodies' states, clear `undisturbed`; at times remove idle ones.

        Args:
            scene: Scene of the contact.
            robot: Pose of base_link after the tick.
        """
        indices = []
        states = []
        if self._config.movable:
            for index, body in self._bodies.items():
                if self._movable[index]:
                    indices.append(index)
                    states.append(np.concatenate(scene.state(body)))
        if indices:
            self.undisturbed = False
            # Pushed cylinders may come nearer to the robot, so the last look is void.
            self._free_m = 0.0
            follow_cylinders(
                np.array(indices),
                np.array(states),
                *robot.numbers,
                self._extent,
                self._homes,
                self.radius_m,
                0.5 * self._height_m,
                self._states,
                self.segments,
                self._pushed,
                self._displaced,
            )
        self._ticks += 1
        if self._ticks % _CHECK_TICKS == 0:
            self._remove_bodies(scene, robot)

    def _remove_bodies(self, scene: ContactScene, robot: Pose2D) -> None:
        """Remove movable bodies at rest from the scene while others are still near.

        Bullet would go on solving their contacts with the ground. Fixed ones cost
        nothing and stay until the contact ends.
        """
        needed, _ = self._near(self._is_body, *robot.numbers, self._rest_gap_m)
        for index in needed:
            self._needed_at[index] = self._ticks
        if not needed:
            return
        for index in list(self._bodies):
            if self._movable[index] and self._is_at_rest(index):
                scene.remove(self._bodies.pop(index))
                self._is_body[index] = False
                self._pushed[index] = False
                self._free_m = 0.0

    def moved(self) -> Moved:
        """Return cylinders with an end ever displaced by over 1 mm, and their poses."""
        indices = np.flatnonzero(self._displaced)
        return Moved(indices, self._states[indices, :3], self._states[indices, 3:])

    def hide(self, share: float, rng: np.random.Generator) -> None:
        """Hide a share of the cylinders, drawn anew, from `cross_section`."""
        self._hidden = rng.random(len(self._homes)) < share
        self._visible_homes = self._homes.copy()
        self._visible_homes[self._hidden] = np.inf

    def cross_section(self, height_m: float) -> tuple[Floats, Floats]:
        """Return upright circles (hidden ones at inf) and tilted cylinders at a height.

        Args:
            height_m: Height of the plane above the ground.

        Returns:
            Centers (n, 2) of upright cylinders, at most half a degree from the
            vertical, infinite for the others; and the others (m, 7). Hidden ones are
            left out.
        """
        # Each scan asks, and most cylinders are never touched.
        if self.undisturbed:
            return self._visible_homes, _NOTHING_TILTED
        displaced = np.flatnonzero(self._displaced & ~self._hidden)
        if not len(displaced):
            return self._visible_homes, _NOTHING_TILTED
        centers = self._visible_homes.copy()
        tilted = np.empty((len(displaced), 7))
        half_m = 0.5 * self._height_m
        count = intersect_cylinders(
            displaced, self._states, half_m, height_m, centers, tilted
        )
        return centers, tilted[:count]
