"""Walls and moving obstacles: where they are, and bodies of those near the robot.

A moving obstacle pushes the robot and nothing pushes it. In PyBullet it is a body far
heavier than the robot that is set to its pose and velocity before every tick: unlike a
fixed body, it passes its velocity on in a contact. It passes through everything but the
robot.
"""

import math

import numpy as np

from barn_sim.body.state import Record
from barn_sim.body.vectors import Quaternion, Vector
from barn_sim.config import SimulatorConfig
from barn_sim.contact.scene import STILL, ContactScene
from barn_worlds.base.arrays import Floats
from barn_worlds.base.types import NANOSECONDS_PER_SECOND, seconds
from barn_worlds.geometry.bodies import moving_bodies, wall_bodies
from barn_worlds.geometry.kernels import gaps_to_rectangle
from barn_worlds.moving.tracks import evaluate
from barn_worlds.worlds.world import World

_MASS_KG = 1e6
# A contact ends this far beyond the gap at which it begins.
_LEAVE_GAP_M = 0.1
# Bullet's filter groups: moving obstacles touch only bodies of the robot's group.
_ROBOT_GROUP = 1
_MOVER_GROUP = 64
# Beyond any trial.
_LONG_S = 1e6


class Movers:
    """Walls and moving obstacles of a world, the walls first in all arrays."""

    def __init__(
        self,
        extent: Floats,
        world: World,
        phase_s: float,
        config: SimulatorConfig,
        gap_m: float,
    ):
        """Create the walls and moving obstacles of a world, without bodies yet.

        Args:
            extent: x_min, y_min, x_max, y_max (4,) of the robot in base_link, m.
            world: Source of walls and obstacles.
            phase_s: Time into the motions at the start.
            config: Friction, gravity and tick.
            gap_m: Gap to the robot at which a wall becomes a body.
        """
        walls = world.walls
        tracks = world.tracks
        self._extent = extent
        self._phase_s = phase_s
        self._tick_ns = config.tick_ns
        self._friction = config.obstacles.friction
        # What a tick of free fall takes away, since Bullet applies gravity to them.
        self._lift_m_s = config.physics.gravity_m_s2 * config.physics.tick_s

        self._walls = len(walls)
        self._tracks = tracks
        moving = moving_bodies(tracks, phase_s)
        self._shapes = np.concatenate([wall_bodies(walls).shapes(), moving.shapes()])
        self._velocities = np.zeros((len(self._shapes), 2))
        wall_heights_m = [wall.height_m for wall in walls]
        self._heights_m = np.concatenate([wall_heights_m, tracks.height_m])
        speeds_m_s = np.concatenate([np.zeros(len(walls)), tracks.fastest_mps])
        self._fastest_m_s: float = speeds_m_s.max()
        # How near each may come before it becomes a body.
        self._wake_m: Floats = gap_m + speeds_m_s * config.physics.tick_s
        self._bodies: dict[int, int] = {}

    def shapes_at(self, stamp_ns: int) -> Floats:
        """Return the shapes (n, 7) at a time, walls first; the array is reused."""
        if len(self._tracks):
            evaluate(
                seconds(stamp_ns) + self._phase_s,
                self._tracks.table,
                self._shapes[self._walls :, :2],
                self._velocities[self._walls :],
            )
        return self._shapes

    def cross_section(self, stamp_ns: int, height_m: float) -> Floats:
        """Return the shapes (k, 7) of walls and movers that reach up to a plane.

        Args:
            stamp_ns: Time since the start.
            height_m: Height of the plane above the ground.
        """
        shapes = self.shapes_at(stamp_ns)
        is_tall = self._heights_m >= height_m
        return shapes if is_tall.all() else shapes[is_tall]

    def look(self, robot: Record) -> None:
        """Write to a robot's record how near walls and movers are, and until when."""
        stamp_ns = int(robot["stamp_ns"])
        pose = (float(robot["x"]), float(robot["y"]), float(robot["yaw"]))
        gaps = gaps_to_rectangle(self.shapes_at(stamp_ns), *pose, self._extent)

        # A motion that begins anew may jump, so the look holds only until a tick
        # before.
        period_s = self._tracks.table[4]
        time_s = seconds(stamp_ns) + self._phase_s + self._tracks.table[5]
        remaining_s = (period_s - time_s % period_s).min(initial=_LONG_S)

        robot["movers_looked_from"] = pose
        robot["movers_looked_ns"] = stamp_ns
        robot["movers_clearance_m"] = (gaps - self._wake_m).min()
        robot["movers_speed_m_s"] = self._fastest_m_s
        holds_ns = math.floor(NANOSECONDS_PER_SECOND * remaining_s) - self._tick_ns
        # At the time of the look it always holds: a tick never waits for another look.
        robot["movers_until_ns"] = stamp_ns + max(holds_ns, 1)

    def prepare(
        self, scene: ContactScene, x: float, y: float, yaw: float, stamp_ns: int
    ) -> bool:
        """Create bodies of near walls and movers and move them; True if any is near.

        Args:
            scene: Scene of the contact.
            x: Position of base_link, m.
            y: Position of base_link, m.
            yaw: Yaw of base_link, rad.
            stamp_ns: Time since the start.

        Returns:
            Whether any is near enough for the contact to last.
        """
        shapes = self.shapes_at(stamp_ns)
        gaps: Floats = gaps_to_rectangle(shapes, x, y, yaw, self._extent)
        for index in np.flatnonzero(gaps < self._wake_m).tolist():
            if index not in self._bodies:
                self._bodies[index] = self._add_body(scene, index)

        for index, body in self._bodies.items():
            # Walls come first in the arrays and stay where they are.
            if index >= self._walls:
                position, attitude = self._pose(index)
                vx, vy = self._velocities[index].tolist()
                velocity = (vx, vy, self._lift_m_s)
                scene.set_state(body, (position, attitude, velocity, STILL))
        return bool((gaps <= self._wake_m + _LEAVE_GAP_M).any() and self._bodies)

    def end_contact(self) -> None:
        """Forget the numbers of the bodies; do not remove them from the scene."""
        self._bodies.clear()

    def _pose(self, index: int) -> tuple[Vector, Quaternion]:
        """Return center (m) and quaternion of a wall or mover by its row."""
        x, y, _, _, _, cosine, sine = self._shapes[index].tolist()
        half = 0.5 * math.atan2(sine, cosine)
        position = (x, y, 0.5 * float(self._heights_m[index]))
        return position, (0.0, 0.0, math.sin(half), math.cos(half))

    def _add_body(self, scene: ContactScene, index: int) -> int:
        """Create a fixed wall or a heavy mover in a scene; return its number."""
        _, _, radius, half_x, half_y, _, _ = self._shapes[index].tolist()
        height = float(self._heights_m[index])
        position, attitude = self._pose(index)
        # To PyBullet, a body without mass is fixed.
        mass_kg = 0.0
        if index >= self._walls:
            mass_kg = _MASS_KG
        # A cylinder has its whole height, a box half of it, as `ContactScene.add` does.
        size: tuple[float, ...] = (half_x, half_y, 0.5 * height)
        if radius:
            size = (radius, height)
        return scene.add(
            size,
            position,
            attitude,
            mass_kg,
            _MOVER_GROUP,
            _ROBOT_GROUP,
            lateralFriction=self._friction,
            angularDamping=0.0,
        )
