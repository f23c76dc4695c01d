"""Simulators that advance together.

One compiled call moves all robots that nothing is near, another reads their sensors.
"""

from dataclasses import dataclass

import numpy as np

from barn_sim.body.state import Fleet
from barn_sim.config import SimulatorConfig
from barn_sim.contact.scene import ScenePool
from barn_sim.motion.lanes import advance_all
from barn_sim.motion.ticks import read_all
from barn_sim.sensors.ray_casting import scan_all
from barn_sim.simulator import Simulator
from barn_worlds.base.arrays import Bools, Floats, Integers, Singles
from barn_worlds.base.types import nanoseconds

_NEVER_NS = -(2**62)
# Scans whose noise is drawn at once.
_SCANS = 16


@dataclass(frozen=True, eq=False)
class Readings:
    """Last readings of n simulators, as `Sensors` has them, in rows."""

    stamps_ns: Integers
    """Times since the start (n,)."""

    truths: Floats
    """x, y and yaw in the map frame (n, 3), m and rad."""

    odometry: Floats
    """x, y and yaw in the odom frame (n, 3), m and rad."""

    velocities: Floats
    """Forward speed and yaw rate of the odometry (n, 2), m/s and rad/s."""

    collisions: Bools
    """Whether each touched anything in its last control period (n,)."""

    ranges: Singles
    """Last scans (n, beams), m."""


class Batch:
    """The common state of simulators with equal configurations.

    Each simulator is created with `fleet`, `scenes` and its own index. Advanced
    together they give the same readings as each by itself, to the last bit. Only
    simulators near an obstacle are advanced one by one.
    """

    fleet: Fleet
    """Keeps the state of the robots."""

    readings: Readings
    """Last readings."""

    scenes: ScenePool
    """Physics clients for contacts, which `close` ends."""

    def __init__(self, count: int, config: SimulatorConfig):
        """Make room for `count` simulators, which `put` adds.

        Args:
            count: Number of simulators.
            config: Their configuration.
        """
        period_ns = nanoseconds(config.control_period_s)
        self._latency_ns = nanoseconds(config.drive.command_latency_s)
        beams = config.lidar.beams
        # One command is sent per period, and each is on its way for the latency.
        self.fleet = Fleet.of(count, self._latency_ns // period_ns + 2)
        self.readings = Readings(
            stamps_ns=np.zeros(count, np.int64),
            truths=np.zeros((count, 3)),
            odometry=np.zeros((count, 3)),
            velocities=np.zeros((count, 2)),
            collisions=np.zeros(count, bool),
            ranges=np.zeros((count, beams), np.float32),
        )
        self.scenes = ScenePool()
        self._simulators: dict[int, Simulator] = {}
        self._ticks = config.ticks(config.control_period_s)

        self._scan_period_ns = config.scan_steps * period_ns
        self._scanned_ns = np.zeros(count, np.int64)
        self._has_plain_lidars = True
        self._noise = np.empty((count, _SCANS, beams), np.float32)
        # Rows of the noise that are used up.
        self._used_noise = np.zeros(count, np.int64)

        # Cylinders of each robot's world: axes from above, and centers if upright.
        self._segments = np.zeros((count, 0, 4))
        self._circles = np.zeros((count, 2, 0))
        self._cylinders = np.zeros(count, np.int64)
        self._disturbed: set[int] = set()

    def put(self, index: int, simulator: Simulator) -> None:
        """Set the simulator of a fleet row; the one that was there is not closed.

        Args:
            index: Its row in the fleet.
            simulator: Simulator that has just begun.
        """
        self._simulators[index] = simulator
        # All have one configuration, so the last one speaks for all.
        self._has_plain_lidars = simulator.lidar.is_plain
        self._scanned_ns[index] = _NEVER_NS
        # Used up: the new simulator's own generator fills the rows before its first
        # scan.
        self._used_noise[index] = _SCANS
        self.readings.collisions[index] = False
        self._disturbed.discard(index)
        self._copy_cylinders(index)

    def _copy_cylinders(self, index: int) -> None:
        """Copy the cylinders of a simulator to its row; note whether any has moved."""
        simulator = self._simulators[index]
        segments = simulator.motion.obstacles.segments
        count = len(segments)
        # Worlds differ in their number of cylinders; rows beyond a world's own are not
        # read.
        missing = count - self._segments.shape[1]
        if missing > 0:
            self._segments = np.pad(self._segments, ((0, 0), (0, missing), (0, 0)))
            self._circles = np.pad(self._circles, ((0, 0), (0, 0), (0, missing)))
        self._segments[index, :count] = segments
        self._circles[index, :, :count] = segments[:, :2].T
        self._cylinders[index] = count
        if not simulator.motion.is_undisturbed:
            self._disturbed.add(index)

    def advance(self, indices: Integers, commands: Floats) -> None:
        """Advance rows a control period by `commands` (all rows, 2); set collisions.

        The other readings change only in `read`.

        Args:
            indices: Rows of the simulators that advance.
            commands: Finite speed (m/s) and yaw rate (rad/s) of all (n, 2).
        """
        fleet = self.fleet
        collisions = self.readings.collisions
        collisions[indices] = False

        # Noise of the odometry must wait before compiled code needs it.
        end_ns = (
            fleet.robots["stamp_ns"][indices] + self._ticks * fleet.settings["tick_ns"]
        )
        last_update = end_ns // fleet.settings["odometry_ns"]
        supplied = fleet.robots["noise_from"][indices] + fleet.noise.shape[1]
        for index in indices[last_update >= supplied].tolist():
            self._simulators[index].motion.draw_noise(self._ticks)
        if not self._has_plain_lidars:
            for index in indices.tolist():
                self._simulators[index].motion.remember_pose()

        left = np.zeros(len(commands), np.int64)
        advance_all(
            fleet,
            self._segments,
            self._cylinders,
            self._ticks,
            indices,
            commands,
            self._latency_ns,
            left,
        )
        for index in left.nonzero()[0].tolist():
            simulator = self._simulators[index]
            simulator.motion.run(int(left[index]))
            collisions[index] = simulator.read_collision()
            if not simulator.motion.is_undisturbed:
                self._copy_cylinders(index)

    def read(self, indices: Integers) -> None:
        """Write time, poses, velocities and any due scans of rows to `readings`.

        Args:
            indices: Rows of the simulators to read.
        """
        readings = self.readings
        now_ns = self.fleet.robots["stamp_ns"][indices]
        is_due = now_ns - self._scanned_ns[indices] >= self._scan_period_ns
        scanning = indices[is_due]
        self._scanned_ns[scanning] = now_ns[is_due]
        if self._has_plain_lidars:
            self._scan(scanning)
        else:
            for index in scanning.tolist():
                readings.ranges[index] = self._simulators[index].read_scan().ranges
        read_all(
            self.fleet.robots,
            indices,
            readings.stamps_ns,
            readings.truths,
            readings.odometry,
            readings.velocities,
        )

    def _scan(self, indices: Integers) -> None:
        """Write new scans to `readings.ranges`, one by one where cylinders moved."""
        ranges = self.readings.ranges
        used = self._used_noise
        for index in indices[used[indices] == _SCANS].tolist():
            self._simulators[index].lidar.draw_noise(self._noise[index])
            used[index] = 0

        # Circles of this batch know only upright cylinders at home.
        disturbed = sorted(self._disturbed.intersection(indices.tolist()))
        for index in disturbed:
            noise = self._noise[index, used[index]]
            ranges[index] = self._simulators[index].read_scan(noise).ranges
            used[index] += 1

        if disturbed:
            indices = np.setdiff1d(indices, disturbed, assume_unique=True)
        if len(indices):
            lidar = self._simulators[int(indices[0])].lidar
            scan_all(
                self.fleet.robots,
                indices,
                self._circles,
                self._cylinders,
                lidar.directions,
                lidar.fan,
                lidar.mount.numbers,
                lidar.limits,
                self._noise,
                used,
                ranges,
            )

    def close(self) -> None:
        """Close all simulators and the physics clients."""
        for simulator in self._simulators.values():
            simulator.close()
        self.scenes.close()
