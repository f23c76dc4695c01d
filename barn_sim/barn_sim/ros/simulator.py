"""Node that simulates a robot in a world, in lockstep with a planner or freely; the README has its topics and services.

Parameters: the fields of `SimulatorNodeConfig` and `RunConfig`. With `robot` set at the start, those of drive, lidar,
odometry and friction that are not set have its values. Set later, it changes the body at the next reset, they do not.
With a private line to an evaluator, that alone leads it (`barn_sim.ros.leader`): the services and changes of parameters
are refused to everybody, and reported as interference.
"""

import math
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from types import FrameType
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool, Trigger

from barn_sim.config import RunConfig, SimulatorNodeConfig, with_robot
from barn_sim.ros.leader import Done, Leader
from barn_sim.ros.topics import CommandInput, Outputs, diagnosis
from barn_sim.ros.trial import SimulatedTrial, begin
from barn_sim.simulator import warm_up
from barn_worlds.base.errors import BarnError
from barn_worlds.base.types import NANOSECONDS_PER_SECOND, Velocity2D, nanoseconds
from barn_worlds.messages.topics import SIMULATOR_DIAGNOSTICS
from barn_worlds.robots.files import load_robot
from barn_worlds.ros.parameters import check_with, current, declare, warn_of_unknown
from barn_worlds.ros.private_line import PrivateLine

_LOOK_PERIOD_S = 0.1
_IDLE_CLOCK_PERIOD_S = 0.2
_AHEAD = 5  # instants that an evaluator need not have heard; publishers keep ten messages of a topic
_LONGEST_WAIT_S = 0.05  # so that a stop of the node is noticed in time
_LARGEST_DEBT_S = (
    0.5  # of wall-clock time; a machine that is further behind does not catch up
)


class SimulatorNode(Node):
    """The node; raises BarnError if its parameters do not name a world.

    While it waits, the executor serves subscriptions and services, which may pause or replace the trial.
    """

    def __init__(self, executor: SingleThreadedExecutor) -> None:
        super().__init__("simulator")
        self.stopping = False
        self._executor = executor
        self._config = declare(self, SimulatorNodeConfig(), read_only=True)
        self._defaults = declare(self, _of_robot(self))
        check_with(self, self._defaults)
        descriptor = self._config.evaluator_fd
        line = (
            PrivateLine(descriptor, lambda: not self.stopping)
            if descriptor >= 0
            else None
        )
        warn_of_unknown(self)
        warm_up()
        self.trial: SimulatedTrial = begin(self._defaults, self._config)
        self._paused = self._config.start_paused
        self._paced: SimulatedTrial | None = None  # the trial that `_due_s` is of
        self._due_s = 0.0
        self._outputs = Outputs(self, self._config, line)
        self._outputs.publish(self.trial.messages.constant())
        self._commands = CommandInput(self, self._config.command_type, self._take)
        self._leader = None
        if line is not None:
            self._leader = Leader(
                self,
                self._defaults,
                line,
                executor,
                reset=self._reset,
                pause=self._pause,
            )
        self.create_service(
            Trigger, "~/reset", partial(self._answer, "reset", lambda _: self._reset())
        )
        self.create_service(
            SetBool,
            "~/pause",
            partial(self._answer, "pause", lambda asked: self._pause(asked.data)),
        )
        self.create_service(
            Trigger, "~/step", partial(self._answer, "step", lambda _: self._step())
        )
        wall = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_LOOK_PERIOD_S, self._commands.look, clock=wall)
        self.create_timer(SIMULATOR_DIAGNOSTICS.period_s, self._report, clock=wall)
        self.create_timer(_IDLE_CLOCK_PERIOD_S, self._repeat_clock, clock=wall)
        self.get_logger().info(self._describe())

    def run(self) -> None:
        """Simulate until the node should stop."""
        turn = (
            self._advance_in_lockstep if self._config.lockstep else self._advance_freely
        )
        while not self.stopping:
            turn()

    def _advance_in_lockstep(self) -> None:
        """Publish the readings of an instant, wait for one command if they have a scan, advance one control period."""
        trial = self.trial
        # an evaluator that cannot keep up is waited for: publishers keep few messages, and what they drop no bag has
        if self._paused or (not trial.published and self._is_ahead()):
            self._serve(_LONGEST_WAIT_S)
            return
        if not trial.published:
            trial.answer = None
            self._outputs.publish(trial.readings())
        deadline = time.monotonic() + trial.config.command_wait_s
        while trial.asked and trial.answer is None:
            if (remaining := deadline - time.monotonic()) <= 0.0:
                trial.missed += 1
                break
            self._serve(min(remaining, _LONGEST_WAIT_S))
            if self._paused or self.stopping or self.trial is not trial:
                return
        trial.step()

    def _is_ahead(self) -> bool:
        """Tell whether the evaluator, if one leads the node, has yet to hear as much as may be on its way to it."""
        if self._leader is None:
            return False
        trial, leader = self.trial, self._leader
        leader.awaited = True  # first, so that nothing is heard unnoticed between looking and waiting
        heard_ns = leader.heard_ns
        ahead_ns = (
            trial.now_ns - max(heard_ns, trial.origin_ns) if heard_ns is not None else 0
        )
        leader.awaited = ahead_ns >= _AHEAD * nanoseconds(trial.config.control_period_s)
        return leader.awaited

    def _advance_freely(self) -> None:
        """Advance to the next reading, publish what is due then, and wait for the wall clock."""
        trial, config = self.trial, self.trial.config
        if self._paused:
            self._paced = None
            self._serve(_LONGEST_WAIT_S)
            return
        if trial is not self._paced:
            self._paced, self._due_s = trial, time.monotonic()
        if not trial.published:
            self._outputs.publish(trial.due_readings())
        ticks = math.gcd(
            config.ticks(1.0 / config.odometry.rate_hz),
            config.ticks(1.0 / config.lidar.rate_hz),
        )
        if trial.answer is not None:
            trial.simulator.command(trial.answer)
            trial.answer = None
        trial.simulator.advance(ticks)
        self._outputs.publish(trial.due_readings())
        now_s, factor = time.monotonic(), config.real_time_factor
        lasts_s = ticks * config.tick_ns / NANOSECONDS_PER_SECOND
        self._due_s = (
            now_s
            if factor == 0.0
            else max(self._due_s + lasts_s / factor, now_s - _LARGEST_DEBT_S)
        )
        self._serve(0.0)
        while (
            not self.stopping
            and self.trial is trial
            and (left_s := self._due_s - time.monotonic()) > 0.0
        ):
            self._serve(min(left_s, _LONGEST_WAIT_S))

    def _serve(self, timeout_s: float) -> None:
        self._executor.spin_once(timeout_sec=timeout_s)

    def _describe(self) -> str:
        config, factor = self.trial.config, self.trial.config.real_time_factor
        pace = f"{factor:g} x real time" if factor else "as fast as possible"
        mode = ("lockstep" if self._config.lockstep else pace) + (
            ", paused" if self._paused else ""
        )
        return f"world {self.trial.world_name} of {config.dataset}, seed {config.seed}, {mode}"

    def _take(self, velocity: Velocity2D) -> None:
        if not velocity.is_finite() and not self.trial.simulator.invalid_commands:
            self.get_logger().error(
                f"cmd_vel: not a number: {velocity}; the robot stops"
            )
        self.trial.take(velocity)

    def _reset(self) -> Done:
        before = self.trial
        try:
            config = (
                self._leader.config
                if self._leader is not None
                else current(self, self._defaults)
            )
            trial = begin(config, self._config, before.now_ns)
        except BarnError as error:
            self.get_logger().error(f"reset: {error}")
            return False, str(error)
        self.trial = trial
        before.simulator.close()
        self._outputs.publish(
            [*trial.messages.constant(), trial.messages.clock(trial.now_ns)]
        )
        self._commands.begin_trial()
        return True, f"{self._describe()}; before: {before.summary()}"

    def _pause(self, on: bool) -> Done:
        self._paused = on
        self._commands.look()
        scans, publishers = (
            self._outputs.scan_subscriptions(),
            self._commands.publishers(),
        )
        return (
            True,
            f"{self.trial.summary()}; connected: {scans} scan subscriptions, {publishers} command publishers",
        )

    def _step(self) -> Done:
        """Advance one control period with the last command, while time stands still."""
        trial = self.trial
        if not self._paused:
            return False, "not paused"
        if not trial.published:
            self._outputs.publish(trial.readings())
        trial.answer = None
        trial.simulator.step(trial.last)
        self._outputs.publish(trial.readings())
        return True, trial.summary()

    def _answer(
        self, name: str, serve: Callable[[Any], Done], request: object, response: Any
    ) -> Any:
        leader, deed = self._leader, f"called {self.get_name()}/{name}"
        response.success, response.message = (
            (False, leader.refuse(deed)) if leader else serve(request)
        )
        return response

    def _repeat_clock(self) -> None:
        """Repeat time and transforms while paused, for nodes that start late or wait for them."""
        if self._paused:
            messages, now_ns = self.trial.messages, self.trial.now_ns
            self._outputs.publish(
                [messages.clock(now_ns), messages.last_transforms(now_ns)]
            )

    def _report(self) -> None:
        state = "paused" if self._paused else "running"
        self._outputs.publish(
            [
                diagnosis(
                    self.trial, self._commands, state, discreet=self._leader is not None
                )
            ]
        )


def _of_robot(node: Node) -> RunConfig:
    """Return the configuration for the robot that a parameter names."""
    named = node._parameter_overrides.get("robot")
    if named is None or not isinstance(
        named.value, str
    ):  # of another type: declaring it says what is wrong
        return RunConfig()
    return replace(with_robot(RunConfig(), load_robot(named.value)), robot=named.value)


def main(args: list[str] | None = None) -> int:
    """Run the node until it is told to stop; return 1, with one line of reason, if it cannot start."""
    node: SimulatorNode | None = None

    def stop(_signal: int, _frame: FrameType | None) -> None:
        if node is None:
            raise SystemExit(0)
        node.stopping = True

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # malformed ROS arguments
        print(f"simulator: {error}", file=sys.stderr)
        return 1
    executor = SingleThreadedExecutor()
    try:
        node = SimulatorNode(executor)
        executor.add_node(node)
        node.run()
    except BarnError as error:
        print(f"simulator: {error}", file=sys.stderr)
        return 1
    finally:
        if node is not None:
            node.trial.simulator.close()
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
