"""Node that runs any registered planner.

Subscribes: scan, odom, goal_pose; with `use_map` also map and amcl_pose. Publishes: cmd_vel (Twist or TwistStamped),
plan, local_plan, local_costmap/costmap, band, candidates, diagnostics. Services: ~/ready, ~/reset (Trigger).
Parameters: those of `NodeConfig` and all fields of the planner's configuration; changes of the latter take effect at
the next ~/reset.
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
from barn_planners.runtime.messages import PlannerMessages
from barn_planners.runtime.session import (
    PlannerSession,
    SyncConfig,
    Synchroniser,
    goal_problem,
)
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import BarnError
from barn_worlds.base.types import STOP, OccupancyMap, Pose2D, Scan
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
)
from barn_worlds.ros.topics import create_publisher, subscribe

T = TypeVar("T")

_SHOWN = (
    topics.PLAN,
    topics.LOCAL_PLAN,
    topics.COSTMAP,
    topics.BAND,
    topics.CANDIDATES,
    topics.DIAGNOSTICS,
)
_LAST_COMMAND_S = (
    20.0  # only for listeners that were killed, which DDS forgets after as long
)


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
    use_map: bool = quantity(False, "plan on a map, with the robot localised in it")
    command_type: str = quantity(
        "twist", "type of the commands", choices=("twist", "twist_stamped")
    )
    repeat_command: bool = quantity(
        True, "send the last command again in a cycle without a new one"
    )
    publish_views: bool = quantity(
        True,
        "publish plans, costmap, band, candidates and diagnostics when listened to",
    )
    view_period_s: float = quantity(
        topics.PLAN.period_s, "time between two of these", "s", 0.0, 3600.0
    )
    map_frame: str = quantity(FRAMES.map, "frame of the map")
    odom_frame: str = quantity(FRAMES.odom, "frame of the odometry")
    base_frame: str = quantity(FRAMES.base, "frame of stamped commands")

    @property
    def frames(self) -> Frames:
        """The frames together."""
        planning = self.map_frame if self.use_map else self.odom_frame
        return Frames(
            self.map_frame, self.odom_frame, self.base_frame, planning=planning
        )


class PlannerNode(Node):
    """Passes readings to a planner and sends its commands."""

    def __init__(self, planner: str, name: str):
        """Make the node; `planner` is what the parameter of that name is unless set. BarnError for a bad parameter."""
        super().__init__(name)
        self.declare_parameter("planner", planner)
        chosen = self.get_parameter("planner").get_parameter_value().string_value
        self._node_config = declare_parameters(self, NodeConfig())
        preset = self._node_config.preset or (
            "paper2020" if self._node_config.use_map else "challenge"
        )
        self._entry = planner_entry(chosen)
        self._config = declare_parameters(self, planner_config(chosen, preset))
        sync = declare_parameters(self, SyncConfig())
        refuse_invalid_changes(self, self._config)
        self._sync = Synchroniser(sync, use_pose=self._node_config.use_map)
        self._session = self._new_session()
        self._frame = self._node_config.frames.planning
        self._messages = PlannerMessages(
            self._node_config.frames,
            self.get_name(),
            stamped=self._node_config.command_type == "twist_stamped",
            view_period_s=self._node_config.view_period_s,
        )
        self._messages.warm_up(self._session.planner)
        self._open()
        self.get_logger().info(
            f"planner {chosen!r}, preset {preset!r}, planning in frame {self._frame!r}"
        )

    def stop_robot(self) -> None:
        """Send a stop, and wait until all who listen have it: what is on its way when a process ends may be lost."""
        message = self._messages.command(STOP, 0)
        self._publish(message)
        self._outputs[message.topic.name].wait_for_all_acked(
            Duration(seconds=_LAST_COMMAND_S)
        )

    def _new_session(self) -> PlannerSession:
        config = self._node_config
        planner = self._entry.build(self._config)
        session = PlannerSession(
            planner,
            seed=config.seed,
            use_map=config.use_map,
            repeat_command=config.repeat_command,
        )
        session.warm_up()
        session.reset()
        return session

    def _open(self) -> None:
        command = self._messages.command(STOP, 0).topic
        self._outputs = {
            topic.name: create_publisher(self, topic) for topic in (command, *_SHOWN)
        }
        self._sources: dict[str, Subscription] = {}
        if self._node_config.use_map:
            subscribe(self, topics.MAP, decode.occupancy_map, self._on_map)
            self._listen(
                topics.AMCL_POSE,
                _with_header(decode.pose_with_covariance),
                self._on_pose,
                50,
            )
        self._listen(
            topics.ODOM,
            decode.odometry,
            lambda odometry: self._act(self._sync.add_odometry(odometry)),
            50,
        )
        self._listen(topics.SCAN, decode.scan, self._on_scan, 1)
        subscribe(self, topics.GOAL_POSE, _with_header(decode.pose), self._on_goal)
        self.create_service(Trigger, "~/ready", self._on_ready)
        self.create_service(Trigger, "~/reset", self._on_reset)

    def _listen(
        self,
        topic: Topic,
        read: Callable[[bytes], T],
        take: Callable[[T], None],
        depth: int,
    ) -> None:
        """Subscribe reliably, or best effort if a publisher offers no more."""

        def on_mismatch(_: QoSRequestedIncompatibleQoSInfo) -> None:
            self.get_logger().info(
                f"{topic.name}: a publisher is best-effort only, subscribing as best-effort"
            )
            self.destroy_subscription(self._sources[topic.name])
            self._sources[topic.name] = subscribe(self, topic, read, take, BEST_EFFORT)

        events = SubscriptionEventCallbacks(incompatible_qos=on_mismatch)
        self._sources[topic.name] = subscribe(
            self, topic, read, take, Qos(depth=depth), event_callbacks=events
        )

    def _on_pose(self, located: tuple[Header, Pose2D]) -> None:
        header, pose = located
        self._act(self._sync.add_pose(header.stamp_ns, pose))

    def _on_scan(self, scan: Scan) -> None:
        observations = self._sync.add_scan(scan)
        if self._sync.restarted:
            self._sync.restarted = False
            self.get_logger().warning("time has jumped back: beginning the task anew")
            self._session.restart()
            self._messages.reset()
        for observation in observations:
            self._act(observation)

    def _on_goal(self, given: tuple[Header, Pose2D]) -> None:
        header, goal = given
        problem = goal_problem(goal, header.frame, self._frame)
        if problem:
            self.get_logger().error(problem)
            return
        self._session.seed = (
            self.get_parameter("seed").get_parameter_value().integer_value
        )
        if self._session.set_goal(goal):
            self.get_logger().info(
                f"new goal ({goal.x:.3f}, {goal.y:.3f}, {goal.yaw:.3f})"
            )

    def _on_map(self, known: OccupancyMap) -> None:
        self._session.seed = (
            self.get_parameter("seed").get_parameter_value().integer_value
        )
        self._session.set_map(known)

    def _on_ready(
        self, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        response.message = self._session.missing()
        response.success = not response.message
        return response

    def _on_reset(
        self, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        config = read_parameters(self, self._config)
        if config != self._config:
            self._config = config
            self._session = self._new_session()
        self._session.reset()
        self._sync.reset()
        self._messages.reset()
        response.success = True
        return response

    def _act(self, observation: Observation | None) -> None:
        if observation is None:
            return
        answer = self._session.answer(observation)
        if answer.command is not None:
            self._publish(self._messages.command(answer.command, observation.stamp_ns))
        if answer.decision is not None and self._node_config.publish_views:
            planner, stamp_ns = self._session.planner, observation.stamp_ns
            for message in self._messages.shown(
                planner, answer.decision, stamp_ns, self._is_heard
            ):
                self._publish(message)

    def _publish(self, message: OutgoingMessage) -> None:
        self._outputs[message.topic.name].publish(message.data)

    def _is_heard(self, topic: Topic) -> bool:
        return self._outputs[topic.name].get_subscription_count() > 0


def _with_header(read: Callable[[bytes], T]) -> Callable[[bytes], tuple[Header, T]]:
    return lambda data: (decode.header(data), read(data))


def run(planner: str, name: str) -> int:
    """Run the node until SIGINT or SIGTERM and return the exit code; 1, with one line, for a mistake in parameters."""
    ended: list[int] = []

    def on_signal(number: int, _: FrameType | None) -> None:
        ended.append(number)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, on_signal)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = PlannerNode(planner, name)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while not ended:
            executor.spin_once(timeout_sec=0.2)
        node.stop_robot()
        executor.shutdown()
        node.destroy_node()
    except (BarnError, ParameterException) as error:
        print(error, file=sys.stderr)
        return 1
    finally:
        rclpy.try_shutdown()
    return 0


# The executables: one for any planner, which the parameter `planner` names, and one for each of these.
main = partial(run, "dwa", "planner")
main_dwa = partial(run, "dwa", "dwa_planner")
main_eband = partial(run, "eband", "eband_planner")
main_mppi = partial(run, "mppi", "mppi_planner")
main_policy = partial(run, "policy", "policy_planner")
