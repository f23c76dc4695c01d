"""Node that simulates a robot in a world, in lockstep with a planner or freely.

The README lists topics and services. Parameters are the fields of `SimulatorNodeConfig`
and `RunConfig`. If `robot` is set at the start, unset parameters of drive, lidar,
odometry and friction have that robot's values. If it is set later, it changes the body
at the next reset, but none of these parameters. With a private line, only the evaluator
at its other end leads the node (`barn_sim.ros.leader`): services and changes of
parameters are refused to everybody, and reported as interference.
"""

import json
import math
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from types import FrameType
from typing import Any, Protocol

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool, Trigger

from barn_sim.config import RunConfig, SimulatorNodeConfig, with_robot
from barn_sim.ros.leader import Answer, Leader
from barn_sim.ros.rhythm import Rhythm
from barn_sim.ros.topics import CommandInput, Outputs, diagnosis
from barn_sim.ros.trial import SimulatedTrial, begin_trial
from barn_sim.simulator import warm_up
from barn_worlds.base.arrays import COMPILING_NOTE
from barn_worlds.base.errors import BarnError, TippedError
from barn_worlds.base.types import (
    NANOSECONDS_PER_SECOND,
    Velocity2D,
    nanoseconds,
    seconds,
)
from barn_worlds.messages.topics import SIMULATOR_DIAGNOSTICS
from barn_worlds.robots.files import load_robot
from barn_worlds.ros.parameters import (
    declare_parameters,
    read_parameters,
    refuse_invalid_changes,
    warn_about_unknown_parameters,
)
from barn_worlds.ros.private_line import PrivateLine
from barn_worlds.ros.starting import start_ros

# Version of the fields that ~/pause answers, for the evaluator.
STATUS_VERSION = 1
_PUBLISHER_CHECK_S = 0.1
_PAUSED_CLOCK_S = 0.2
# Instants that an evaluator may lag behind: publishers keep ten messages of a topic.
_INSTANTS_AHEAD = 5
# For messages to arrive; a planner that then does nothing has read everything.
_READING_S = 0.002
# The longest wait, so that the node notices in time that it should stop.
_WAIT_S = 0.05
# A machine that is further behind the wall clock does not catch up.
_LARGEST_LAG_S = 0.5


class Response(Protocol):
    """Response of both services of std_srvs."""

    success: bool
    message: str


class SimulatorNode(Node):
    """The node.

    While it waits, the executor serves subscriptions and services, which may pause or
    replace the trial.
    """

    trial: SimulatedTrial
    stopping: bool
    """Set to end `run`."""

    def __init__(self, executor: SingleThreadedExecutor):
        """Declare the parameters, load the world and advertise topics and services.

        Args:
            executor: Executor that serves the node while it waits.

        Raises:
            BarnError: If parameters are wrong or do not name a world.
        """
        super().__init__("simulator")
        self.stopping = False
        self._executor = executor
        self._config = declare_parameters(self, SimulatorNodeConfig(), read_only=True)
        self._defaults = declare_parameters(self, _initial_config(self))
        refuse_invalid_changes(self, self._defaults)
        descriptor = self._config.evaluator_fd
        line = None
        if descriptor >= 0:
            line = PrivateLine(descriptor, lambda: not self.stopping)
        warn_about_unknown_parameters(self)

        self.get_logger().info(COMPILING_NOTE)
        warm_up()
        self._rhythm = Rhythm(self._config.planner_rate_hz)
        self.trial = begin_trial(self._defaults, self._config, self._rhythm)
        self._paused = self._config.start_paused
        # The trial that `_due_s` belongs to: the wall-clock time of its next reading.
        self._paced_trial: SimulatedTrial | None = None
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

        self._add_service(Trigger, "reset", lambda _: self._reset())
        self._add_service(SetBool, "pause", lambda request: self._pause(request.data))
        self._add_service(Trigger, "step", lambda _: self._step())
        wall = Clock(clock_type=ClockType.STEADY_TIME)
        check = self._commands.check_publishers
        self.create_timer(_PUBLISHER_CHECK_S, check, clock=wall)
        self.create_timer(SIMULATOR_DIAGNOSTICS.period_s, self._report, clock=wall)
        self.create_timer(_PAUSED_CLOCK_S, self._repeat_clock, clock=wall)
        self.get_logger().info(self._describe())

    def run(self) -> None:
        """Run until `stopping` is set; TippedError on a tip without an evaluator."""
        while not self.stopping:
            try:
                if self._config.lockstep:
                    self._advance_in_lockstep()
                else:
                    self._advance_freely()
            except TippedError as error:
                if self._leader is None:
                    raise
                # The evaluator ends the trial and begins the next one.
                self._paused = True
                self._leader.report_tip(str(error))

    def _advance_in_lockstep(self) -> None:
        """Publish an instant, await any command due, advance; if paused, only serve.

        Without a command in time, it advances all the same and counts a missed one.
        """
        trial = self.trial
        # An evaluator that cannot keep up is waited for: publishers keep few messages,
        # and messages that they drop are missing in the bag.
        if self._paused or (not trial.published and self._is_ahead()):
            self._serve(_WAIT_S)
            return
        if not trial.published:
            # A command from before the readings does not answer them.
            trial.answer = None
            self._outputs.publish(trial.readings())

        if not trial.awaits_answer:
            self._await_reading(trial)
        elif trial.answer is None and not self._await_answer(trial):
            return
        trial.step()

    def _await_reading(self, trial: SimulatedTrial) -> None:
        """Serve callbacks while a periodic planner is busy, up to a control period.

        Its next command would otherwise come from readings that are long past. It gets
        no longer than on a robot.
        """
        end_s = time.monotonic() + trial.config.control_period_s
        is_busy = self._rhythm.period_ns > 0
        while is_busy and time.monotonic() < end_s:
            self._serve(_READING_S)
            is_busy = self._leader is not None and self._leader.is_planner_busy()

    def _await_answer(self, trial: SimulatedTrial) -> bool:
        """Wait for a command or the limit; return False if paused, stopped or reset."""
        rhythm = self._rhythm
        rhythm.begin_wait(time.monotonic())
        if self._leader is not None:
            self._leader.begin_reading()
        while (remaining_s := rhythm.remaining_s(time.monotonic())) > 0.0:
            self._serve(min(remaining_s, _WAIT_S))
            if self._paused or self.stopping or self.trial is not trial:
                return False
        rhythm.end_wait(trial.now_ns)
        return True

    def _is_ahead(self) -> bool:
        """Tell whether an evaluator is five periods behind; set `is_awaited` to it."""
        leader = self._leader
        if leader is None:
            return False
        trial = self.trial
        # Set first, so that nothing is heard unnoticed between reading and waiting.
        leader.is_awaited = True
        heard_ns = leader.heard_ns
        ahead_ns = 0
        if heard_ns is not None:
            ahead_ns = trial.now_ns - max(heard_ns, trial.origin_ns)
        period_ns = nanoseconds(trial.config.control_period_s)
        leader.is_awaited = ahead_ns >= _INSTANTS_AHEAD * period_ns
        return leader.is_awaited

    def _advance_freely(self) -> None:
        """Advance to the next reading at the set pace; only serve callbacks if paused."""
        trial = self.trial
        config = trial.config
        if self._paused:
            self._paced_trial = None
            self._serve(_WAIT_S)
            return
        if trial is not self._paced_trial:
            self._paced_trial = trial
            self._due_s = time.monotonic()
        if not trial.published:
            self._outputs.publish(trial.due_readings())

        if trial.answer is not None:
            trial.simulator.command(trial.answer)
            trial.answer = None
        odometry_ticks = config.ticks(1.0 / config.odometry.rate_hz)
        scan_ticks = config.ticks(1.0 / config.lidar.rate_hz)
        ticks = math.gcd(odometry_ticks, scan_ticks)
        trial.simulator.advance(ticks)
        trial.simulator.require_upright()
        self._outputs.publish(trial.due_readings())

        now_s = time.monotonic()
        factor = config.real_time_factor
        if factor == 0.0:
            self._due_s = now_s
        else:
            duration_s = ticks * config.tick_ns / NANOSECONDS_PER_SECOND
            self._due_s = max(self._due_s + duration_s / factor, now_s - _LARGEST_LAG_S)
        # Callbacks get a turn even on a machine that is behind and never waits below.
        self._serve(0.0)
        while not self.stopping and self.trial is trial:
            remaining_s = self._due_s - time.monotonic()
            if remaining_s <= 0.0:
                break
            self._serve(min(remaining_s, _WAIT_S))

    def _serve(self, timeout_s: float) -> None:
        """Run one callback of the executor; wait for it at most `timeout_s`."""
        self._executor.spin_once(timeout_sec=timeout_s)

    def _describe(self) -> str:
        """Return a line for the log with world, data set, seed, pace and any pause."""
        config = self.trial.config
        mode = "as fast as possible"
        if self._config.lockstep:
            mode = "lockstep"
        elif config.real_time_factor:
            mode = f"{config.real_time_factor:g} x real time"
        if self._paused:
            mode += ", paused"
        world = f"world {self.trial.world_name} of {config.dataset}"
        return f"{world}, seed {config.seed}, {mode}"

    def _take(self, velocity: Velocity2D) -> None:
        """Store a command, tell rhythm, log NaN; report a periodic planner's answer."""
        if not velocity.is_finite() and not self.trial.simulator.invalid_commands:
            self.get_logger().error(
                f"cmd_vel: not a number: {velocity}; the robot stops"
            )
        rhythm = self._rhythm
        if self._leader is not None and rhythm.is_timed_by_planner:
            self._leader.report_answer(self.trial.now_ns)
        self.trial.take(velocity)
        rhythm.hear(self.trial.now_ns, time.monotonic())

    def _reset(self) -> Answer:
        """Start a trial with current parameters and publish, or keep the old on error.

        If its world or robot cannot be read, the old trial stays, and the answer is
        False.
        """
        before = self.trial
        try:
            if self._leader is None:
                config = read_parameters(self, self._defaults)
            else:
                config = self._leader.config
            trial = begin_trial(config, self._config, self._rhythm, before.now_ns)
        except BarnError as error:
            self.get_logger().error(f"reset: {error}")
            return False, str(error)
        self.trial = trial
        before.simulator.close()
        clock = trial.messages.clock(trial.now_ns)
        self._outputs.publish([*trial.messages.constant(), clock])
        self._commands.begin_trial()
        return True, f"{self._describe()}; before: {before.summary()}"

    def _pause(self, on: bool) -> Answer:
        """Pause (True) or resume time, and answer the trial's counts as JSON."""
        self._paused = on
        self._commands.check_publishers()
        status = {
            "version": STATUS_VERSION,
            "simulated_s": round(seconds(self.trial.simulator.stamp_ns), 3),
            **self.trial.counts(),
            "period_ns": self._rhythm.period_ns,
            "is_declared": self._rhythm.is_declared,
            "scan_subscriptions": self._outputs.scan_subscriptions(),
            "command_publishers": self._commands.publishers(),
        }
        return True, json.dumps(status)

    def _step(self) -> Answer:
        """Advance a control period with the last command, publish; only if paused."""
        trial = self.trial
        if not self._paused:
            return False, "not paused"
        if not trial.published:
            self._outputs.publish(trial.readings())
        trial.answer = None
        trial.simulator.step(trial.last_command)
        self._outputs.publish(trial.readings())
        return True, trial.summary()

    def _add_service(
        self, service: type, name: str, serve: Callable[[Any], Answer]
    ) -> None:
        """Offer the service ~/NAME, which refuses calls if an evaluator leads."""

        def answer(request: Any, response: Response) -> Response:
            """Fill in a response by `serve`, or refuse and tell the evaluator."""
            if self._leader is None:
                response.success, response.message = serve(request)
            else:
                deed = f"called {self.get_name()}/{name}"
                response.success = False
                response.message = self._leader.refuse(deed)
            return response

        self.create_service(service, f"~/{name}", answer)

    def _repeat_clock(self) -> None:
        """If paused, publish time and last transforms again, for late nodes."""
        if self._paused:
            messages = self.trial.messages
            now_ns = self.trial.now_ns
            self._outputs.publish(
                [messages.clock(now_ns), messages.last_transforms(now_ns)]
            )

    def _report(self) -> None:
        """Publish the diagnostics, without the world if an evaluator leads."""
        state = "paused" if self._paused else "running"
        status = diagnosis(
            self.trial, self._commands, state, discreet=self._leader is not None
        )
        self._outputs.publish([status])


def _initial_config(node: Node) -> RunConfig:
    """Return the parameters' defaults, for the robot set at start; BarnError if bad."""
    # The robot decides the defaults of other parameters, so it is needed before any
    # is declared, and rclpy has no public way to read it then.
    robot = node._parameter_overrides.get("robot")
    # A number becomes text, which names no robot: `begin_trial` refuses it. Values of
    # other types are refused when the parameter is declared.
    if robot is None or not isinstance(robot.value, str):
        return RunConfig()
    config = with_robot(RunConfig(), load_robot(robot.value))
    return replace(config, robot=robot.value)


def main(args: list[str] | None = None) -> int:
    """Run the simulator node until SIGINT or SIGTERM; return an exit code."""
    node: SimulatorNode | None = None

    def stop(_signal: int, _frame: FrameType | None) -> None:
        """Ask the node to stop, or exit at once if there is none yet."""
        # Before there is a node, nothing has to end in order.
        if node is None:
            raise SystemExit(0)
        node.stopping = True

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    try:
        # rclpy's own handlers would shut ROS down in the midst of a step.
        start_ros(args, SignalHandlerOptions.NO)
        executor = SingleThreadedExecutor()
        node = SimulatorNode(executor)
        executor.add_node(node)
        node.run()
    except BarnError as error:
        print(f"simulator: {error}", file=sys.stderr)
        return error.exit_code
    finally:
        if node is not None:
            node.trial.simulator.close()
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
