"""The node that runs any registered planner.

Subscribes: scan, odom, goal_pose; with `use_map` also map and amcl_pose.
Publishes: cmd_vel (Twist or TwistStamped), plan, local_plan, local_costmap/costmap,
band, candidates, diagnostics.
Services: ~/ready, ~/reset (Trigger).
Parameters: those of `NodeConfig`, and all fields of the planner's configuration.
Changes of the latter take effect at the next ~/reset.
"""

import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from types import FrameType
from typing import TypeVar

import rclpy
from rclpy.duration import Duration
from rclpy.event_handler import (
    QoSRequestedIncompatibleQoSInfo,
    SubscriptionEventCallbacks,
)
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from std_srvs.srv import Trigger

from barn_planners.interface import Observation
from barn_planners.registry import planner_config, planner_entry
from barn_planners.runtime.messages import VIEW_TOPICS, PlannerMessages
from barn_planners.runtime.planner_runtime import PlannerRuntime, goal_problem
from barn_planners.runtime.synchronizer import SyncConfig, Synchronizer
from barn_worlds.base.arrays import COMPILING_NOTE
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import BarnError, ExitCode
from barn_worlds.base.types import STOP, OccupancyMap, Odometry, Pose2D, Scan
from barn_worlds.messages import decode, topics
from barn_worlds.messages.decode import Header
from barn_worlds.messages.topics import (
    BEST_EFFORT,
    FRAMES,
    Frames,
    OutgoingMessage,
    Qos,
    Topic,
)
from barn_worlds.ros.parameters import (
    declare_parameters,
    read_parameters,
    refuse_invalid_changes,
    warn_about_unknown_parameters,
)
from barn_worlds.ros.starting import start_ros
from barn_worlds.ros.topics import create_publisher, subscribe

T = TypeVar("T")

_DISPLAY_TOPICS = (topics.PLAN, *VIEW_TOPICS, topics.DIAGNOSTICS)
# Only a listener that was killed takes this long, and then DDS forgets it.
_LAST_COMMAND_S = 20.0
# Odometry and poses arrive more often than scans; none of them should be lost.
_READINGS_DEPTH = 50


@dataclass(frozen=True)
class NodeConfig(Checked):
    """Parameters of the node itself."""

    preset: str = quantity(
        "", "preset of the planner; empty: paper2020 with a map, challenge without"
    )
    seed: int = quantity(
        0,
        "seed of the planner's random numbers, read at the start of a task",
        minimum=0,
    )
    use_map: bool = quantity(False, "plan on a map, with the robot localized in it")
    command_type: str = quantity(
        "twist", "type of the commands", choices=("twist", "twist_stamped")
    )
    repeat_command: bool = quantity(
        True, "send the last command again in a cycle without a new one"
    )
    publish_views: bool = quantity(
        True,
        "publish plans, costmap, band, candidates and diagnostics if a node subscribes to them",
    )
    view_period_s: float = quantity(
        topics.PLAN.period_s,
        "period at which plans, costmap, band and candidates are published",
        "s",
        0.0,
        3600.0,
    )
    map_frame: str = quantity(FRAMES.map, "frame of the map")
    odom_frame: str = quantity(FRAMES.odom, "frame of the odometry")
    base_frame: str = quantity(FRAMES.base, "frame of stamped commands")

    @property
    def frames(self) -> Frames:
        """Names of all frames; planning is in map with `use_map`, else in odom."""
        planning = self.map_frame if self.use_map else self.odom_frame
        return Frames(
            self.map_frame, self.odom_frame, self.base_frame, planning=planning
        )


class PlannerNode(Node):
    """Passes readings to a planner and sends its commands."""

    def __init__(self, planner: str, name: str):
        """Make the planner, compile its kernels and connect it to topics and services.

        Args:
            planner: Name of the planner, unless the parameter `planner` is set.
            name: Name of the node.

        Raises:
            BarnError: If a parameter is not allowed.
        """
        super().__init__(name)
        # Before all others: the planner decides which parameters there are.
        self.declare_parameter("planner", planner)
        planner = self.get_parameter("planner").get_parameter_value().string_value
        self._node_config = config = declare_parameters(self, NodeConfig())
        preset = config.preset or ("paper2020" if config.use_map else "challenge")
        self._entry = planner_entry(planner)
        self._planner_config = declare_parameters(self, planner_config(planner, preset))
        sync = declare_parameters(self, SyncConfig())
        refuse_invalid_changes(self, self._planner_config)
        warn_about_unknown_parameters(self)

        self._synchronizer = Synchronizer(sync, use_pose=config.use_map)
        self.get_logger().info(COMPILING_NOTE)
        self._runtime = self._make_runtime()
        self._planning_frame = config.frames.planning
        self._messages = PlannerMessages(
            config.frames,
            self.get_name(),
            stamped=config.command_type == "twist_stamped",
            view_period_s=config.view_period_s,
        )
        # The first view compiles kernels too, which must not delay the first command.
        self._messages.warm_up(self._runtime.planner)
        self._connect()
        self.get_logger().info(
            f"planner {planner!r}, preset {preset!r}, planning in frame"
            f" {self._planning_frame!r}"
        )

    def stop_robot(self) -> None:
        """Publish a stop and wait up to 20 s until all listeners acknowledge it.

        A message that is still on its way when the process ends may be lost.
        """
        message = self._messages.command(STOP, 0)
        self._publish(message)
        self._topic_publishers[message.topic.name].wait_for_all_acked(
            Duration(seconds=_LAST_COMMAND_S)
        )

    def _make_runtime(self) -> PlannerRuntime:
        """Return a runtime with a new planner, warmed up, without goal and map."""
        config = self._node_config
        runtime = PlannerRuntime(
            self._entry.build(self._planner_config),
            seed=config.seed,
            use_map=config.use_map,
            repeat_command=config.repeat_command,
        )
        # Before goal and map arrive, so that compiling does not count as computing
        # time.
        runtime.warm_up()
        runtime.reset()
        return runtime

    def _connect(self) -> None:
        """Create all publishers, subscriptions and services."""
        # The message knows whether commands are stamped, and so which topic type they
        # have.
        command_topic = self._messages.command(STOP, 0).topic
        self._topic_publishers = {
            topic.name: create_publisher(self, topic)
            for topic in (command_topic, *_DISPLAY_TOPICS)
        }
        self._subscriptions_by_topic: dict[str, Subscription] = {}
        if self._node_config.use_map:
            subscribe(self, topics.MAP, decode.occupancy_map, self._on_map)
            read_pose = _with_header(decode.pose_with_covariance)
            self._listen(topics.AMCL_POSE, read_pose, self._on_pose, _READINGS_DEPTH)
        self._listen(topics.ODOM, decode.odometry, self._on_odometry, _READINGS_DEPTH)
        # Only the newest scan is worth a command.
        self._listen(topics.SCAN, decode.scan, self._on_scan, 1)
        subscribe(self, topics.GOAL_POSE, _with_header(decode.pose), self._on_goal)
        self.create_service(Trigger, "~/ready", self._on_ready)
        self.create_service(Trigger, "~/reset", self._on_reset)

    def _listen(
        self,
        topic: Topic,
        read: Callable[[bytes], T],
        callback: Callable[[T], None],
        depth: int,
    ) -> None:
        """Subscribe reliably; switch to best effort if a publisher offers no more."""

        def on_mismatch(_: QoSRequestedIncompatibleQoSInfo) -> None:
            """Replace the reliable subscription by a best-effort one."""
            self.get_logger().info(
                f"{topic.name}: a publisher offers only best effort; "
                "subscribing as best effort"
            )
            # DDS never matches a reliable reader with a best-effort writer, whatever
            # comes later.
            self.destroy_subscription(self._subscriptions_by_topic[topic.name])
            self._subscriptions_by_topic[topic.name] = subscribe(
                self, topic, read, callback, BEST_EFFORT
            )

        events = SubscriptionEventCallbacks(incompatible_qos=on_mismatch)
        self._subscriptions_by_topic[topic.name] = subscribe(
            self, topic, read, callback, Qos(depth=depth), event_callbacks=events
        )

    def _on_odometry(self, odometry: Odometry) -> None:
        """Store odometry and act on the observation that it completes, if any."""
        self._act(self._synchronizer.add_odometry(odometry))

    def _on_pose(self, message: tuple[Header, Pose2D]) -> None:
        """Store a pose in map and act on the observation that it completes, if any."""
        header, pose = message
        self._act(self._synchronizer.add_pose(header.stamp_ns, pose))

    def _on_scan(self, scan: Scan) -> None:
        """Store a scan; act on what it completes; restart if time jumped back."""
        # A scan may complete the one before it, whose odometry can then no longer come.
        observations = self._synchronizer.add_scan(scan)
        if self._synchronizer.restarted:
            self._synchronizer.restarted = False
            self.get_logger().warning("time jumped back: starting the task again")
            self._runtime.restart()
            self._messages.reset()
        for observation in observations:
            self._act(observation)

    def _on_goal(self, message: tuple[Header, Pose2D]) -> None:
        """Set a goal, which may start its task; log and drop one that is not usable."""
        header, goal = message
        problem = goal_problem(goal, header.frame, self._planning_frame)
        if problem:
            self.get_logger().error(problem)
            return
        self._read_seed()
        if self._runtime.set_goal(goal):
            self.get_logger().info(
                f"new goal ({goal.x:.3f}, {goal.y:.3f}, {goal.yaw:.3f})"
            )

    def _on_map(self, occupancy: OccupancyMap) -> None:
        """Set the map, which may start a task."""
        self._read_seed()
        self._runtime.set_map(occupancy)

    def _read_seed(self) -> None:
        """Copy the parameter `seed` to the runtime, for the next task.

        The evaluator sets it before each trial.
        """
        value = self.get_parameter("seed").get_parameter_value()
        self._runtime.seed = value.integer_value

    def _on_ready(
        self, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        """Answer with success if goal and map are there, else with what is missing."""
        response.message = self._runtime.missing()
        response.success = not response.message
        return response

    def _on_reset(
        self, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        """Forget goal, map and readings; make a new planner if parameters changed."""
        config = read_parameters(self, self._planner_config)
        # A new planner has to warm up, so equal parameters keep the old one.
        if config != self._planner_config:
            self._planner_config = config
            self._runtime = self._make_runtime()
        self._runtime.reset()
        self._synchronizer.reset()
        self._messages.reset()
        response.success = True
        return response

    def _act(self, observation: Observation | None) -> None:
        """Step the planner with an observation; publish command, if any, and views.

        Nothing happens without an observation. No command is published if the planner
        gives none and `repeat_command` is false.
        """
        if observation is None:
            return
        output = self._runtime.step(observation)
        stamp_ns = observation.stamp_ns
        if output.command is not None:
            self._publish(self._messages.command(output.command, stamp_ns))
        if output.decision is None or not self._node_config.publish_views:
            return
        for message in self._messages.display(
            self._runtime.planner, output.decision, stamp_ns, self._has_listeners
        ):
            self._publish(message)

    def _publish(self, message: OutgoingMessage) -> None:
        """Publish a serialized message on its topic."""
        self._topic_publishers[message.topic.name].publish(message.data)

    def _has_listeners(self, topic: Topic) -> bool:
        """Return whether anyone subscribes to a topic of this node."""
        return self._topic_publishers[topic.name].get_subscription_count() > 0


def _with_header(read: Callable[[bytes], T]) -> Callable[[bytes], tuple[Header, T]]:
    """Return a reader of serialized messages: their header and what `read` returns."""
    return lambda data: (decode.header(data), read(data))


def run(planner: str, name: str) -> int:
    """Run the node until SIGINT or SIGTERM, then stop the robot; return the exit code.

    Args:
        planner: Name of the planner, unless the parameter `planner` is set.
        name: Name of the node.

    Returns:
        Exit code: 0, or REFUSED after one line if a parameter is not allowed.
    """
    node: PlannerNode | None = None
    signals: list[int] = []

    def on_signal(number: int, _: FrameType | None) -> None:
        """Record the signal, which ends the node's loop, or exit if there is none."""
        # A node that compiles kernels is made for up to a minute.
        if node is None:
            raise SystemExit(0)
        signals.append(number)

    # Without rclpy's own handlers, so that the node can still send its last command.
    signal.signal(signal.SIGINT, on_signal)
    signal.signal(signal.SIGTERM, on_signal)
    try:
        start_ros(signals=SignalHandlerOptions.NO)
        node = PlannerNode(planner, name)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while not signals:
            # A signal does not wake the executor, so it looks five times a second.
            executor.spin_once(timeout_sec=0.2)
        node.stop_robot()
        executor.shutdown()
        node.destroy_node()
    except (BarnError, ParameterException) as error:
        print(error, file=sys.stderr)
        return ExitCode.REFUSED
    finally:
        rclpy.try_shutdown()
    return 0


# The executables: one for any planner, which the parameter `planner` names, and one for
# each of these.
main = partial(run, "dwa", "planner")
main_dwa = partial(run, "dwa", "dwa_planner")
main_eband = partial(run, "eband", "eband_planner")
main_mppi = partial(run, "mppi", "mppi_planner")
main_policy = partial(run, "policy", "policy_planner")
