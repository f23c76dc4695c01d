"""Simulators that advance together: one compiled call moves them all, another reads their sensors."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from barn_sim.body.bullet import PhysicsEngine, end
from barn_sim.body.cylinders import Bools
from barn_sim.config import SimulatorConfig
from barn_sim.motion.lanes import advance_all
from barn_sim.motion.readouts import read_all
from barn_sim.motion.state import Fleet
from barn_sim.motion.ticks import without_noise
from barn_sim.sensors.lidar import Lidar, Singles, scan_all
from barn_sim.simulator import Simulator
from barn_worlds.base.arrays import Floats, Integers
from barn_worlds.base.types import nanoseconds

_AHEAD = 8  # scans whose noise is drawn at once


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
        return cls(
            np.zeros(count, np.int64),
            np.zeros((count, 3)),
            np.zeros((count, 3)),
            np.zeros((count, 2)),
            np.zeros(count, np.bool_),
            np.zeros((count, beams), np.float32),
        )


class Batch:
    """The common state of `count` simulators with equal configurations, each made with `fleet` and its own index.

    Advanced together they give the same readings as each by itself, to the last bit. Only simulators near an obstacle
    are advanced one by one. threads: among which the robots are divided. engines: of PyBullet, which they share.
    """

    def __init__(self, count: int, config: SimulatorConfig, threads: int = 1) -> None:
        self._latency_ns = nanoseconds(config.drive.command_latency_s)
        self.fleet = Fleet.of(count, self._latency_ns // nanoseconds(config.control_period_s) + 2)
        self.readings = Readings.of(count, config.lidar.beams)
        self.engines: list[PhysicsEngine] = []
        self._ticks = config.ticks(config.control_period_s)
        self._simulators: list[Simulator | None] = [None] * count
        self._segments = np.zeros((count, 0, 4))
        self._circles = np.zeros((count, 2, 0))
        self._cylinders = np.zeros(count, np.int64)
        self._disturbed: set[int] = set()
        self._noise = np.empty((count, _AHEAD, config.lidar.beams), np.float32)
        self._drawn = np.zeros(count, np.int64)  # rows of the noise that are used up
        self._ends = np.linspace(0, count, min(threads, count) + 1).astype(np.int64)[1:]
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None

    def put(self, index: int, simulator: Simulator) -> None:
        """Take a simulator into the batch, instead of the one that was there."""
        self._simulators[index] = simulator
        self._drawn[index] = _AHEAD
        self.readings.collisions[index] = False
        self._disturbed.discard(index)
        self._look_at(index)

    def _simulator(self, index: int) -> Simulator:
        simulator = self._simulators[index]
        assert simulator is not None
        return simulator

    def _look_at(self, index: int) -> None:
        """Take over where the cylinders of a simulator are."""
        simulator = self._simulator(index)
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

    def step(self, which: Integers, commands: Floats) -> None:
        """Give the simulators `which` their rows of commands (n, 2), finite; advance and read them a period later."""
        self.advance(which, commands)
        self.read(which)

    def advance(self, which: Integers, commands: Floats) -> None:
        """Do as `step` without reading anything but collisions."""
        fleet, readings = self.fleet, self.readings
        readings.collisions[which] = False
        for index in without_noise(fleet.robots, fleet.settings, which, self._ticks, fleet.noise.shape[1]).tolist():
            self._simulator(index).motion.draw_noise(self._ticks)
        left, pushes = np.zeros(len(commands), np.int64), np.zeros((len(commands), 4, 3))
        self._in_parts(which, self._advance, commands, left, pushes)
        for index in np.flatnonzero(left).tolist():
            simulator = self._simulator(index)
            place, centre, force, torque = (tuple(row) for row in pushes[index].tolist())
            simulator.motion.run(int(left[index]), (place, centre, force, torque))
            readings.collisions[index] = simulator.read_collision()
            if not simulator.motion.undisturbed:
                self._look_at(index)

    def _advance(self, part: Integers, commands: Floats, left: Integers, pushes: Floats) -> None:
        fleet = self.fleet
        advance_all(
            fleet.robots, fleet.pending, fleet.settings, self._segments, self._cylinders, fleet.noise, self._ticks,
            part, commands, self._latency_ns, left, pushes,
        )  # fmt: skip

    def read(self, which: Integers) -> None:
        """Read the sensors; simulators whose cylinders have moved take their scans themselves."""
        readings, drawn = self.readings, self._drawn
        for index in which[drawn[which] == _AHEAD].tolist():
            self._simulator(index).lidar.draw(self._noise[index])
            drawn[index] = 0
        upright = which
        if self._disturbed:
            others = sorted(self._disturbed.intersection(which.tolist()))
            for index in others:
                readings.ranges[index] = self._simulator(index).read_scan(self._noise[index, drawn[index]]).ranges
                drawn[index] += 1
            upright = np.setdiff1d(which, others, assume_unique=True)
        if len(upright):
            self._in_parts(upright, self._scan, self._simulator(int(upright[0])).lidar)
        read_all(self.fleet.robots, which, readings.stamps_ns, readings.truths, readings.odometry, readings.velocities)

    def _scan(self, part: Integers, lidar: Lidar) -> None:
        mount = lidar.mount.x, lidar.mount.y, lidar.mount.yaw
        scan_all(
            self.fleet.robots, part, self._circles, self._cylinders, lidar.directions, lidar.fan, mount,
            lidar.limits, self._noise, self._drawn, self.readings.ranges,
        )  # fmt: skip

    def _in_parts(self, which: Integers, work: Callable[..., None], *arguments: object) -> None:
        """Do work for the robots `which`, ascending, in every part at the same time."""
        if self._pool is None:
            work(which, *arguments)
            return
        parts = np.split(which, np.searchsorted(which, self._ends[:-1]))
        for done in [self._pool.submit(work, part, *arguments) for part in parts if len(part)]:
            done.result()

    def close(self) -> None:
        """End the threads, and the engines."""
        end(self.engines)
        if self._pool is not None:
            self._pool.shutdown()
