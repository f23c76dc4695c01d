"""The simulator core: one robot in one world for one trial."""

import numpy as np

from barn_sim import seeds
from barn_sim.body.state import Fleet
from barn_sim.config import ObstacleConfig, SimulatorConfig
from barn_sim.contact.bullet import PhysicsClient
from barn_sim.contact.obstacles import Moved
from barn_sim.motion.robot_motion import RobotMotion
from barn_sim.seeds import generator, phase_s
from barn_sim.sensors.lidar import Lidar, Singles
from barn_sim.sensors.localization import FilterLocalization, make_localization
from barn_sim.sensors.particles import ParticleLocalization
from barn_sim.sensors.readings import Joints, Sensors
from barn_worlds.base.types import STOP, Odometry, Pose2D, Scan, Velocity2D, nanoseconds
from barn_worlds.worlds.world import World


class Simulator:
    """A robot in a world, from a start pose and a seed, in a physics client of its own.

    Equal arguments and commands give equal readings, to the last bit. Use `step` and `sense`; or, to read sensors at
    different rates, `command`, `advance` and the `read_` methods. Each sensor has its own random generator, so that one
    does not affect another.

    motion: the robot among its obstacles, from tick to tick. invalid_commands: how many commands were not numbers, each
    of which stops the robot. phase_s: time into the motions of moving obstacles at the start.
    """

    def __init__(
        self,
        world: World,
        config: SimulatorConfig,
        start: Pose2D,
        seed: int,
        client: PhysicsClient | None = None,
        *,
        free_motion: bool = True,
        fleet: Fleet | None = None,
        index: int = 0,
    ) -> None:
        """Put the robot on the ground at `start` (map frame), at rest.

        Args:
            world: what stands and moves around it.
            config: the robot and its sensors.
            start: pose of base_link in the map frame, m and rad.
            seed: of all noise.
            client: emptied and used instead of a new one, which is faster for trial after trial and gives the same
                readings. A simulator that used it before is finished. The caller closes it.
            free_motion: integrate the motion without PyBullet where no obstacle is near, which gives the same bits
                faster; false: leave every tick to PyBullet.
            fleet: whose state it keeps at `index`; a robot of its own without it.
            index: of the robot in the fleet.

        Raises:
            ConfigError: for a robot that cannot be simulated.
        """
        self.config = config
        engine = client or PhysicsClient()
        self._own_client = None if client else engine
        self._fleet, self._index = Fleet.of(1) if fleet is None else fleet, index
        self.motion = RobotMotion(
            config, engine, self._fleet, index, free_motion=free_motion
        )
        self.lidar = Lidar(config.lidar, generator(seed, seeds.LIDAR))
        self._scan_period_ns = config.scan_steps * nanoseconds(config.control_period_s)
        self._scan_height_m = config.lidar.mount_z_m - float(
            self.motion.model.footing[2]
        )
        self._ticks_per_step = config.ticks(config.control_period_s)
        self.begin(world, start, seed)

    def begin(self, world: World, start: Pose2D, seed: int) -> None:
        """Begin anew, as a new simulator would with these arguments, but sooner."""
        config = self.config
        self.phase_s = phase_s(world, config.obstacles.random_phase, seed)
        self.motion.begin(world, start, self.phase_s, generator(seed, seeds.ODOMETRY))
        if config.odometry.gyro_bias_rad_s or config.odometry.wheel_radius_error:
            self.motion.odometry.draw_errors(
                config.odometry, generator(seed, seeds.BIAS)
            )
        self.lidar.rng = generator(seed, seeds.LIDAR)
        self._localization: FilterLocalization | ParticleLocalization | None = None
        if config.localisation.mode != "exact":
            rng = generator(seed, seeds.LOCALISATION)
            self._localization = make_localization(
                config, world, start, self.lidar.mount, rng
            )
            self._localization_lidar = Lidar(config.lidar, rng)
        self.invalid_commands = 0
        self._sensed: Sensors | None = None

    @property
    def stamp_ns(self) -> int:
        """Time since the start."""
        return self.motion.stamp_ns

    def sense(self) -> Sensors:
        """Return the readings of this instant; a second call returns the same. The scan is the last, with its stamp."""
        if self._sensed is None or self._sensed.stamp_ns != self.stamp_ns:
            odometry = self.read_odometry()
            last = (
                self._sensed.scan
                if self._sensed and self.config.scan_steps > 1
                else None
            )
            due = last is None or self.stamp_ns - last.stamp_ns >= self._scan_period_ns
            scan = self.read_scan() if last is None or due else last
            poses = self.read_truth(), self.read_localization(odometry.pose)
            self._sensed = Sensors(
                self.stamp_ns,
                odometry,
                scan,
                *poses,
                self.read_collision(),
                self.read_joints(),
            )
        return self._sensed

    def step(self, command: Velocity2D | None, delay_ns: int = 0) -> Sensors:
        """Send a command, or none, and return the readings one control period later; it arrives after a delay."""
        if command is not None:
            self.command(command, delay_ns)
        self.advance(self._ticks_per_step)
        return self.sense()

    def command(self, velocity: Velocity2D, delay_ns: int = 0) -> None:
        """Send a command; it arrives after a delay, to the nearest tick, and none sent before it may arrive later."""
        if not velocity.is_finite():
            self.invalid_commands += 1
            velocity = STOP
        tick_ns = self.config.tick_ns  # commands wait for a tick, so that a delay would become longer, never shorter
        arrival_ns = self.stamp_ns + round(delay_ns / tick_ns) * tick_ns
        self.motion.drive.command(
            Velocity2D(float(velocity.linear), float(velocity.angular)), arrival_ns
        )

    def advance(self, ticks: int) -> None:
        """Advance by a number of physics ticks."""
        if self.lidar.sweeps:
            self.motion.remember()
        self.motion.advance(ticks)

    def read_odometry(self) -> Odometry:
        """Return the fused odometry of this instant."""
        return self.motion.odometry.read(self.stamp_ns)

    def read_scan(self, noise: Singles | None = None) -> Scan:
        """Take a scan; every call draws new noise, unless it is given (n,)."""
        return self._scan(self.lidar, noise)

    def read_truth(self) -> Odometry:
        """Return the true pose in the map frame and the true velocity."""
        pose, velocity = self.motion.place()
        return Odometry(self.stamp_ns, pose.through_quaternion(), velocity)

    def read_localization(self, odometry: Pose2D) -> Pose2D:
        """Return the estimated pose in the map frame, given the pose in the odom frame just read."""
        pose, _ = self.motion.place()
        if isinstance(self._localization, ParticleLocalization):
            # with noise of its own, so that no other reading depends on when the filter looks
            pose = self._localization.estimate(
                self.stamp_ns, odometry, lambda: self._scan(self._localization_lidar)
            )
        elif self._localization is not None:
            pose = self._localization.estimate(pose, odometry)
        offset = self.config.localisation
        return Pose2D(
            pose.x + offset.offset_x_m, pose.y + offset.offset_y_m, pose.yaw
        ).through_quaternion()

    def read_collision(self) -> bool:
        """Tell whether the robot has touched anything since the last call."""
        return self.motion.take_touch()

    def read_joints(self) -> Joints:
        """Return the state of the wheels."""
        robot, model = self._fleet.robots[self._index], self.motion.model
        radius, axles = model.wheel_radius_m, len(model.wheels) // 2
        speeds = float(robot["left_m_s"]) / radius, float(robot["right_m_s"]) / radius
        return Joints(
            (float(robot["left_rad"]), float(robot["right_rad"])) * axles,
            speeds * axles,
        )

    def moved_obstacles(self) -> Moved:
        """Return the displaced obstacles, with indices into `World.cylinders_m`."""
        return self.motion.obstacles.moved()

    def _scan(self, lidar: Lidar, noise: Singles | None = None) -> Scan:
        obstacles, movers = self.motion.obstacles, self.motion.movers
        centres, tilted = obstacles.seen_at(self._scan_height_m)
        shapes = (
            None
            if movers is None
            else movers.seen_at(self.stamp_ns, self._scan_height_m)
        )
        pose, _ = self.motion.place()
        sweep = (
            self.motion.poses_at(self.stamp_ns - lidar.ages_ns)
            if lidar.sweeps
            else None
        )
        return lidar.scan(
            self.stamp_ns,
            pose,
            centres,
            obstacles.radius_m,
            tilted,
            shapes,
            noise,
            sweep,
        )

    def close(self) -> None:
        """Release the physics client if the simulator created it; closing again does nothing."""
        if self._own_client is not None:
            self._own_client.close()


def warm_up() -> None:
    """Compile every kernel, or load it from numba's cache, so that the first trial is not seconds slower."""
    grid = np.zeros((9, 3), np.bool_)
    grid[4] = True
    world = World("warm-up", grid, np.array([[0, 0], [0, 1], [0, 2]]))
    x, y = world.obstacles_m[0].tolist()
    for movable in (True, False):
        config = SimulatorConfig(obstacles=ObstacleConfig(movable=movable))
        simulator = Simulator(world, config, Pose2D(x, y - 0.35, 1.57), 0)
        for _ in range(20):
            simulator.step(Velocity2D(1.0, 0.0))
        simulator.close()
    Lidar(config.lidar, np.random.default_rng(0)).scan(
        0,
        Pose2D(0.0, 0.0, 0.0),
        np.ones((1, 2)),
        0.1,
        np.array([[2.0, 0.0, 0.0, 0.6, 0.0, 0.8, 0.5]]),
    )
