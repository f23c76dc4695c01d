"""The simulator core: one robot in one world for one trial."""

import math

import numpy as np

from barn_sim import seeds
from barn_sim.body.state import Fleet
from barn_sim.config import ObstacleConfig, SimulatorConfig
from barn_sim.contact.obstacles import Moved
from barn_sim.contact.scene import ScenePool
from barn_sim.motion.robot_motion import RobotMotion
from barn_sim.seeds import generator, phase_s
from barn_sim.sensors.lidar import NO_SHAPES, Lidar
from barn_sim.sensors.localization import FilterLocalization, make_localization
from barn_sim.sensors.particles import ParticleLocalization
from barn_sim.sensors.readings import Joints, Sensors
from barn_worlds.base.arrays import Singles
from barn_worlds.base.errors import TippedError
from barn_worlds.base.types import (
    ORIGIN,
    STOP,
    Odometry,
    Pose2D,
    Scan,
    Velocity2D,
    nanoseconds,
)
from barn_worlds.worlds.world import World

_LARGEST_TILT_RAD = math.radians(60.0)


class Simulator:
    """A robot in a world, from a start pose and a seed.

    Equal arguments and commands give equal readings, to the last bit. Use `step` and
    `sense`; or, to read sensors at different rates, `command`, `advance` and the
    `read_` methods. Each sensor has its own random generator, so that one does not
    affect another.
    """

    motion: RobotMotion
    """The robot among its obstacles, from tick to tick."""

    lidar: Lidar
    """The lidar whose scans planners receive."""

    phase_s: float
    """Time into the motions of moving obstacles at the start."""

    invalid_commands: int
    """Number of commands with NaN or infinity, each of which stopped the robot."""

    def __init__(
        self,
        world: World,
        config: SimulatorConfig,
        start: Pose2D,
        seed: int,
        scenes: ScenePool | None = None,
        *,
        fleet: Fleet | None = None,
        index: int = 0,
    ):
        """Make a simulator with its robot at rest at the start pose, or ConfigError.

        Args:
            world: Obstacles around the robot.
            config: The robot and its sensors.
            start: Pose of base_link in the map frame.
            seed: Seed of all noise.
            scenes: Physics clients for contacts, shared with other simulators, which is
                faster for trial after trial and gives the same readings. The caller
                closes them. By default, the simulator has its own.
            fleet: Keeps the state of many robots; by default, this one has its own.
            index: Row of the robot in the fleet.

        Raises:
            ConfigError: If the robot cannot be simulated.
        """
        self.config = config
        self._scenes = scenes or ScenePool()
        self._owns_scenes = scenes is None
        self._fleet = Fleet.of(1) if fleet is None else fleet
        self._index = index
        self.motion = RobotMotion(config, self._scenes, self._fleet, index)
        self.lidar = Lidar(config.lidar, generator(seed, seeds.LIDAR))
        self._scan_period_ns = config.scan_steps * nanoseconds(config.control_period_s)
        # The scan plane counts from the ground, on which obstacles stand; mounts from
        # base_link.
        self._scan_height_m = config.lidar.mount_z_m + config.chassis.base_height_m
        self._ticks_per_step = config.ticks(config.control_period_s)
        self.begin(world, start, seed)

    def begin(self, world: World, start: Pose2D, seed: int) -> None:
        """Restart with a world, start pose and seed, as if the simulator were new.

        Args:
            world: Obstacles around the robot.
            start: Pose of base_link in the map frame.
            seed: Seed of all noise.
        """
        config = self.config
        self.phase_s = phase_s(world, config, start, seed)
        self.motion.begin(world, start, self.phase_s, generator(seed, seeds.ODOMETRY))
        if config.odometry.gyro_bias_rad_s or config.odometry.wheel_radius_error:
            # A child of its own: a robot without these errors draws the same noise as
            # before.
            rng = generator(seed, seeds.BIAS)
            self.motion.odometry.draw_errors(config.odometry, rng)

        # The lidar stays from trial to trial, but its draws start over.
        self.lidar.begin(generator(seed, seeds.LIDAR))
        if config.lidar.unseen_share:
            rng = generator(seed, seeds.UNSEEN)
            self.motion.obstacles.hide(config.lidar.unseen_share, rng)
        self._localization: FilterLocalization | ParticleLocalization | None = None
        if config.localisation.mode != "exact":
            rng = generator(seed, seeds.LOCALIZATION)
            self._localization = make_localization(
                config, world, start, self.lidar.mount, rng
            )
            # Scans with noise of their own, so that no other reading depends on when
            # the filter takes one.
            self._localization_lidar = Lidar(config.lidar, rng)

        self.invalid_commands = 0
        self._sensors: Sensors | None = None

    @property
    def stamp_ns(self) -> int:
        """Simulated time since the start of the trial, in ns."""
        return self.motion.stamp_ns

    def sense(self) -> Sensors:
        """Return this instant's readings, cached, with the last scan if none is due."""
        last = self._sensors
        if last is not None and last.stamp_ns == self.stamp_ns:
            return last

        # The order of readings is that of their draws.
        odometry = self.read_odometry()
        scan = None
        if last is not None and self.config.scan_steps > 1:
            age_ns = self.stamp_ns - last.scan.stamp_ns
            if age_ns < self._scan_period_ns:
                scan = last.scan
        self._sensors = Sensors(
            stamp_ns=self.stamp_ns,
            odometry=odometry,
            scan=scan or self.read_scan(),
            truth=self.read_truth(),
            localization=self.read_localization(odometry.pose),
            collision=self.read_collision(),
            joints=self.read_joints(),
        )
        return self._sensors

    def step(self, command: Velocity2D | None, delay_ns: int = 0) -> Sensors:
        """Queue a command, if any, advance one control period and return all readings.

        Args:
            command: Sent first; None for no command.
            delay_ns: Time until the command arrives.

        Returns:
            The readings at the end of the control period.
        """
        if command is not None:
            self.command(command, delay_ns)
        self.advance(self._ticks_per_step)
        return self.sense()

    def command(self, velocity: Velocity2D, delay_ns: int = 0) -> None:
        """Queue a command without advancing; count NaN or infinity as invalid and stop.

        Args:
            velocity: Speed and yaw rate.
            delay_ns: Time until the command arrives, rounded to ticks. No earlier
                command may arrive later.
        """
        if not velocity.is_finite():
            self.invalid_commands += 1
            velocity = STOP
        # Commands wait for a tick: without rounding, a delay would only grow.
        tick_ns = self.config.tick_ns
        arrival_ns = self.stamp_ns + round(delay_ns / tick_ns) * tick_ns
        # Python's floats: NumPy scalars of planners would slow down compiled calls.
        exact = Velocity2D(float(velocity.linear), float(velocity.angular))
        self.motion.drive.command(exact, arrival_ns)

    def advance(self, ticks: int) -> None:
        """Advance by some physics ticks (not control periods) and read no sensor."""
        if self.lidar.sweeps:
            self.motion.remember_pose()
        self.motion.advance(ticks)

    def require_upright(self) -> None:
        """Raise TippedError if the robot leans by more than 60 degrees.

        Raises:
            TippedError: If it does. The trial cannot go on.
        """
        # No tire gets back to the ground from there.
        if self.motion.tilt_rad() > _LARGEST_TILT_RAD:
            raise TippedError(
                f"robot {self.config.chassis.name} tipped over: lower its"
                " centre_of_mass_m or max_acceleration_m_s2"
            )

    def read_odometry(self) -> Odometry:
        """Return the fused odometry now: pose in the odom frame, speed and yaw rate."""
        return self.motion.odometry.read(self.stamp_ns)

    def read_scan(self, noise: Singles | None = None) -> Scan:
        """Take a lidar scan now; `noise` (n,) is standard normal, drawn by default."""
        return self._take_scan(self.lidar, noise)

    def read_truth(self) -> Odometry:
        """Return the true pose of base_link in the map frame and its true velocity."""
        pose, velocity = self.motion.pose_and_velocity()
        return Odometry(self.stamp_ns, pose.through_quaternion(), velocity)

    def read_localization(self, odometry: Pose2D) -> Pose2D:
        """Return the map pose estimate (truth if exact) plus offset; may take a scan.

        Args:
            odometry: Pose in the odom frame at this instant.
        """
        pose, _ = self.motion.pose_and_velocity()
        if isinstance(self._localization, ParticleLocalization):
            pose = self._localization.estimate(
                self.stamp_ns,
                odometry,
                lambda: self._take_scan(self._localization_lidar),
            )
        elif self._localization is not None:
            pose = self._localization.estimate(pose, odometry)
        offset = self.config.localisation
        x = pose.x + offset.offset_x_m
        y = pose.y + offset.offset_y_m
        return Pose2D(x, y, pose.yaw).through_quaternion()

    def read_collision(self) -> bool:
        """Tell whether the robot touched anything since the last call; resets it."""
        return self.motion.take_touch()

    def read_joints(self) -> Joints:
        """Return angles (rad) and speeds (rad/s) of the wheels, left before right."""
        # A field of all robots first: NumPy takes four times as long for a field of one.
        robots = self._fleet.robots
        index = self._index
        model = self.motion.model
        # Wheels of one side turn alike: a chain or a common command drives them.
        axles = len(model.wheels) // 2
        angles = (float(robots["left_rad"][index]), float(robots["right_rad"][index]))
        left = float(robots["left_m_s"][index]) / model.wheel_radius_m
        right = float(robots["right_m_s"][index]) / model.wheel_radius_m
        return Joints(angles * axles, (left, right) * axles)

    def moved_obstacles(self) -> Moved:
        """Return cylinders moved by over 1 mm, as rows of `World.cylinders_m`."""
        return self.motion.obstacles.moved()

    def _take_scan(self, lidar: Lidar, noise: Singles | None = None) -> Scan:
        """Take a scan of cylinders, walls and moving obstacles now and return it."""
        motion = self.motion
        pose, _ = motion.pose_and_velocity()
        height_m = self._scan_height_m
        centers, tilted = motion.obstacles.cross_section(height_m)
        radius_m = motion.obstacles.radius_m
        shapes = NO_SHAPES
        if motion.movers is not None:
            shapes = motion.movers.cross_section(self.stamp_ns, height_m)
        sweep = None
        if lidar.sweeps:
            sweep = motion.poses_at(self.stamp_ns - lidar.ages_ns)
        return lidar.scan(
            self.stamp_ns, pose, centers, radius_m, tilted, shapes, noise, sweep
        )

    def close(self) -> None:
        """Close the contact scene and, unless passed in, the physics clients."""
        self.motion.close()
        if self._owns_scenes:
            self._scenes.close()


def warm_up() -> None:
    """Compile every numba kernel by simulating a robot that runs into a wall."""
    grid = np.zeros((9, 3), np.bool_)
    # A wall across the robot's way, so that contacts are compiled, too.
    grid[4] = True
    world = World("warm-up", grid, np.array([[0, 0], [0, 1], [0, 2]]))
    x, y = world.obstacles_m[0].tolist()
    for movable in (True, False):
        config = SimulatorConfig(obstacles=ObstacleConfig(movable=movable))
        simulator = Simulator(world, config, Pose2D(x, y - 0.35, 1.57), 0)
        for _ in range(20):
            simulator.step(Velocity2D(1.0, 0.0))
        simulator.close()
    # No cylinder above may have tilted.
    tilted = np.array([[2.0, 0.0, 0.0, 0.6, 0.0, 0.8, 0.5]])
    lidar = Lidar(config.lidar, np.random.default_rng(0))
    lidar.scan(0, ORIGIN, np.ones((1, 2)), 0.1, tilted)
