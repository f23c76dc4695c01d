"""The evaluator node: resets the simulator, waits for the planner, sends the goal, judges, records, repeats.

Subscribes /clock, cmd_vel, scan and, for the bags, whatever else is published. It judges by /clock, odom,
ground_truth/odom and collision, which come by a private line from a simulator that the same supervisor has started, and
by topics from one that was started by hand; the latter is led by its set_parameters, ~/reset and ~/pause.
Publishes goal_pose (PoseStamped), or sends the goal to an action, and, where the protocol gives a map, map
(OccupancyGrid, transient local). Calls the planner's set_parameters (seed), ~/reset and ~/ready where they are offered,
and ~/get_state of managed nodes. Parameters are those of `barn_eval.experiments.ros_config.EvaluatorConfig`.
How the trial stands is published on /score (Float64), /outcome (String) and /score_text (MarkerArray).
"""

import os
import signal
import socket
import sys
from pathlib import Path

import rclpy
from rclpy.node import Node

from barn_eval.bags.live_score import TOPICS
from barn_eval.bags.true_scene import TRUE_TOPICS
from barn_eval.experiments.experiment import Execution, Experiment, PlannerChoice
from barn_eval.experiments.folder import opened
from barn_eval.experiments.ros_config import EvaluatorConfig
from barn_eval.experiments.store import Record, Store
from barn_eval.ros.adapter import Judged
from barn_eval.ros.gate import Endpoint
from barn_eval.ros.graph import GraphView, resolve_node_name
from barn_eval.ros.inbox import Inbox
from barn_eval.ros.integrity import Integrity
from barn_eval.ros.planner import PlannerClient
from barn_eval.ros.recording import Recording, Scoreboard
from barn_eval.ros.remote import RemoteNode
from barn_eval.ros.runner import Runner
from barn_eval.ros.simulator import SimulatorClient
from barn_eval.ros.simulator_line import SimulatorLine
from barn_eval.ros.station import PLANNER, SIMULATOR, Abandoned, Station
from barn_eval.ros.supervision.link import Assignment, Link
from barn_eval.ros.trial import Stage
from barn_eval.trials.protocol import load_protocol
from barn_eval.trials.result import to_json_line
from barn_eval.trials.spec import simulator_config
from barn_worlds.base.errors import BarnError
from barn_worlds.base.types import Velocity2D
from barn_worlds.messages import decode, topics
from barn_worlds.messages.topics import CLOCK, COLLISION, GROUND_TRUTH, ODOM
from barn_worlds.robots.files import load_robot
from barn_worlds.ros.parameters import declare
from barn_worlds.ros.private_line import PrivateLine


def main(arguments: list[str] | None = None) -> int:
    """Run the evaluator until its run is complete; return 0, or 1 after a mistake in the input or an interruption."""
    # rclpy ends its context on Ctrl-C, and so every wait; an exception on top of that would strike anywhere
    signal.signal(signal.SIGINT, lambda *_: None)
    rclpy.init(args=arguments)
    node = Node("evaluator")
    link = None
    try:
        config = declare(node, EvaluatorConfig(), read_only=True)
        link = Link(socket.socket(fileno=config.supervisor_fd)) if config.supervisor_fd >= 0 else None
        run_assigned(node, config, link) if link is not None else run_alone(node, config)
        return 0
    except BarnError as error:
        node.get_logger().fatal(str(error))
        if link is not None:
            link.send("refused", reason=str(error))
        return 1
    except Abandoned:
        return 1
    except Exception:
        if rclpy.ok():
            raise
        return 1  # a signal has ended ROS while something was about to be made with it
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def run_assigned(node: Node, config: EvaluatorConfig, link: Link) -> None:
    """Run what the supervisor has assigned; results go to it."""
    assignment = Assignment.read(Path(config.assignment))
    stage = build_stage(node, config, link, assignment.experiment.dataset, assignment.robot)

    def keep(record: Record) -> None:
        stage.station.tell("result", row=to_json_line(record.result), track=record.track or "")

    if assignment.look_first:
        stage.integrity.require_alone(stage.station, os.environ.get("ROS_DOMAIN_ID", ""))
        for name in (SIMULATOR, PLANNER):
            stage.station.tell("start", name=name)
    Runner(stage, assignment.store, keep).run(assignment.specs())
    stage.station.tell("done")


def run_alone(node: Node, config: EvaluatorConfig) -> None:
    """Run what the parameters say, with a simulator and a planner that somebody else starts."""
    protocol = load_protocol(config.protocol)
    experiment = Experiment(
        dataset=config.dataset,
        worlds=config.worlds,
        planners=(PlannerChoice(config.planner),),
        protocol=protocol,
        simulator=simulator_config(protocol, robot=load_robot(config.robot)),
        mode="ros",
        seed=config.seed,
        repetitions=config.repetitions,
        bags=config.bags,
    )
    execution, out = Execution(workers=1, pictures=True), Path(config.out)
    with opened(out, experiment, execution, experiment.trials(started_by_hand=True)) as folder:
        stage = build_stage(node, config, None, config.dataset, config.robot)
        Runner(stage, Store(out, config.bags, execution.pictures), folder.append).run(folder.remaining)
        folder.complete()


def build_stage(node: Node, config: EvaluatorConfig, link: Link | None, dataset: str, robot: str) -> Stage:
    """Set up what all trials share: subscriptions, clients, and the view of the graph."""
    view = GraphView(node)
    simulator_name = resolve_node_name(node, config.simulator_node)

    def forget(name: str) -> None:
        """Leave out what a process had on the graph: the planner's is all but the simulator's."""
        of_simulator = line.participant if line is not None else b""

        def is_simulators(endpoint: Endpoint) -> bool:
            return endpoint.participant == of_simulator if of_simulator else endpoint.node == simulator_name

        view.leave_out(lambda endpoint: is_simulators(endpoint) != (name == PLANNER))
        if line is not None and name == SIMULATOR:
            line.forget()

    station = Station(node, link, forget)
    inbox = Inbox(node)
    judged, clock_topic = judged_topics(node, inbox), node.resolve_topic_name(CLOCK.name)
    line = connect_simulator(station, inbox, config)
    return Stage(
        config=config,
        station=station,
        view=view,
        inbox=inbox,
        recording=Recording(
            node,
            inbox,
            {*config.bag_exclude, *(topic.path for topic in (*TRUE_TOPICS, *TOPICS))},
            wake=judged.scan,
            needed={judged.scan, judged.diagnostics},
        ),
        simulator=SimulatorClient(
            station, line or RemoteNode(station, simulator_name, SIMULATOR), config.patience, robot
        ),
        planner=PlannerClient(station, view, config),
        scoreboard=Scoreboard(node, config.bag_exclude),
        clock_topic=clock_topic,
        judged=judged,
        dataset=dataset,
        integrity=Integrity(
            view,
            line,
            simulator_name,
            theirs=(clock_topic, judged.scan, judged.odometry, judged.truth, judged.collision),
            ours=[node.resolve_topic_name(topic.name) for topic in TOPICS],
            truth=judged.truth,
            command=judged.command,
        ),
        line=line,
    )


def connect_simulator(station: Station, inbox: Inbox, config: EvaluatorConfig) -> SimulatorLine | None:
    """See to it that what trials are judged by arrives, and return the line that it comes by, None where by topics."""
    node = station.node
    names = {topic: node.resolve_topic_name(topic.name) for topic in (CLOCK, ODOM, GROUND_TRUTH, COLLISION)}
    if config.simulator_fd < 0:
        for topic, name in names.items():
            inbox.subscribe(name, topic.type_name)
        return None
    inbox.subscribe(names[CLOCK], CLOCK.type_name)  # shows how far the other topics are
    for topic in (ODOM, GROUND_TRUTH, COLLISION):
        inbox.provide(names[topic], topic.type_name)
    known_as = {topic.name: name for topic, name in names.items()}
    return SimulatorLine(station, PrivateLine(config.simulator_fd), known_as)


def judged_topics(node: Node, inbox: Inbox) -> Judged:
    """Return the topics that a trial is judged by, after remapping, and how its commands are read."""
    command = node.resolve_topic_name(topics.CMD_VEL.name)

    def read_command(data: bytes) -> Velocity2D:
        return decode.command(data, inbox.topics()[command])

    return Judged(
        odometry=node.resolve_topic_name(topics.ODOM.name),
        truth=node.resolve_topic_name(topics.GROUND_TRUTH.name),
        collision=node.resolve_topic_name(topics.COLLISION.name),
        command=command,
        scan=node.resolve_topic_name(topics.SCAN.name),
        diagnostics=node.resolve_topic_name(topics.DIAGNOSTICS.name),
        read_command=read_command,
    )


if __name__ == "__main__":
    sys.exit(main())
