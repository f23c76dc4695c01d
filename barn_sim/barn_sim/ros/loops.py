"""How simulated time advances in the node: in lockstep with a planner, or freely at a factor of real time.

The node calls a loop's `turn` repeatedly. While a loop waits, the executor serves subscriptions and services, which may
pause or replace the trial.
"""

import math
import time
from collections.abc import Callable, Iterator
from typing import Protocol

from barn_sim.ros.topics import Outputs
from barn_sim.ros.trial import SimulatedTrial
from barn_worlds.base.types import NANOSECONDS, nanoseconds
from barn_worlds.messages.topics import Outgoing

LONGEST_WAIT_S = 0.05  # so that a stop of the node is noticed in time
_LARGEST_DEBT_S = 0.5  # of wall-clock time; a machine that is further behind does not catch up


class LoopHost(Protocol):
    """What a loop needs of the node."""

    trial: SimulatedTrial
    paused: bool
    stopping: bool
    outputs: Outputs

    def ahead(self) -> bool:
        """Tell whether an evaluator has yet to hear as much as may be on its way to it."""

    def serve(self, timeout_s: float) -> None:
        """Run one callback, waiting for it no longer than given."""


class Lockstep:
    """Publish the readings of an instant, wait for one command, advance one control period.

    An evaluator that cannot keep up is waited for: publishers keep few messages, and what they drop no bag has.
    """

    def turn(self, stage: LoopHost) -> None:
        """Run one cycle, or as much of it as is possible now."""
        trial = stage.trial
        if stage.paused or (not trial.published and stage.ahead()):
            stage.serve(LONGEST_WAIT_S)
            return
        if not trial.published:
            trial.answer = None
            publish_readings(trial, stage.outputs)
        deadline = time.monotonic() + trial.config.command_wait_s
        while trial.answer is None:
            remaining = deadline - time.monotonic()
            if remaining <= 0.0:
                trial.missed += 1
                break
            stage.serve(min(remaining, LONGEST_WAIT_S))
            if stage.paused or stage.stopping or stage.trial is not trial:
                return
        step(trial)


def step(trial: SimulatedTrial) -> None:
    """Advance one control period with the pending command, if any."""
    command, trial.answer = trial.answer, None
    trial.simulator.step(command)
    trial.published = False


def publish_readings(trial: SimulatedTrial, outputs: Outputs) -> None:
    """Publish all readings of this instant, the scan last."""
    outputs.publish(trial.messages.sensors(trial.simulator.sense(), trial.now_ns))
    trial.published = True


class FreeRunning:
    """Advance time at the configured factor of real time and publish each reading at its own rate."""

    def __init__(self, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._now_s = monotonic
        self._paced: SimulatedTrial | None = None
        self._due_s = 0.0
        self._began_s = 0.0
        self._began_ns = 0
        self.achieved_factor = math.nan

    def turn(self, stage: LoopHost) -> None:
        """Advance to the next reading, publish what is due then, and wait for the wall clock."""
        trial = stage.trial
        if stage.paused:
            self._paced = None
            stage.serve(LONGEST_WAIT_S)
            return
        if trial is not self._paced:
            self._paced = trial
            self._due_s = self._began_s = self._now_s()
            self._began_ns = trial.simulator.stamp_ns
        if not trial.published:
            publish_due(trial, stage.outputs)
        config = trial.config
        odometry, scan = (config.ticks(1.0 / rate) for rate in (config.odometry.rate_hz, config.lidar.rate_hz))
        ticks = math.gcd(odometry, scan)
        if trial.answer is not None:
            trial.simulator.command(trial.answer)
            trial.answer = None
        trial.simulator.advance(ticks)
        publish_due(trial, stage.outputs)
        self._pace(stage, ticks * config.tick_ns / NANOSECONDS)

    def _pace(self, stage: LoopHost, simulated_s: float) -> None:
        trial = stage.trial
        factor = trial.config.real_time_factor
        now_s = self._now_s()
        self._due_s = now_s if factor == 0.0 else max(self._due_s + simulated_s / factor, now_s - _LARGEST_DEBT_S)
        stage.serve(0.0)
        while not stage.stopping and stage.trial is trial and (left_s := self._due_s - self._now_s()) > 0.0:
            stage.serve(min(left_s, LONGEST_WAIT_S))
        elapsed_s = self._now_s() - self._began_s
        if elapsed_s > 0.0:
            self.achieved_factor = (trial.simulator.stamp_ns - self._began_ns) / NANOSECONDS / elapsed_s


def publish_due(trial: SimulatedTrial, outputs: Outputs) -> None:
    """Publish the time and those readings whose period ends now."""
    outputs.publish(_due(trial))
    trial.published = True


def _due(trial: SimulatedTrial) -> Iterator[Outgoing]:
    simulator, config, messages, now_ns = trial.simulator, trial.config, trial.messages, trial.now_ns
    measured = _ends(simulator.stamp_ns, config.odometry.rate_hz)
    scanned = _ends(simulator.stamp_ns, config.lidar.rate_hz)
    odometry = simulator.read_odometry()
    yield messages.clock(now_ns)
    if scanned:
        yield messages.localisation(simulator.read_localisation(odometry.pose), odometry.pose, now_ns)
    if measured:
        yield messages.odometry(odometry, now_ns)
        yield messages.truth(simulator.read_truth(), now_ns)
        yield messages.transforms(odometry.pose, now_ns)
        yield messages.collision(simulator.read_collision())
        yield messages.joints(simulator.read_joints(), now_ns)
    if scanned:
        yield messages.scan(simulator.read_scan(), now_ns)


def _ends(stamp_ns: int, rate_hz: float) -> bool:
    return stamp_ns % nanoseconds(1.0 / rate_hz) == 0
