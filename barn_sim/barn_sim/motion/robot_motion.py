"""How a robot moves through its world from tick to tick, by itself or in PyBullet.

Where nothing is near, compiled code moves the robot as a free body (`ticks.advance`). A
contact begins when an obstacle is so near that the robot could touch it in the next
tick: the robot and the obstacles near it become bodies of a `ContactScene`, and
PyBullet moves them under the forces of the ground on the tires. The contact ends when
everything near the robot is at rest and the robot has gone. PyBullet then no longer has
anything of it.

Compiled code draws no random numbers, and how many ticks it takes at a time is not
known in advance. So the noise of the odometry's next updates is drawn before
(`draw_noise`), each once and in order, and waits in `Fleet.noise`.
"""

import math
from collections import deque

import numpy as np

from barn_sim.body.drive import DriveController
from barn_sim.body.model import RobotModel, model_of
from barn_sim.body.rigid_body import Tires, place_base, tires_of
from barn_sim.body.state import ROBOT, Fleet, Records
from barn_sim.body.vectors import rotation
from barn_sim.config import PhysicsConfig, SimulatorConfig
from barn_sim.contact.bullet import bullet
from barn_sim.contact.movers import Movers
from barn_sim.contact.obstacles import Obstacles, contact_gap_m
from barn_sim.contact.scene import ContactScene, ScenePool
from barn_sim.motion.ticks import (
    advance,
    base_motion,
    body_state,
    follow_body,
    push_body,
)
from barn_sim.sensors.odometry import FusedOdometry
from barn_worlds.base.arrays import Floats
from barn_worlds.base.types import Pose2D, Velocity2D, nanoseconds
from barn_worlds.worlds.world import World


class RobotMotion:
    """A robot, its odometry and the obstacles around it."""

    model: RobotModel
    """The robot's body."""

    drive: DriveController
    """Accepts commands."""

    odometry: FusedOdometry

    obstacles: Obstacles
    """The cylinders of the world."""

    movers: Movers | None
    """Walls and moving obstacles, if there are any."""

    def __init__(
        self, config: SimulatorConfig, scenes: ScenePool, fleet: Fleet, index: int
    ):
        """Write body, tires, drive and odometry to the fleet; `begin` places the robot.

        Args:
            config: The robot.
            scenes: Physics clients for contacts.
            fleet: Keeps the state.
            index: Row of the robot in the fleet.

        Raises:
            ConfigError: If the robot cannot be simulated.
        """
        self.model = model_of(config.chassis)
        self._config = config
        self._scenes = scenes
        self._scene: ContactScene | None = None
        self._index = index
        self._stamps_ns = fleet.robots["stamp_ns"]
        self._tick_ns = config.tick_ns
        self._gap_m = contact_gap_m(config)
        self._tires = tires_of(self.model, config.physics)
        _set_body(fleet.settings, self.model, config.physics, self._tires)
        self.drive = DriveController(
            config.drive, config.chassis.track_m, config.physics.tick_s, fleet, index
        )

        self._odometry_ns = self._tick_ns * config.ticks(1.0 / config.odometry.rate_hz)
        updates = fleet.noise.shape[1]
        # One row less than there is room for, since an update may begin in the first
        # tick.
        self._ticks_of_noise = (updates - 1) * self._odometry_ns // self._tick_ns
        # Poses of the time that a sweep of the lidar takes.
        sweep_ticks = config.ticks(1.0 / config.lidar.rate_hz)
        self._past: deque[tuple[int, float, float, float]] = deque(
            maxlen=sweep_ticks + 2
        )

    def begin(
        self, world: World, start: Pose2D, phase_s: float, rng: np.random.Generator
    ) -> None:
        """Put the robot at rest at a start pose, with new odometry and obstacles.

        Args:
            world: Obstacles around the robot.
            start: Pose of base_link in the map frame.
            phase_s: Time into the motions of obstacles at the start.
            rng: Source of the odometry's noise.
        """
        self.close()
        config = self._config
        fleet = self.drive.fleet
        fleet.robots[[self._index]] = _robot_at_rest(
            fleet.settings, self.model, self._tires, start
        )
        self.odometry = FusedOdometry(
            config.odometry, rng, start.yaw, fleet, self._index
        )
        self.obstacles = Obstacles(self.model, world, config.obstacles, self._gap_m)
        self.movers = None
        if world.walls or world.moving:
            self.movers = Movers(self.model.extent, world, phase_s, config, self._gap_m)

        robot = fleet.robots[self._index]
        # Infinity spares worlds without movers the look; 0 asks for one before the
        # first tick.
        robot["movers_clearance_m"] = math.inf if self.movers is None else 0.0
        robot["radius_m"] = self.obstacles.radius_m
        # Kernels measure to axes of cylinders, so the radius is part of the gap.
        robot["near_m"] = self.obstacles.radius_m + self._gap_m
        self._was_touched = False
        self._past.clear()
        # Several sensors ask for the pose of one instant, which takes a call of
        # compiled code.
        self._placement: tuple[int, tuple[Pose2D, Velocity2D]] | None = None
        self.odometry.update(0)

    @property
    def stamp_ns(self) -> int:
        """Simulated time since the start, in ns."""
        return int(self._stamps_ns[self._index])

    @property
    def is_in_contact(self) -> bool:
        """Whether PyBullet moves the robot, since an obstacle is near."""
        return self._scene is not None

    @property
    def is_undisturbed(self) -> bool:
        """Whether no cylinder has moved, and the world has no walls or movers."""
        return self.obstacles.undisturbed and self.movers is None

    def tilt_rad(self) -> float:
        """Return the angle between the robot's vertical axis and that of the world."""
        x, y, _, _ = self.drive.fleet.robots["attitude"][self._index].tolist()
        return 2.0 * math.asin(min(1.0, math.hypot(x, y)))

    def pose_and_velocity(self) -> tuple[Pose2D, Velocity2D]:
        """Return true pose (map frame), speed and yaw rate of base_link now."""
        if self._placement is None or self._placement[0] != self.stamp_ns:
            x, y, yaw, linear, angular = base_motion(self.drive.fleet, self._index)
            placement = (Pose2D(x, y, yaw), Velocity2D(linear, angular))
            self._placement = (self.stamp_ns, placement)
        return self._placement[1]

    def remember_pose(self) -> None:
        """Append the present pose to the past ones that `poses_at` interpolates."""
        pose, _ = self.pose_and_velocity()
        self._past.append((self.stamp_ns, *pose.numbers))

    def poses_at(self, stamps_ns: Floats) -> Floats:
        """Return base_link's poses (n, 3) at past times (ns), from remembered ones.

        They are interpolated from those of `remember_pose` and the present one.
        """
        pose, _ = self.pose_and_velocity()
        past = np.array([*self._past, (self.stamp_ns, *pose.numbers)])
        # A yaw that wraps between two poses must not be interpolated the long way
        # round.
        past[:, 3] = np.unwrap(past[:, 3])
        columns = [np.interp(stamps_ns, past[:, 0], past[:, k]) for k in (1, 2, 3)]
        return np.column_stack(columns)

    def take_touch(self) -> bool:
        """Tell whether the robot touched anything since the last call; resets it."""
        was_touched = self._was_touched
        self._was_touched = False
        return was_touched

    def advance(self, ticks: int) -> None:
        """Advance by ticks, draw odometry noise, keep touches for `take_touch`."""
        while ticks:
            count = min(ticks, self._ticks_of_noise)
            self.draw_noise(count)
            self.run(count)
            ticks -= count

    def draw_noise(self, ticks: int) -> None:
        """Draw the odometry's noise for the next ticks, but advance none of them."""
        now_ns = self.stamp_ns
        end_ns = now_ns + ticks * self._tick_ns
        # The present update has its noise already, so the next one is the first to
        # supply.
        first = now_ns // self._odometry_ns + 1
        self.odometry.supply_noise(first, end_ns // self._odometry_ns)

    def run(self, ticks: int) -> None:
        """Advance by physics ticks whose odometry noise has been drawn before."""
        while ticks:
            left = self._advance_freely(ticks)
            if left == ticks and self.movers is not None and not self.is_in_contact:
                # Compiled code knows only how near they may have come since the last
                # look.
                self.movers.look(self.drive.fleet.robots[self._index])
                left = self._advance_freely(ticks)
            if left == ticks:
                self._advance_in_contact()
                left -= 1
            ticks = left

    def _advance_freely(self, ticks: int) -> int:
        """Advance as a free body until an obstacle is near; return the ticks left."""
        segments = self.obstacles.segments
        left: int = advance(self.drive.fleet, self._index, segments, ticks)
        return left

    def _advance_in_contact(self) -> None:
        """Advance a tick in PyBullet, begin or end the contact, and note a touch."""
        fleet = self.drive.fleet
        index = self._index
        scene = self._scene
        if scene is None:
            # Borrowed: a scene takes milliseconds to create and is needed only now.
            scene = self._scenes.acquire(self.model, self._config.physics)
            scene.place_robot(body_state(fleet.robots, index))
            self._scene = scene
            fleet.robots[index]["in_contact"] = True

        place, position, force, torque = push_body(fleet, index)
        # Cylinders before movers: Bullet solves contacts in the order in which its
        # bodies were created.
        self.obstacles.prepare(scene, *place)
        is_mover_near = False
        if self.movers is not None:
            is_mover_near = self.movers.prepare(scene, *place, self.stamp_ns)
        state = scene.tick(position, force, torque)
        pose = follow_body(fleet, index, state)
        # Kept until somebody reads it, so that a touch between two readings is not
        # missed.
        self._was_touched = self._was_touched or scene.is_robot_touched()
        if self.obstacles.has_bodies:
            self.obstacles.follow(scene, Pose2D(*pose))
        if self.obstacles.is_contact_over and not is_mover_near:
            self.close()

    def close(self) -> None:
        """End the contact, if there is one, and give its scene back to the pool."""
        if self._scene is None:
            return
        self._scenes.release(self._scene)
        self._scene = None
        self.obstacles.end_contact()
        if self.movers is not None:
            self.movers.end_contact()
        robot = self.drive.fleet.robots[self._index]
        robot["in_contact"] = False
        # Cylinders may have moved since the last look.
        robot["clearance_m"] = 0.0


def _set_body(
    settings: Records, model: RobotModel, config: PhysicsConfig, tires: Tires
) -> None:
    """Write the settings of body and tires to the record that the fleet shares."""
    settings["tick_s"] = config.tick_s
    settings["tick_ns"] = nanoseconds(config.tick_s)
    settings["gravity_m_s2"] = config.gravity_m_s2
    # Inverses once: a division takes longer than a product, in each of 200 ticks a
    # second.
    settings["inverse_mass"] = 1.0 / model.mass_kg
    settings["inertia"] = model.inertia
    settings["inverse_inertia"] = 1.0 / model.inertia
    settings["center"] = model.center_of_mass
    settings["friction"] = config.wheel_friction
    settings["slip_mps"] = config.tire_slip_mps
    settings["stiffness"] = tires.stiffness
    settings["damping"] = tires.damping
    settings["wheel_radius_m"] = model.wheel_radius_m
    settings["contacts"] = len(tires.hubs)
    settings["grips"] = len(model.wheels)
    settings["extent"] = model.extent
    settings["reach_m"] = model.reach_m


def _robot_at_rest(
    settings: Records, model: RobotModel, tires: Tires, start: Pose2D
) -> Records:
    """Return the record (1,) of a robot that stands on its tires at a start pose."""
    height, roll, pitch = tires.rest
    attitude = bullet.getQuaternionFromEuler([roll, pitch, start.yaw])
    # The start pose is that of base_link, the state that of the center of mass.
    offset = np.array(rotation(attitude)) @ model.center_of_mass
    robots = np.zeros(1, ROBOT)
    robots["position"] = [start.x + offset[0], start.y + offset[1], height]
    robots["attitude"] = attitude
    robots["wheels"]["hub"][0, : len(tires.hubs)] = tires.hubs
    place_base(robots[0], settings[0])
    return robots
