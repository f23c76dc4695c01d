"""Simulators that advance together: one compiled call moves them all, another reads their sensors."""

from dataclasses import dataclass

import numpy as np

from barn_sim.body.state import Fleet
from barn_sim.config import SimulatorConfig
from barn_sim.contact.bullet import PhysicsEngine, end
from barn_sim.motion.lanes import advance_all
from barn_sim.motion.ticks import read_all
from barn_sim.sensors.ray_casting import scan_all
from barn_sim.simulator import Simulator
from barn_worlds.base.arrays import Bools, Floats, Integers, Singles
from barn_worlds.base.types import nanoseconds

_NEVER_NS = -(2**62)
_AHEAD = 16  # scans whose noise is drawn at once


@dataclass(frozen=True, eq=False)
class Readings:
    """Last readings of n simulators, as `Sensors` has them, in rows.

    stamps_ns (n,); truths, odometry (n, 3): x, y, yaw in the map and the odom frame; velocities (n, 2): forward speed
    and yaw rate as the odometry measures them; collisions (n,); ranges (n, beams).
    """

    stamps_ns: Integers
    truths: Floats
    odometry: Floats
    velocities: Floats
    collisions: Bools
    ranges: Singles

    @classmethod
    def of(cls, count: int, beams: int) -> "Readings":
        """Return readings of which nothing is known yet."""
        poses, ranges = np.zeros((2, count, 3)), np.zeros((count, beams), np.float32)
        return cls(
            np.zeros(count, np.int64),
            poses[0],
            poses[1],
            np.zeros((count, 2)),
            np.zeros(count, bool),
            ranges,
        )


class Batch:
    """The common state of `count` simulators with equal configurations, each made with `fleet` and its own index.

    Advanced together they give the same readings as each by itself, to the last bit. Only simulators near an obstacle
    are advanced one by one. engines: of PyBullet, which they share.
    """

    def __init__(self, count: int, config: SimulatorConfig) -> None:
        self._latency_ns = nanoseconds(config.drive.command_latency_s)
        self.fleet = Fleet.of(
            count, self._latency_ns // nanoseconds(config.control_period_s) + 2
        )
        self.readings = Readings.of(count, config.lidar.beams)
        self.engines: list[PhysicsEngine] = []
        self._ticks = config.ticks(config.control_period_s)
        self._scan_ns = (
            config.scan_steps * nanoseconds(config.control_period_s)
            if config.scan_steps > 1
            else 0
        )
        self._scanned_ns = np.zeros(count, np.int64)
        self._plain = True
        self._simulators: dict[int, Simulator] = {}
        self._segments = np.zeros((count, 0, 4))
        self._circles = np.zeros((count, 2, 0))
        self._cylinders = np.zeros(count, np.int64)
        self._disturbed: set[int] = set()
        self._noise = np.empty((count, _AHEAD, config.lidar.beams), np.float32)
        self._drawn = np.zeros(count, np.int64)  # rows of the noise that are used up

    def put(self, index: int, simulator: Simulator) -> None:
        """Take a simulator into the batch, instead of the one that was there."""
        self._simulators[index] = simulator
        self._plain, self._scanned_ns[index] = simulator.lidar.is_plain, _NEVER_NS
        self._drawn[index] = _AHEAD
        self.readings.collisions[index] = False
        self._disturbed.discard(index)
        self._look_at(index)

    def _look_at(self, index: int) -> None:
        """Take over where the cylinders of a simulator are."""
        simulator = self._simulators[index]
        segments = simulator.motion.obstacles.segments
        missing = len(segments) - self._segments.shape[1]
        if missing > 0:
            self._segments = np.pad(self._segments, ((0, 0), (0, missing), (0, 0)))
            self._circles = np.pad(self._circles, ((0, 0), (0, 0), (0, missing)))
        self._segments[index, : len(segments)] = segments
        self._circles[index, :, : len(segments)] = segments[:, :2].T
        self._cylinders[index] = len(segments)
        if not simulator.motion.undisturbed:
            self._disturbed.add(index)

    def advance(self, which: Integers, commands: Floats) -> None:
        """Give the simulators `which` their finite commands (n, 2), advance a control period, read collisions."""
        fleet, readings = self.fleet, self.readings
        robots, settings = fleet.robots, fleet.settings
        readings.collisions[which] = False
        last = (
            robots["stamp_ns"][which] + self._ticks * settings["tick_ns"]
        ) // settings["odometry_ns"]
        for index in which[
            last >= robots["noise_from"][which] + fleet.noise.shape[1]
        ].tolist():
            self._simulators[index].motion.draw_noise(self._ticks)
        if not self._plain:
            for index in which.tolist():
                self._simulators[index].motion.remember_pose()
        left, pushes = (
            np.zeros(len(commands), np.int64),
            np.zeros((len(commands), 4, 3)),
        )
        advance_all(
            robots, fleet.pending, settings, self._segments, self._cylinders, fleet.noise, self._ticks, which, commands,
            self._latency_ns, left, pushes,
        )  # fmt: skip
        for index in left.nonzero()[0].tolist():
            simulator = self._simulators[index]
            place, centre, force, torque = (
                tuple(row) for row in pushes[index].tolist()
            )
            simulator.motion.run(int(left[index]), (place, centre, force, torque))
            readings.collisions[index] = simulator.read_collision()
            if not simulator.motion.undisturbed:
                self._look_at(index)

    def read(self, which: Integers) -> None:
        """Read the sensors; simulators whose cylinders have moved take their scans themselves."""
        readings, drawn = self.readings, self._drawn
        now_ns = self.fleet.robots["stamp_ns"][which]
        due = (
            now_ns - self._scanned_ns[which] >= self._scan_ns
        )  # the others keep their last scans
        scanned = which[due]
        self._scanned_ns[scanned] = now_ns[due]
        if not self._plain:
            for index in scanned.tolist():
                readings.ranges[index] = self._simulators[index].read_scan().ranges
            scanned = scanned[:0]
        for index in scanned[drawn[scanned] == _AHEAD].tolist():
            self._simulators[index].lidar.draw_noise(self._noise[index])
            drawn[index] = 0
        others = (
            sorted(self._disturbed.intersection(scanned.tolist()))
            if self._disturbed
            else []
        )
        for index in others:
            readings.ranges[index] = (
                self._simulators[index]
                .read_scan(self._noise[index, drawn[index]])
                .ranges
            )
            drawn[index] += 1
        upright = (
            np.setdiff1d(scanned, others, assume_unique=True) if others else scanned
        )
        if len(upright):
            lidar = self._simulators[int(upright[0])].lidar
            mount = lidar.mount.x, lidar.mount.y, lidar.mount.yaw
            scan_all(
                self.fleet.robots, upright, self._circles, self._cylinders, lidar.directions, lidar.fan, mount,
                lidar.limits, self._noise, drawn, readings.ranges,
            )  # fmt: skip
        read_all(
            self.fleet.robots,
            which,
            readings.stamps_ns,
            readings.truths,
            readings.odometry,
            readings.velocities,
        )

    def close(self) -> None:
        """End the engines."""
        end(self.engines)
