"""Node that simulates a robot in a world, in lockstep with a planner or freely.

Publishes
    /clock (rosgraph_msgs/Clock): simulated time, first at every instant; never runs backwards
    odom (nav_msgs/Odometry): fused odometry, from the start pose
    ground_truth/odom (nav_msgs/Odometry): the true pose in the map frame and the true velocity
    scan (sensor_msgs/LaserScan): last at every instant
    amcl_pose (geometry_msgs/PoseWithCovarianceStamped): estimated pose in the map frame
    collision (std_msgs/Bool): contact with an obstacle since the last message
    joint_states (sensor_msgs/JointState): the wheels
    robot_description (std_msgs/String, latched): URDF
    /tf, /tf_static (tf2_msgs/TFMessage): map to odom to base_link, and the fixed frames; where tf2_msgs is installed
    /diagnostics (diagnostic_msgs/DiagnosticArray): once a second
Subscribes
    cmd_vel (geometry_msgs/Twist or TwistStamped)
Services
    ~/reset (std_srvs/Trigger): restart with the present parameters at the next whole second
    ~/pause (std_srvs/SetBool): pause or resume time; the answer has counts and the number of connections
    ~/step (std_srvs/Trigger): while paused, advance one control period with the last command
Parameters: the fields of `SimulatorNodeConfig` and `RunConfig`. With `robot` set at the start, those of drive, lidar,
odometry and friction that are not set have its values. Set later, it changes the body at the next reset, they do not.
With a private line to an evaluator, that alone leads it (`barn_sim.ros.leader`): the services and changes of parameters
are refused to everybody, and reported as interference.
"""

import signal
import sys
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
from barn_sim.ros.leader import Leader
from barn_sim.ros.loops import FreeRunning, Lockstep, publish_readings, step
from barn_sim.ros.topics import CommandInput, Outputs, diagnosis
from barn_sim.ros.trial import SimulatedTrial, begin, next_origin
from barn_sim.simulator import warm_up
from barn_worlds.base.errors import BarnError
from barn_worlds.base.types import Velocity2D, nanoseconds
from barn_worlds.messages.topics import SIMULATOR_DIAGNOSTICS
from barn_worlds.robots.files import load_robot
from barn_worlds.ros.parameters import check_with, current, declare, warn_of_unknown
from barn_worlds.ros.private_line import PrivateLine

_LOOK_PERIOD_S = 0.1
_IDLE_CLOCK_PERIOD_S = 0.2
_AHEAD = 5  # instants that an evaluator need not have heard; publishers keep ten messages of a topic


class SimulatorNode(Node):
    """The node; raises BarnError if its parameters do not name a world.

    trial: the present trial; paused: whether its time stands still; stopping: whether the node should end.
    """

    def __init__(self, executor: SingleThreadedExecutor, **options: Any) -> None:
        super().__init__("simulator", **options)
        self.stopping = False
        self._executor = executor
        self._config = declare(self, SimulatorNodeConfig(), read_only=True)
        self._defaults = declare(self, _of_robot(self))
        check_with(self, self._defaults)
        descriptor = self._config.evaluator_fd
        line = PrivateLine(descriptor, lambda: not self.stopping) if descriptor >= 0 else None
        warn_of_unknown(self)
        warm_up()
        self.trial: SimulatedTrial = begin(self._defaults, self._config, next_origin(0))
        self.paused = self._config.start_paused
        self.outputs = Outputs(self, self._config, line)
        self.outputs.publish(self.trial.messages.constant())
        self._loop = Lockstep() if self._config.lockstep else FreeRunning()
        self._commands = CommandInput(self, self._config.command_type, self._take)
        self._leader = None
        if line is not None:
            self._leader = Leader(self, self._defaults, line, executor, reset=self.reset, pause=self.pause)
        self.create_service(Trigger, "~/reset", partial(self._answer, "reset", lambda _: self.reset()))
        self.create_service(SetBool, "~/pause", partial(self._answer, "pause", lambda asked: self.pause(asked.data)))
        self.create_service(Trigger, "~/step", partial(self._answer, "step", lambda _: self.step()))
        wall = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_LOOK_PERIOD_S, self._commands.look, clock=wall)
        self.create_timer(SIMULATOR_DIAGNOSTICS.period_s, self._report, clock=wall)
        self.create_timer(_IDLE_CLOCK_PERIOD_S, self._repeat_clock, clock=wall)
        self.get_logger().info(self._describe())

    def run(self) -> None:
        """Simulate until the node should stop."""
        while not self.stopping:
            self._loop.turn(self)

    def ahead(self) -> bool:
        """Tell whether the evaluator, if one leads the node, has yet to hear as much as may be on its way to it."""
        if self._leader is None:
            return False
        trial, leader = self.trial, self._leader
        leader.awaited = True  # first, so that nothing is heard unnoticed between looking and waiting
        heard_ns = leader.heard_ns
        leader.awaited = heard_ns is not None and (
            trial.now_ns - max(heard_ns, trial.origin_ns) >= _AHEAD * nanoseconds(trial.config.control_period_s)
        )
        return leader.awaited

    def serve(self, timeout_s: float) -> None:
        """Run one callback, waiting for it no longer than given."""
        self._executor.spin_once(timeout_sec=timeout_s)

    def _describe(self) -> str:
        trial = self.trial
        factor = trial.config.real_time_factor
        pace = f"{factor:g} x real time" if factor else "as fast as possible"
        mode = "lockstep" if self._config.lockstep else pace
        paused = ", paused" if self.paused else ""
        return f"world {trial.world_name} of {trial.config.dataset}, seed {trial.config.seed}, {mode}{paused}"

    def _take(self, velocity: Velocity2D) -> None:
        if self.trial.is_first_invalid(velocity):
            self.get_logger().error(f"cmd_vel: not a number: {velocity}; the robot stops")
        self.trial.take(velocity)

    def reset(self) -> tuple[bool, str]:
        """Begin a new trial with the present parameters; return whether there is one, and what became of the last."""
        before = self.trial
        try:
            config = self._leader.config if self._leader is not None else current(self, self._defaults)
            trial = begin(config, self._config, next_origin(before.now_ns))
        except BarnError as error:
            self.get_logger().error(f"reset: {error}")
            return False, str(error)
        self.trial = trial
        before.close()
        self.outputs.publish([*trial.messages.constant(), trial.messages.clock(trial.now_ns)])
        self._commands.begin_trial()
        return True, f"{self._describe()}; before: {before.summary()}"

    def pause(self, on: bool) -> tuple[bool, str]:
        """Stop or resume time; return True, counts and the number of connections."""
        self.paused = on
        self._commands.look()
        connected = (
            f"{self.outputs.scan_subscriptions()} scan subscriptions, {self._commands.publishers()} command publishers"
        )
        return True, f"{self.trial.summary()}; connected: {connected}"

    def step(self) -> tuple[bool, str]:
        """Advance one control period with the last command; return whether that was possible, and counts."""
        trial = self.trial
        if not self.paused:
            return False, "not paused"
        if not trial.published:
            publish_readings(trial, self.outputs)
        trial.answer = trial.last
        step(trial)
        publish_readings(trial, self.outputs)
        return True, trial.summary()

    def _answer(self, name: str, serve: Callable[[Any], tuple[bool, str]], request: Any, response: Any) -> Any:
        """Answer a call of a service."""
        if self._leader is not None:
            response.success, response.message = False, self._leader.refuse(f"called {self.get_name()}/{name}")
        else:
            response.success, response.message = serve(request)
        return response

    def _repeat_clock(self) -> None:
        """Repeat time and transforms while paused, for nodes that start late or wait for them."""
        if self.paused:
            messages, now_ns = self.trial.messages, self.trial.now_ns
            self.outputs.publish([messages.clock(now_ns), messages.last_transforms(now_ns)])

    def _report(self) -> None:
        factor = self._loop.achieved_factor if isinstance(self._loop, FreeRunning) else None
        state = "paused" if self.paused else "running"
        discreet = self._leader is not None
        self.outputs.publish([diagnosis(self.trial, self._commands, state, factor, discreet=discreet)])


def _of_robot(node: Node) -> RunConfig:
    """Return the configuration for the robot that a parameter names."""
    named = node._parameter_overrides.get("robot")
    if named is None or not isinstance(named.value, str):  # of another type: declaring it says what is wrong
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
            node.trial.close()
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
