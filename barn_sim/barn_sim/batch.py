"""Simulators that advance together: one compiled call moves them all, another takes their scans."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from barn_sim.config import SimulatorConfig
from barn_sim.lidar import Lidar, Singles, scan_all
from barn_sim.nearness import Bools
from barn_sim.simulator import Simulator
from barn_sim.state import Fleet
from barn_sim.ticks import advance_all
from barn_worlds.arrays import Floats, Integers
from barn_worlds.types import nanoseconds


class Batch:
    """The common state of `count` simulators with equal configurations, each made with `fleet` and its own index.

    Advanced together they give the same readings as each by itself, to the last bit. threads: among which the robots
    are divided.
    """

    def __init__(self, count: int, config: SimulatorConfig, threads: int = 1) -> None:
        latency_ns, period_ns = nanoseconds(config.drive.command_latency_s), nanoseconds(config.control_period_s)
        self.fleet = Fleet.of(count, latency_ns // period_ns + 2)
        self._config = config
        self._ticks = config.ticks(config.control_period_s)
        self._simulators: list[Simulator | None] = [None] * count
        self._segments = np.zeros((count, 0, 4))
        self._cylinders = np.zeros(count, np.int64)
        self._parts = [part for part in np.array_split(np.arange(count), threads) if len(part)]
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None

    def put(self, index: int, simulator: Simulator) -> None:
        """Take a simulator into the batch, instead of the one that was there."""
        self._simulators[index] = simulator
        self._copy_segments(index, simulator)

    def _copy_segments(self, index: int, simulator: Simulator) -> None:
        segments = simulator.segments
        missing = len(segments) - self._segments.shape[1]
        if missing > 0:
            self._segments = np.pad(self._segments, ((0, 0), (0, missing), (0, 0)))
        self._segments[index, : len(segments)] = segments
        self._cylinders[index] = len(segments)

    def advance(self, indices: Sequence[int]) -> None:
        """Advance these simulators by a control period and take the scan that each of them reads next."""
        chosen = [(index, simulator) for index in indices if (simulator := self._simulators[index]) is not None]
        for _, simulator in chosen:
            simulator.supply(self._ticks)
        which = np.zeros(len(self._simulators), np.bool_)
        which[[index for index, _ in chosen]] = True
        left, pushes = np.zeros(len(which), np.int64), np.zeros((len(which), 4, 3))
        self._in_parts(which, self._advance, left, pushes)
        for index, simulator in chosen:
            if left[index]:
                place, centre, force, torque = (tuple(row) for row in pushes[index].tolist())
                simulator.go_on(int(left[index]), (place, centre, force, torque))
                self._copy_segments(index, simulator)
        self._scan(chosen)

    def _advance(self, part: Integers, which: Bools, left: Integers, pushes: Floats) -> None:
        fleet = self.fleet
        advance_all(
            fleet.robots, fleet.pending, fleet.settings, self._segments, self._cylinders, fleet.noise, self._ticks,
            part[which[part]], left, pushes,
        )  # fmt: skip

    def _scan(self, chosen: list[tuple[int, Simulator]]) -> None:
        """Take scans of all whose cylinders stand where they stood; the others take theirs themselves."""
        upright = [(index, simulator) for index, simulator in chosen if simulator.undisturbed]
        if not upright:
            return
        lidar = upright[0][1].lidar
        count = len(self._simulators)
        noise = np.empty((count, self._config.lidar.beams), np.float32)
        which = np.zeros(count, np.bool_)
        for index, simulator in upright:
            which[index] = True
            simulator.lidar.draw(noise[index])
        measured = np.empty_like(noise)
        self._in_parts(which, self._scan_part, lidar, noise, measured)
        for index, simulator in upright:
            simulator.take(measured[index])

    def _scan_part(self, part: Integers, which: Bools, lidar: Lidar, noise: Singles, measured: Singles) -> None:
        scan_all(
            self.fleet.robots, part[which[part]], self._segments, self._cylinders, lidar.directions, lidar.fan,
            lidar.mount_x_m, lidar.limits, noise, measured,
        )  # fmt: skip

    def _in_parts(self, which: Bools, work: Callable[..., None], *arguments: object) -> None:
        """Do work for the robots that `which` names, in every part at the same time."""
        if self._pool is None:
            work(self._parts[0], which, *arguments)
            return
        for done in [self._pool.submit(work, part, which, *arguments) for part in self._parts]:
            done.result()

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()
