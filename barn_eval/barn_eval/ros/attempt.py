"""A planner without a trial: whether it starts, what it hears, when it commands."""

import os
import re
import time
from collections.abc import Collection, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import rclpy
from rclpy.node import Node
from std_srvs.srv import SetBool

from barn_eval.ros.graph import GraphView
from barn_eval.ros.readiness import (
    TWIST,
    TWIST_STAMPED,
    Endpoint,
    Graph,
    Needs,
    inspect,
    short_type,
)
from barn_eval.ros.supervision import launcher, nodes
from barn_eval.ros.supervision.nodes import NodeProcess
from barn_eval.ros.supervision.process import SupervisedProcess, last_lines
from barn_eval.running.planner_sources import explain_end, read_source
from barn_eval.trials.ros_config import RosConfig
from barn_eval.trials.run_config import RunConfig
from barn_worlds.base.types import Pose2D, Velocity2D
from barn_worlds.messages import decode
from barn_worlds.messages.encode import PoseStampedEncoder
from barn_worlds.messages.topics import (
    BEST_EFFORT,
    CMD_VEL,
    CMD_VEL_STAMPED,
    FRAMES,
    GOAL_POSE,
    ODOM,
    SCAN,
    TF,
    Topic,
)
from barn_worlds.robots.files import STANDARD_ROBOT
from barn_worlds.ros.domain import reserve_domain
from barn_worlds.ros.topics import create_publisher, find_message_class, subscribe

_JOIN_LIMIT_S = 15.0  # for the planner to be on the graph
_GRAPH_LIMIT_S = 6.0  # for its publisher of commands, from then on
_STEADY_S = 0.7  # without a change there
_SCAN_LIMIT_S = 180.0  # for the first scan: kernels may be compiled before
_COMMAND_LIMIT_S = 4.0  # for the first command, from the first scan on
_LISTEN_S = 2.0  # from then on
_GOAL_PERIOD_S = 0.5
_SIMULATOR = "/barn_try_simulator"
_COMMANDS = {TWIST: CMD_VEL, TWIST_STAMPED: CMD_VEL_STAMPED}
_INPUTS = (SCAN, ODOM, GOAL_POSE)
_GOAL_NAME = re.compile("goal|target|dest|point")
_NOT_FINITE = "it sends NaN or infinity"
_NO_GOAL = (
    "it takes no goal from a topic or an action. The challenge's goal is (10, 0) in odom:"
    " give it by a parameter (--ros-args -p NAME:={goal_x}) or by --planner-input"
)


@dataclass
class Attempt:
    """What a planner did while it was tried."""

    # Topics by what they carry: cmd_vel, scan, odom, goal_pose, tf; empty for none.
    topics: dict[str, str] = field(default_factory=dict)
    # Topics that it listens to and nobody serves, with their types.
    unserved: dict[str, str] = field(default_factory=dict)
    first_command_s: float | None = None
    command_rate_hz: float | None = None
    scan_rate_hz: float | None = None
    # What keeps it from driving or may do so, with what to do.
    problems: list[str] = field(default_factory=list)
    # Options of mode ros that it needs, and arguments of its own.
    ros: dict[str, str] = field(default_factory=dict)
    arguments: str = ""


def connect(graph: Graph) -> Attempt:
    """Return an attempt with the planner's topics and the options that connect them.

    Args:
        graph: The endpoints of the planner alone.
    """
    attempt = Attempt()
    # What its own nodes say to each other.
    published = {item.topic for item in graph.publishers}
    internal = published & {item.topic for item in graph.subscriptions}
    inputs = []
    rules = []
    for topic in (CMD_VEL, *_INPUTS):
        endpoints = graph.subscriptions if topic in _INPUTS else graph.publishers
        name = _choose(topic, endpoints, internal)
        attempt.topics[topic.name] = name
        if name and topic in _INPUTS:
            inputs.append(topic.name)
        if name not in ("", topic.path):
            rules.append(f"{topic.name}:={name}")
    # The goal is a field `pose`, as of NavigateToPose.
    actions = [item for item in graph.actions if "Pose" in item[1]]
    if not attempt.topics["goal_pose"] and actions:
        name, kind = actions[0]
        attempt.topics["goal_pose"] = f"action {name}"
        attempt.ros = {
            "goal_by": "action",
            "goal_action": name.lstrip("/"),
            "goal_action_type": kind,
        }
    elif len(inputs) < len(_INPUTS):
        attempt.ros["required_inputs"] = f"[{', '.join(inputs)}]"
    if rules:
        attempt.ros["remap"] = f"[{', '.join(rules)}]"
    attempt.topics["tf"] = _choose(TF, graph.subscriptions)
    return attempt


def _choose(
    topic: Topic, endpoints: Iterable[Endpoint], internal: Collection[str] = ()
) -> str:
    """Return the planner's topic most like one by type and name, "" if it has none.

    Args:
        topic: The topic.
        endpoints: The planner's publishers, or its subscriptions.
        internal: Topics that it both publishes and hears, the last to be chosen.
    """
    types = _COMMANDS if topic is CMD_VEL else (topic.type_name,)
    names = sorted(item.topic for item in endpoints if item.type_name in types)
    if topic is GOAL_POSE:
        # A pose of another name may be the robot's own.
        names = [name for name in names if _GOAL_NAME.search(name)]
    # Of several, the one whose name is most like the topic's.
    word = topic.name.partition("_")[0]
    names.sort(
        key=lambda name: (name in internal, name != topic.path, word not in name)
    )
    return names[0] if names else ""


def try_planner(run: RunConfig, goal: Pose2D, logs: Path) -> Attempt:
    """Start a run's only planner beside a simulator; return what it does; set environ.

    Args:
        run: The run that it is meant for.
        goal: Goal in the planning frame, in m and rad.
        logs: Folder for what the processes print.

    Raises:
        BarnError: If a process cannot be started.
    """
    (choice,) = run.planners
    source = read_source(choice.command)
    planner = nodes.planner(choice, run, goal)
    with reserve_domain(os.environ) as domain:
        environment = nodes.environment(os.environ, domain)
        # The node here is on the same domain.
        os.environ.update(environment)
        variables = planner.variables(environment, logs)
        problems = [
            f"the module {name} is missing: {supplier}"
            for name, supplier in source.missing_modules(variables).items()
        ]
        if problems:
            return Attempt(problems=problems)

        with ExitStack() as started:
            process = planner.start(environment, logs, kind=launcher.PLANNER)
            started.callback(process.stop)
            # At the same time, as both take seconds to start.
            simulator = _simulator(()).start(environment, logs)
            started.callback(simulator.stop)
            rclpy.init(args=[])
            started.callback(rclpy.try_shutdown)
            node = Node("barn_try")
            processes = len(planner.executable.launched) if planner.executable else 0
            graph = _await_graph(process, node, processes)
            attempt = connect(graph)
            if not choice.takes_goal_at_start and not attempt.topics["goal_pose"]:
                attempt.arguments = source.goal_arguments()
                if not attempt.arguments:
                    attempt.problems.append(_NO_GOAL)
            if attempt.topics["cmd_vel"] and not process.ended:
                if "remap" in attempt.ros:
                    simulator.stop()
                    rules = attempt.ros["remap"][1:-1].split(", ")
                    simulator = _simulator(rules).start(environment, logs)
                    started.callback(simulator.stop)
                _observe(attempt, node, graph, goal, process)
                _check_inputs(attempt, graph, node)
            if process.ended:
                printed = last_lines(process.log)
                reason = explain_end(choice.command, printed) or printed
                return Attempt(problems=[f"it {process.end}; {reason}"])
    if not graph.endpoints:
        return Attempt(problems=[f"it started no ROS node in {_JOIN_LIMIT_S:g} s"])
    if not attempt.topics["cmd_vel"]:
        attempt.problems.append("it has no publisher of Twist or TwistStamped")
    if attempt.topics["tf"] and find_message_class(TF.type_name) is None:
        attempt.problems.append(
            "it listens to /tf, which is off without tf2_msgs: make install builds that if"
            " there is a C++ compiler, and a full installation of ROS 2 has it"
        )
    return attempt


def _check_inputs(attempt: Attempt, graph: Graph, node: Node) -> None:
    """Store topics of a planner's subscriptions that no node publishes or that misfit."""
    latest = GraphView(node).graph()
    types = {item.topic: item.type_name for item in latest.publishers}
    inputs = set()
    for item in graph.subscriptions:
        topic = item.topic
        if topic in types:
            inputs.add((topic, types[topic]))
        elif topic not in (*attempt.topics.values(), "/parameter_events"):
            attempt.unserved[topic] = short_type(item.type_name)
    needs = Needs(attempt.topics["cmd_vel"], inputs=sorted(inputs))
    attempt.problems += inspect(latest, needs).missing


def _simulator(rules: Sequence[str]) -> NodeProcess:
    """Return a paused simulator to start, with remappings FROM:=TO."""
    setup = RosConfig(lockstep=False, remap=(f"__node:={_SIMULATOR[1:]}", *rules))
    return nodes.simulator(setup, -1, STANDARD_ROBOT.name)


def _await_graph(process: SupervisedProcess, node: Node, processes: int) -> Graph:
    """Return the planner's endpoints once steady with commands, at its end or a limit.

    A launch file is complete once all its processes are there.
    """
    view = GraphView(node)
    graph = Graph()
    change_s = time.monotonic()
    limit_s = _JOIN_LIMIT_S
    while not process.ended and time.monotonic() < change_s + limit_s:
        rclpy.spin_once(node, timeout_sec=0.1)
        process.read()
        view.leave_out(lambda item: item.node == _SIMULATOR)
        latest = view.graph()
        if len(latest.endpoints) != len(graph.endpoints):
            change_s = time.monotonic()
        graph = latest
        limit_s = _GRAPH_LIMIT_S if graph.endpoints else _JOIN_LIMIT_S
        is_steady = time.monotonic() > change_s + _STEADY_S
        is_complete = len({item.participant for item in graph.endpoints}) >= processes
        if is_steady and is_complete and _choose(CMD_VEL, graph.publishers):
            break
    return graph


def _listen(
    attempt: Attempt, node: Node, graph: Graph
) -> tuple[list[float], list[float]]:
    """Subscribe; return lists that fill with times [s] of scans and later commands."""
    scans_s: list[float] = []
    commands_s: list[float] = []

    def hear_command(command: Velocity2D) -> None:
        """Record the time of a command after a scan; note one that is not finite."""
        if scans_s:
            commands_s.append(time.monotonic())
        if not command.is_finite() and _NOT_FINITE not in attempt.problems:
            attempt.problems.append(_NOT_FINITE)

    scan = replace(SCAN, name=attempt.topics["scan"] or SCAN.path)
    subscribe(node, scan, lambda _: time.monotonic(), scans_s.append, BEST_EFFORT)
    name = attempt.topics["cmd_vel"]
    kinds = {item.type_name for item in graph.publishers if item.topic == name}
    for kind in kinds & _COMMANDS.keys():
        topic = replace(_COMMANDS[kind], name=name)
        read = partial(decode.command, type_name=kind)
        subscribe(node, topic, read, hear_command, BEST_EFFORT)
    return scans_s, commands_s


def _observe(
    attempt: Attempt, node: Node, graph: Graph, goal: Pose2D, process: SupervisedProcess
) -> None:
    """Release the simulator, give the planner the goal; store rates and problems."""
    scans_s, commands_s = _listen(attempt, node, graph)
    topic = GOAL_POSE
    name = attempt.topics["goal_pose"]
    if name.startswith("/"):
        topic = replace(GOAL_POSE, name=name)
    goals = create_publisher(node, topic)
    message = PoseStampedEncoder(FRAMES.odom).encode(goal, 0)
    pause = node.create_client(SetBool, f"{_SIMULATOR}/pause")

    deadline_s = time.monotonic() + _SCAN_LIMIT_S
    next_goal_s = 0.0
    while time.monotonic() < deadline_s and not process.ended:
        rclpy.spin_once(node, timeout_sec=0.05)
        process.read()
        if not scans_s:
            if pause.service_is_ready():
                pause.call_async(SetBool.Request(data=False))
            continue
        if time.monotonic() > next_goal_s:
            next_goal_s = time.monotonic() + _GOAL_PERIOD_S
            goals.publish(message)
        deadline_s = scans_s[0] + _COMMAND_LIMIT_S
        if commands_s:
            deadline_s = commands_s[0] + _LISTEN_S

    attempt.scan_rate_hz = _rate_hz(scans_s)
    attempt.command_rate_hz = _rate_hz(commands_s)
    if commands_s:
        attempt.first_command_s = commands_s[0] - scans_s[0]
    elif scans_s:
        attempt.problems.append(f"no command within {_COMMAND_LIMIT_S:g} s of scans")
    else:
        attempt.problems.append("the simulator sends no scans")


def _rate_hz(times_s: list[float]) -> float | None:
    """Return the mean rate of events, None for fewer than three."""
    if len(times_s) < 3:
        return None
    return (len(times_s) - 1) / (times_s[-1] - times_s[0])
