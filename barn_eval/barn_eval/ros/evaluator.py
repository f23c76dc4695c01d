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

from barn_eval.bags.messages import TOPICS, TRUE_TOPICS
from barn_eval.experiments.experiment import Execution, Experiment, PlannerChoice
from barn_eval.experiments.folder import opened
from barn_eval.experiments.ros_config import EvaluatorConfig
from barn_eval.experiments.store import Record, Store
from barn_eval.ros.adapter import TrialTopics
from barn_eval.ros.graph import GraphView, resolve_node_name
from barn_eval.ros.integrity import Integrity
from barn_eval.ros.planner import PlannerClient
from barn_eval.ros.readiness import Endpoint
from barn_eval.ros.recording import Recording, ScorePublisher
from barn_eval.ros.remote import RemoteNode
from barn_eval.ros.runner import Runner
from barn_eval.ros.session import PLANNER, SIMULATOR, Abandoned, Session
from barn_eval.ros.simulator import SimulatorClient
from barn_eval.ros.simulator_channel import SimulatorChannel
from barn_eval.ros.subscriber import Subscriber
from barn_eval.ros.supervision.channel import Assignment, EventChannel
from barn_eval.ros.trial import RunContext
from barn_eval.trials.protocol import load_protocol
from barn_eval.trials.result import to_json_line
from barn_eval.trials.spec import simulator_config
from barn_worlds.base.errors import BarnError
from barn_worlds.base.types import Velocity2D
from barn_worlds.messages import decode
from barn_worlds.messages.topics import CLOCK, CMD_VEL, COLLISION, DIAGNOSTICS, GROUND_TRUTH, ODOM, SCAN
from barn_worlds.robots.files import load_robot
from barn_worlds.ros.parameters import declare
from barn_worlds.ros.private_line import PrivateLine


def main(arguments: list[str] | None = None) -> int:
    """Run the evaluator until its run is complete; return 0, or 1 after a mistake in the input or an interruption."""
    # rclpy ends its context on Ctrl-C, and so every wait; an exception on top of that would strike anywhere
    signal.signal(signal.SIGINT, lambda *_: None)
    rclpy.init(args=arguments)
    node = Node("evaluator")
    supervisor = None
    try:
        config = declare(node, EvaluatorConfig(), read_only=True)
        if config.supervisor_fd < 0:
            run_alone(node, config)
        else:
            supervisor = EventChannel(socket.socket(fileno=config.supervisor_fd))
            run_assigned(node, config, supervisor)
        return 0
    except BarnError as error:
        node.get_logger().fatal(str(error))
        if supervisor is not None:
            supervisor.send("refused", reason=str(error))
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


def run_assigned(node: Node, config: EvaluatorConfig, supervisor: EventChannel) -> None:
    """Run what the supervisor has assigned; results go to it."""
    assignment = Assignment.read(Path(config.assignment))
    context = build_context(node, config, supervisor, assignment.experiment.dataset, assignment.robot)

    def keep(record: Record) -> None:
        context.session.tell("result", row=to_json_line(record.result), track=record.track or "")

    if assignment.look_first:
        context.integrity.require_alone(context.session, os.environ.get("ROS_DOMAIN_ID", ""))
        for name in (SIMULATOR, PLANNER):
            context.session.tell("start", name=name)
    Runner(context, assignment.store, keep).run(assignment.specs())
    context.session.tell("done")


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
        context = build_context(node, config, None, config.dataset, config.robot)
        Runner(context, Store(out, config.bags, execution.pictures), folder.append).run(folder.remaining)
        folder.complete()


def build_context(
    node: Node, config: EvaluatorConfig, supervisor: EventChannel | None, dataset: str, robot: str
) -> RunContext:
    """Set up what all trials share: subscriptions, clients, and the view of the graph."""
    view = GraphView(node)
    simulator_name = resolve_node_name(node, config.simulator_node)

    def forget(name: str) -> None:
        """Leave out what a process had on the graph: the planner's is all but the simulator's."""
        of_simulator = channel.participant if channel is not None else b""

        def is_simulators(endpoint: Endpoint) -> bool:
            return endpoint.participant == of_simulator if of_simulator else endpoint.node == simulator_name

        view.leave_out(lambda endpoint: is_simulators(endpoint) != (name == PLANNER))
        if channel is not None and name == SIMULATOR:
            channel.participant = b""

    session, subscriber = Session(node, supervisor, forget), Subscriber(node)
    topics = topics_of_trial(node, subscriber)
    channel = connect_simulator(session, subscriber, config)
    unrecorded = {*config.bag_exclude, *(topic.path for topic in (*TRUE_TOPICS, *TOPICS))}
    simulator = channel or RemoteNode(session, simulator_name, SIMULATOR)
    return RunContext(
        config=config,
        session=session,
        view=view,
        subscriber=subscriber,
        recording=Recording(node, subscriber, unrecorded, wake=topics.scan, needed={topics.scan, topics.diagnostics}),
        simulator=SimulatorClient(session, simulator, config.patience, robot),
        planner=PlannerClient(session, view, config),
        scores=ScorePublisher(node, config.bag_exclude),
        topics=topics,
        dataset=dataset,
        integrity=Integrity(
            view,
            channel,
            simulator_name,
            theirs=(topics.clock, topics.scan, topics.odometry, topics.truth, topics.collision),
            ours=[node.resolve_topic_name(topic.name) for topic in TOPICS],
            truth=topics.truth,
            command=topics.command,
        ),
        channel=channel,
    )


def connect_simulator(session: Session, subscriber: Subscriber, config: EvaluatorConfig) -> SimulatorChannel | None:
    """See to it that what trials are judged by arrives; return the channel that it comes by, None where by topics."""
    names = {topic: session.node.resolve_topic_name(topic.name) for topic in (CLOCK, ODOM, GROUND_TRUTH, COLLISION)}
    private = config.simulator_fd >= 0
    for topic, name in names.items():
        if private and topic is not CLOCK:  # which shows how far the other topics are
            subscriber.provide(name, topic.type_name)
        else:
            subscriber.subscribe(name, topic.type_name)
    known_as = {topic.name: name for topic, name in names.items()}
    return SimulatorChannel(session, PrivateLine(config.simulator_fd), known_as) if private else None


def topics_of_trial(node: Node, subscriber: Subscriber) -> TrialTopics:
    """Return the topics that a trial is judged by, after remapping, and how its commands are read."""
    judged = (CLOCK, ODOM, GROUND_TRUTH, COLLISION, CMD_VEL, SCAN, DIAGNOSTICS)
    clock, odometry, truth, collision, command, scan, diagnostics = (
        node.resolve_topic_name(topic.name) for topic in judged
    )

    def read_command(data: bytes) -> Velocity2D:
        return decode.command(data, subscriber.topics()[command])

    return TrialTopics(clock, odometry, truth, collision, command, scan, diagnostics, read_command)


if __name__ == "__main__":
    sys.exit(main())
