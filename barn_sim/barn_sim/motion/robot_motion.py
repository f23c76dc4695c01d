"""How a robot moves through its world from tick to tick, by itself or in PyBullet.

A tick of the physics has two halves. First the drive sets the wheels and the ground acts on the tyres, which is
compiled code of our own (`ticks.advance`) and gives a push: force and torque on the body. Then the body moves under it.

Where nothing is near, the second half is compiled code, too: free motion. A body that touches nothing follows formulae
that Bullet evaluates in a known order; `free_motion` repeats them operation by operation, so that the robot is where
Bullet would have it, to the last bit, in a fraction of the time. `advance` goes on like this until something may be
touched in the tick that has just begun. It then stops in the middle of that tick and returns the push.

Bullet then moves the body under this push, and goes on as long as an obstacle is a body beside the robot's. Bullet is
not told of free motion, so the body is handed over before: `Body.come_back` puts it where the robot is, with all that
Bullet stores of a body. Cylinders and movers become bodies only where the robot is near them (`Obstacles.prepare`,
`Movers.prepare`). Bullet must have moved the robot at least a tick before: in the very tick that makes a body, the
order in which it solves contacts depends on whether the robot's was moved.

Compiled code draws no random numbers, and how many ticks it takes at a time is not known in advance. So the noise of
the odometry's next updates is drawn before (`draw_noise`), each once and in order, and waits in `Fleet.noise`.
"""

import math
from collections import deque

import numpy as np

from barn_sim.body.drive import DriveController
from barn_sim.body.model import model_of
from barn_sim.body.state import Fleet
from barn_sim.config import SimulatorConfig
from barn_sim.contact.bullet import PhysicsClient
from barn_sim.contact.movers import Movers
from barn_sim.contact.obstacles import Obstacles, tick_gap_m
from barn_sim.contact.robot_body import Body
from barn_sim.motion.ticks import Push, advance, free_tick, motion_of
from barn_sim.sensors.odometry import FusedOdometry
from barn_worlds.base.arrays import Floats
from barn_worlds.base.types import Pose2D, Velocity2D
from barn_worlds.worlds.world import World


class RobotMotion:
    """A robot, its odometry and what stands or moves around it; `simulator.Simulator` says what the arguments are.

    drive takes commands. obstacles: the cylinders. movers: walls and moving obstacles, None where there are none.
    """

    def __init__(
        self,
        config: SimulatorConfig,
        client: PhysicsClient,
        fleet: Fleet,
        index: int,
        *,
        free_motion: bool,
    ) -> None:
        self.model = model_of(config.chassis)
        self._config, self._client, self._index, self._free_motion = (
            config,
            client,
            index,
            free_motion,
        )
        self._tick_ns, self._gap_m = config.tick_ns, tick_gap_m(config)
        self._odometry_ns = self._tick_ns * config.ticks(1.0 / config.odometry.rate_hz)
        self._ticks_of_noise = (
            (len(fleet.noise[index]) - 1) * self._odometry_ns // self._tick_ns
        )
        self.drive = DriveController(
            config.drive, self.model.track_m, config.physics.tick_s, fleet, index
        )
        self._body = Body(self.model, config.physics, client, fleet, index)
        self._stamps, self._away, self._known, self._in_bullet = (
            fleet.robots[name] for name in ("stamp_ns", "away", "known", "in_bullet")
        )
        self._past: deque[tuple[int, float, float, float]] = deque(
            maxlen=config.ticks(1.0 / config.lidar.rate_hz) + 2
        )

    def begin(
        self, world: World, start: Pose2D, phase_s: float, rng: np.random.Generator
    ) -> None:
        """Put the robot on the ground of a world, at rest; rng: of the odometry."""
        config, client, fleet, index = (
            self._config,
            self._client,
            self.drive.fleet,
            self._index,
        )
        client.empty()
        moves = bool(world.walls or world.moving)
        # Where obstacles neither move nor can be moved, engines can be left to other robots in between.
        self._fixed = not (config.obstacles.movable or moves)
        self._body.begin(start, stays=self._free_motion and self._fixed)
        self.odometry = FusedOdometry(config.odometry, rng, start.yaw, fleet, index)
        self.obstacles = Obstacles(
            client, self.model, world, config.obstacles, self._gap_m
        )
        self.movers = (
            Movers(client, self.model.extent, world, phase_s, config, self._gap_m)
            if moves
            else None
        )
        robot = fleet.robots[index]
        robot["movers_clearance_m"] = 0.0 if moves else math.inf
        robot["radius_m"] = self.obstacles.radius_m
        robot["near_m"] = self.obstacles.radius_m + self.obstacles.gap_m
        robot["in_bullet"] = not self._free_motion
        self._touched = False
        self._past.clear()
        self._placed: tuple[int, tuple[Pose2D, Velocity2D]] | None = None
        self.odometry.update(0)

    @property
    def stamp_ns(self) -> int:
        """Time since the start."""
        return int(self._stamps[self._index])

    @property
    def free(self) -> bool:
        """Whether the last tick was free motion, which Bullet has not been told of."""
        return bool(self._away[self._index])

    @property
    def undisturbed(self) -> bool:
        """Whether every cylinder stands exactly where it stood, and there is nothing else."""
        return self.obstacles.undisturbed and self.movers is None

    def place(self) -> tuple[Pose2D, Velocity2D]:
        """Return pose and velocity of base_link now."""
        if self._placed is None or self._placed[0] != self.stamp_ns:
            fleet = self.drive.fleet
            x, y, yaw, linear, angular = motion_of(
                fleet.robots, fleet.settings, self._index
            )
            self._placed = (
                self.stamp_ns,
                (Pose2D(x, y, yaw), Velocity2D(linear, angular)),
            )
        return self._placed[1]

    def remember_pose(self) -> None:
        """Store the pose of now, for `poses_at`."""
        pose = self.place()[0]
        self._past.append((self.stamp_ns, pose.x, pose.y, pose.yaw))

    def poses_at(self, stamps_ns: Floats) -> Floats:
        """Return poses (n, 3) of base_link at times up to now, by lines between those remembered."""
        pose = self.place()[0]
        past = np.array([*self._past, (self.stamp_ns, pose.x, pose.y, pose.yaw)])
        past[:, 3] = np.unwrap(past[:, 3])
        return np.column_stack(
            [np.interp(stamps_ns, past[:, 0], past[:, k]) for k in (1, 2, 3)]
        )

    def take_touch(self) -> bool:
        """Tell whether the robot has touched anything since the last call."""
        touched, self._touched = self._touched, False
        return touched

    def advance(self, ticks: int) -> None:
        """Advance by a number of ticks."""
        while ticks:
            some = min(ticks, self._ticks_of_noise)
            self.draw_noise(some)
            self.run(some)
            ticks -= some

    def draw_noise(self, ticks: int) -> None:
        """Have the odometry's noise for so many ticks, at most a control period."""
        now_ns, period_ns = self.stamp_ns, self._odometry_ns
        self.odometry.supply_noise(
            now_ns // period_ns + 1, (now_ns + ticks * self._tick_ns) // period_ns
        )

    def run(self, left: int, push: Push | None = None) -> None:
        """Advance by the ticks left, for which there is noise; push: of the first one, if it has begun already."""
        fleet, segments = self.drive.fleet, self.obstacles.segments
        while left:
            if push is None:
                # free ticks, up to one in which something may be touched: that has begun with a push
                state = fleet.robots, fleet.pending, fleet.settings
                left, push = advance(*state, self._index, segments, fleet.noise, left)
                continue
            if not self._moves_past_movers(push):
                self._move_in_bullet(push)
            left, push = left - 1, None
        if self._fixed and self._away[self._index]:
            self._body.leave()

    def _moves_past_movers(self, push: Push) -> bool:
        """End a tick that has begun by free motion, if a look at the movers shows none of them near; tell whether.

        `advance` knows of movers only how near they may have come since they were looked at last.
        """
        fleet, index = self.drive.fleet, self._index
        if self.movers is None or self._in_bullet[index]:
            return False
        self.movers.look(fleet.robots, index)
        return bool(
            free_tick(
                fleet.robots,
                fleet.settings,
                index,
                self.obstacles.segments,
                fleet.noise,
                push,
            )
        )

    def _move_in_bullet(self, push: Push) -> None:
        """Let Bullet end a tick that has begun, with the body handed over first if it was moved without Bullet."""
        place, centre, force, torque = push
        body, obstacles, index = self._body, self.obstacles, self._index
        if body.id < 0:
            body.enter()
        if self._away[index]:
            body.come_back()
        obstacles.prepare(*place)
        near_mover = self.movers is not None and self.movers.prepare(
            *place, self.stamp_ns
        )
        now = body.move(centre, force, torque)
        if obstacles.awake:
            obstacles.follow(Pose2D(*now))
        among_bodies = obstacles.awake or near_mover
        if among_bodies:
            self._touched = self._touched or obstacles.touched_by(body.id)
        # Deep within another body, Bullet turns the robot as free motion does not: its heading is not known then.
        self._in_bullet[index] = (
            among_bodies or not self._free_motion or not self._known[index]
        )
