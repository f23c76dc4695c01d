"""The simulator core: one robot in one world for one trial."""

import math

import numpy as np

from barn_sim.body.body import Body
from barn_sim.body.bullet import PhysicsClient
from barn_sim.body.drive import DriveController
from barn_sim.body.model import model_of
from barn_sim.body.movers import Movers
from barn_sim.body.obstacles import Cylinders, Moved, Obstacles, tick_gap_m
from barn_sim.body.phase import phase_s
from barn_sim.config import ObstacleConfig, SimulatorConfig
from barn_sim.motion.free_motion import Triple
from barn_sim.motion.readouts import motion, wheels
from barn_sim.motion.state import ROBOT, Fleet
from barn_sim.motion.ticks import Push, advance, free_tick, keep_on
from barn_sim.sensors.estimates import FilterLocalisation, FusedOdometry
from barn_sim.sensors.lidar import Lidar, Singles
from barn_sim.sensors.localisation import localisation_of
from barn_sim.sensors.particles import ParticleLocalisation
from barn_sim.sensors.readings import Joints, Sensors
from barn_worlds.base.arrays import Floats
from barn_worlds.base.twin import twin
from barn_worlds.base.types import STOP, Odometry, Pose2D, Scan, Velocity2D
from barn_worlds.worlds.world import World

_LIDAR, _ODOMETRY, _LOCALISATION = range(3)  # children of the seed


class Simulator:
    """A robot in a world, from a start pose and a seed, in a physics client of its own.

    Equal arguments and commands give equal readings, to the last bit. Use `step` and `sense`; or, to read sensors at
    different rates, `command`, `advance` and the `read_` methods. Each sensor has its own random generator, so that one
    does not affect another.

    invalid_commands: how many commands were not numbers, each of which stops the robot. phase_s: time into the motions
    of moving obstacles at the start.
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

        client: emptied and used instead of a new one, which is faster for trial after trial and gives the same
        readings. A simulator that used it before is finished. The caller closes it. free_motion: integrate the motion
        without PyBullet where no obstacle is near, which gives the same bits faster; false: leave every tick to
        PyBullet. fleet, index: whose state it keeps; a robot of its own without them. Raises ConfigError for a robot
        that is not simulated.
        """
        self.config = config
        self._world, self._start = world, start
        self._model = model = model_of(config.chassis)
        self._fixed = not (config.obstacles.movable or world.walls or world.moving)
        self._free_motion = free_motion
        self._scan_height_m = config.lidar.mount_z_m - float(model.footing[2])
        self._tick_ns = config.tick_ns
        self._ticks_per_step = config.ticks(config.control_period_s)
        self._odometry_ns = self._tick_ns * config.ticks(1.0 / config.odometry.rate_hz)
        fleet = Fleet.of(1) if fleet is None else fleet
        self._ticks_per_supply = (len(fleet.noise[index]) - 1) * self._odometry_ns // self._tick_ns
        self._at_rest = np.zeros((), ROBOT)
        fleet.robots[index] = self._at_rest
        client = self._emptied(client)
        self.lidar = Lidar(config.lidar, _generator(seed, _LIDAR))
        self._odometry = FusedOdometry(config.odometry, _generator(seed, _ODOMETRY), start.yaw, fleet, index)
        tick_s, gap_m = config.physics.tick_s, tick_gap_m(config)
        self._drive = DriveController(config.drive, model.track_m, tick_s, fleet, index)
        stays = free_motion and self._fixed
        self._body = Body(model, config.physics, start, client, fleet, index, stays=stays)
        cylinders = _cylinders(world, config)
        self._obstacles = Obstacles(
            client, model.extent(), cylinders, config.obstacles, gap_m, passed=bool(world.moving)
        )
        fleet.robots["movers_clearance_m"][index] = 0.0 if world.walls or world.moving else math.inf
        fleet.robots["radius_m"][index] = cylinders.radius_m
        fleet.robots["near_m"][index] = cylinders.radius_m + gap_m
        fleet.robots["in_bullet"][index] = not free_motion
        self._at_rest[()] = fleet.robots[index]
        self._begin(seed, client, fleet, index)

    def again(
        self, seed: int, client: PhysicsClient | None = None, *, fleet: Fleet | None = None, index: int = 0
    ) -> "Simulator":
        """Return a simulator of the same world, configuration and start, in a fraction of the time of a new one."""
        other = twin(self)
        if fleet is None:
            fleet = Fleet.of(1)
            fleet.settings[0] = self._drive.fleet.settings[0]
        fleet.robots[index] = self._at_rest
        client = other._emptied(client)
        other.lidar = self.lidar.again(_generator(seed, _LIDAR))
        other._odometry = self._odometry.again(_generator(seed, _ODOMETRY), fleet, index)
        other._drive = self._drive.again(fleet, index)
        other._body = self._body.again(client, fleet, index)
        other._obstacles = self._obstacles.again(client)
        other._begin(seed, client, fleet, index)
        return other

    def _emptied(self, client: PhysicsClient | None) -> PhysicsClient:
        """Return the client to use, one of its own if none is given."""
        self._own_client = PhysicsClient() if client is None else None
        if client is not None:
            client.empty()
            return client
        assert self._own_client is not None
        return self._own_client

    def _begin(self, seed: int, client: PhysicsClient, fleet: Fleet, index: int) -> None:
        """Begin a trial with what was made for it."""
        config, world = self.config, self._world
        self._index = index
        names = ("stamp_ns", "away", "known", "in_bullet")
        self._stamps, self._away, self._known, self._in_bullet = (fleet.robots[name] for name in names)
        self._localisation: FilterLocalisation | ParticleLocalisation | None = None
        if config.localisation.mode != "exact":
            rng = _generator(seed, _LOCALISATION)
            self._localisation = localisation_of(config, world, self._start, self.lidar.mount, rng)
            if isinstance(self._localisation, ParticleLocalisation):
                self._localisation_lidar = Lidar(config.lidar, rng)
        self.phase_s = phase_s(world, config.obstacles.random_phase, seed)
        self._movers = (
            Movers(client, self._model.extent(), world, self.phase_s, config) if (world.walls or world.moving) else None
        )
        self.invalid_commands = 0
        self._collision = False
        self._sensed: Sensors | None = None
        self._moved: tuple[int, tuple[Pose2D, Velocity2D]] | None = None
        self._odometry.update(0)

    def sense(self) -> Sensors:
        """Return the readings of this instant; a second call returns the same."""
        if self._sensed is None or self._sensed.stamp_ns != self.stamp_ns:
            odometry = self.read_odometry()
            self._sensed = Sensors(
                self.stamp_ns,
                odometry,
                self.read_scan(),
                self.read_truth(),
                self.read_localisation(odometry.pose),
                self.read_collision(),
                self.read_joints(),
            )
        return self._sensed

    def step(self, command: Velocity2D | None) -> Sensors:
        """Send a command, or none, and return the readings one control period later."""
        if command is not None:
            self.command(command)
        self.advance(self._ticks_per_step)
        return self.sense()

    def command(self, velocity: Velocity2D) -> None:
        """Send a command; it arrives now."""
        if not velocity.is_finite():
            self.invalid_commands += 1
            velocity = STOP
        self._drive.command(Velocity2D(float(velocity.linear), float(velocity.angular)), self.stamp_ns)

    def advance(self, ticks: int) -> None:
        """Advance by a number of physics ticks."""
        while ticks:
            some = min(ticks, self._ticks_per_supply)
            self.supply(some)
            self.go_on(some)
            ticks -= some

    def supply(self, ticks: int) -> None:
        """Have noise for so many ticks, at most a control period."""
        now_ns, period_ns = self.stamp_ns, self._odometry_ns
        self._odometry.supply(now_ns // period_ns + 1, (now_ns + ticks * self._tick_ns) // period_ns)

    def go_on(self, left: int, push: Push | None = None) -> None:
        """Advance by the ticks left, for which there is noise; push: how the first one has begun, if it has."""
        index, obstacles, wakes = self._index, self._obstacles, True
        while left:
            if push is None:
                fleet = self._drive.fleet
                left, push = advance(
                    fleet.robots, fleet.pending, fleet.settings, index, obstacles.segments, fleet.noise, left
                )
            if left and self._fixed:
                left, push, wakes = self._move_among_fixed(left - 1, push, wakes)
            elif left:
                if self._movers is None or not self._move_past(self._movers, push):
                    self._move_in_bullet(*push)
                left, push = left - 1, None
        if self._fixed and self._away[index]:
            self._body.leave()

    def _move_past(self, movers: Movers, push: Push) -> bool:
        """Look where the movers are; end a tick that has begun without PyBullet, if nothing is near; tell whether."""
        fleet, index = self._drive.fleet, self._index
        if self._in_bullet[index]:
            return False
        movers.look(fleet.robots, index)
        return bool(free_tick(fleet.robots, fleet.settings, index, self._obstacles.segments, fleet.noise, push))

    def _move_in_bullet(self, place: Triple, centre: Triple, force: Triple, torque: Triple) -> None:
        """Let PyBullet end a tick that has begun."""
        body, obstacles, index = self._body, self._obstacles, self._index
        self._hand_over()
        obstacles.prepare(*place)
        awake = self._movers is not None and self._movers.prepare(*place, self.stamp_ns)
        now = body.move(centre, force, torque)
        if obstacles.awake:
            obstacles.follow(Pose2D(*now))
        if obstacles.awake or awake:
            self._collision = self._collision or obstacles.touched_by(body.id)
        self._in_bullet[index] = obstacles.awake or awake or not self._free_motion or not self._known[index]

    def _move_among_fixed(self, left: int, push: Push, wakes: bool) -> tuple[int, Push, bool]:
        """Let PyBullet end a tick that has begun, and advance by the ticks left until it has to move the body again.

        wakes: whether a cylinder may be so near that it becomes a body. Returns ticks left, how the next has begun, and
        whether a cylinder is so near then.
        """
        body, obstacles, fleet, index = self._body, self._obstacles, self._drive.fleet, self._index
        self._hand_over()
        if wakes:
            obstacles.prepare(*push[0])
        moved, awake = body.pushed(*push[1:]), obstacles.awake
        left, push, touches, wakes = keep_on(
            fleet.robots, fleet.pending, fleet.settings, index, obstacles.segments, fleet.noise, left, moved,
            obstacles.bodied, awake or not self._free_motion,
        )  # fmt: skip
        if awake:
            obstacles.dismiss(Pose2D(*push[0]))
            self._collision = self._collision or (touches and obstacles.touched_by(body.id))
        return left, push, wakes

    def _hand_over(self) -> None:
        """Let PyBullet have the body where it is now."""
        if self._body.id < 0:
            self._body.enter()
        if self._away[self._index]:
            self._body.come_back()

    @property
    def stamp_ns(self) -> int:
        """Time since the start."""
        return int(self._stamps[self._index])

    @property
    def _pose(self) -> Pose2D:
        return self._motion()[0]

    def _motion(self) -> tuple[Pose2D, Velocity2D]:
        """Return pose and velocity of base_link now."""
        stamp_ns = self.stamp_ns
        if self._moved is None or self._moved[0] != stamp_ns:
            fleet = self._drive.fleet
            x, y, yaw, linear, angular = motion(fleet.robots, fleet.settings, self._index)
            self._moved = stamp_ns, (Pose2D(x, y, yaw), Velocity2D(linear, angular))
        return self._moved[1]

    @property
    def segments(self) -> Floats:
        """Axes of the cylinders seen from above, (n, 4) m; those that stand begin with their centres."""
        return self._obstacles.segments

    @property
    def undisturbed(self) -> bool:
        """Whether every cylinder stands exactly where it stood, and there is nothing else."""
        return self._obstacles.undisturbed and self._movers is None

    def read_odometry(self) -> Odometry:
        """Return the fused odometry of this instant."""
        pose, velocity = self._motion()
        return self._odometry.read(self.stamp_ns, pose.yaw, velocity.angular)

    def read_scan(self, noise: Singles | None = None) -> Scan:
        """Take a scan; every call draws new noise, unless it is given (n,)."""
        return self._scan(self.lidar, noise)

    def read_truth(self) -> Odometry:
        """Return the true pose in the map frame and the true velocity."""
        pose, velocity = self._motion()
        return Odometry(self.stamp_ns, pose.through_quaternion(), velocity)

    def read_localisation(self, odometry: Pose2D) -> Pose2D:
        """Return the estimated pose in the map frame, given the pose in the odom frame just read."""
        pose = self._pose
        if isinstance(self._localisation, ParticleLocalisation):
            # with noise of its own, so that no other reading depends on when the filter looks
            pose = self._localisation.estimate(self.stamp_ns, odometry, lambda: self._scan(self._localisation_lidar))
        elif self._localisation is not None:
            pose = self._localisation.estimate(pose, odometry)
        offset = self.config.localisation
        return Pose2D(pose.x + offset.offset_x_m, pose.y + offset.offset_y_m, pose.yaw).through_quaternion()

    def read_collision(self) -> bool:
        """Tell whether the robot has touched anything since the last call."""
        touched, self._collision = self._collision, False
        return touched

    def read_joints(self) -> Joints:
        """Return the state of the wheels."""
        fleet, model = self._drive.fleet, self._model
        left_rad, right_rad, left, right = wheels(fleet.robots, self._index)
        radius = model.wheel_radius_m
        axles = len(model.wheels) // 2
        return Joints((left_rad, right_rad) * axles, (left / radius, right / radius) * axles)

    def moved_obstacles(self) -> Moved:
        """Return the displaced obstacles, with indices into `World.cylinders_m`."""
        return self._obstacles.moved()

    def _scan(self, lidar: Lidar, noise: Singles | None = None) -> Scan:
        centres, tilted = self._obstacles.seen_at(self._scan_height_m)
        shapes = None if self._movers is None else self._movers.seen_at(self.stamp_ns, self._scan_height_m)
        return lidar.scan(self.stamp_ns, self._pose, centres, self._obstacles.radius_m, tilted, shapes, noise)

    def close(self) -> None:
        """Release the physics client if the simulator created it; closing again does nothing."""
        if self._own_client is not None:
            self._own_client.close()


def _generator(seed: int, child: int) -> np.random.Generator:
    """Return a generator of a child of a seed, as `SeedSequence(seed).spawn` has it."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(child,))))


def _cylinders(world: World, config: SimulatorConfig) -> Cylinders:
    movable = np.zeros(len(world.cylinders_m), np.bool_)
    if config.obstacles.movable:
        grid = len(world.obstacles_m)
        movable[:grid] = True
        movable[grid:] = config.obstacles.containment_movable
    return Cylinders(world.cylinders_m, movable, world.cylinder_radius_m, world.cylinder_height_m)


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
        0, Pose2D(0.0, 0.0, 0.0), np.ones((1, 2)), 0.1, np.array([[2.0, 0.0, 0.0, 0.6, 0.0, 0.8, 0.5]])
    )
