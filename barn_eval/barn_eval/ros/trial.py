"""One trial over ROS, step by step: set up, wait, release, follow, judge."""

import time
from collections.abc import Iterable
from dataclasses import replace

from rclpy.node import Node

from barn_eval.results.bags.messages import (
    TOPICS,
    ScoreReporter,
    initial_scene,
    moving_obstacle_scene,
)
from barn_eval.results.bags.recorder import Recorder
from barn_eval.ros.adapter import TrialAdapter, TrialTopics
from barn_eval.ros.graph import GraphView, Integrity, resolve_node_name
from barn_eval.ros.planner import PlannerClient
from barn_eval.ros.readiness import Endpoint, Watchdog
from barn_eval.ros.recording import Recording
from barn_eval.ros.sequencer import Tick
from barn_eval.ros.session import PLANNER, SIMULATOR, Session, TrialEnded
from barn_eval.ros.simulator import SimulatorChannel, SimulatorClient, SimulatorServices
from barn_eval.ros.subscriber import Subscriber, TrialQueue
from barn_eval.ros.supervision.process import EventChannel
from barn_eval.trials.outcome import ENVIRONMENT, Outcome, Verdict
from barn_eval.trials.ros_config import EvaluatorConfig
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trial import RunningTrial
from barn_worlds.base.types import nanoseconds, seconds
from barn_worlds.messages import topics as names
from barn_worlds.messages.topics import (
    BEST_EFFORT,
    CLOCK,
    COLLISION,
    GROUND_TRUTH,
    ODOM,
    RELIABLE,
)
from barn_worlds.ros.private_line import PrivateLine

_LOOK_S = 0.2  # between two looks at the graph while a trial runs
# Outcomes of a planner that is there and yet does nothing, of which the cause is sought, the first two by asking it.
_UNEXPLAINED = (
    Outcome.NO_FIRST_MOTION,
    Outcome.PLANNER_NOT_READY,
    Outcome.PLANNER_STALLED,
)


class RunContext:
    """What all trials of a run share: subscriptions, clients, and the view of the graph."""

    def __init__(
        self,
        node: Node,
        config: EvaluatorConfig,
        supervisor: EventChannel | None,
        dataset: str,
        robot: str,
    ) -> None:
        self.config = config
        self._simulator_name = resolve_node_name(node, config.simulator_node)
        self.view = GraphView(node)
        self.session = Session(node, supervisor, self._forget)
        judged = (
            CLOCK,
            ODOM,
            GROUND_TRUTH,
            COLLISION,
            names.CMD_VEL,
            names.SCAN,
            names.DIAGNOSTICS,
            names.PLAN,
        )
        self.topics = topics = TrialTopics(
            *(node.resolve_topic_name(topic.name) for topic in judged)
        )
        self.subscriber = Subscriber(node)
        self.channel = (
            self._connect()
        )  # brings what trials are judged by; None where that comes by topics
        own = [node.resolve_topic_name(topic.name) for topic in TOPICS]
        self.integrity = Integrity(
            self.view, self.channel, self._simulator_name, topics, own
        )
        needed = topics.scan, topics.diagnostics, topics.plan
        self.recording = Recording(node, self.subscriber, config.bag_exclude, needed)
        simulator = self.channel or SimulatorServices(
            self.session, self._simulator_name, SIMULATOR
        )
        self.simulator = SimulatorClient(
            self.session, simulator.ask, config.patience, dataset, robot
        )
        self.planner = PlannerClient(self.session, self.view, config)

    def _connect(self) -> SimulatorChannel | None:
        """See to it that what trials are judged by arrives."""
        node, private = self.session.node, self.config.simulator_fd >= 0
        names = {
            topic: node.resolve_topic_name(topic.name)
            for topic in (CLOCK, ODOM, GROUND_TRUTH, COLLISION)
        }
        for topic, name in names.items():
            if (
                private and topic is not CLOCK
            ):  # which shows how far the other topics are
                self.subscriber.provide(name, topic.type_name)
            else:
                self.subscriber.subscribe(name, topic.type_name)
        known_as = {topic.name: name for topic, name in names.items()}
        return (
            SimulatorChannel(
                self.session, PrivateLine(self.config.simulator_fd), known_as
            )
            if private
            else None
        )

    def _forget(self, name: str) -> None:
        """Leave out what a process had on the graph: the planner's is all but the simulator's."""
        of_simulator = self.channel.participant if self.channel is not None else b""

        def is_simulators(endpoint: Endpoint) -> bool:
            return (
                endpoint.participant == of_simulator
                if of_simulator
                else endpoint.node == self._simulator_name
            )

        self.view.leave_out(
            lambda endpoint: is_simulators(endpoint) != (name == PLANNER)
        )
        if name == PLANNER:
            self.planner.told.clear()
        if self.channel is not None and name == SIMULATOR:
            self.channel.participant = b""


class RosTrial:
    """One trial in progress; first: whether the others may have been started just now."""

    def __init__(
        self,
        context: RunContext,
        spec: TrialSpec,
        recorder: Recorder | None,
        *,
        first: bool,
    ) -> None:
        self.trial = RunningTrial(spec)  # what it has come to
        self.released = False  # whether it came to driving
        self.wall_s = 0.0  # how long it drove, in wall-clock time
        self.planner_verdict: str | None = (
            None  # what the planner itself said of it, where it is asked
        )
        self.adapter: TrialAdapter | None = (
            None  # what was measured on the way, once it drives
        )
        self._context, self._spec, self._recorder, self._first = (
            context,
            spec,
            recorder,
            first,
        )
        self._queue: TrialQueue | None = None
        self._score = ScoreReporter(spec)
        self._latest_ns: int | None = None
        self._origin_ns = 0

    def run(self) -> Verdict:
        """Run to the verdict; whatever happens to the others, there is one."""
        context = self._context
        context.session.begin_trial()
        context.integrity.begin()
        try:
            queue = self._prepare()
            context.simulator.release()
            verdict = self._follow(queue)
        except TrialEnded as end:
            if self._queue is not None:
                self._queue.read()
                self._queue.hand_over(self._take, all_of_it=True)
            verdict = self.trial.referee.fail(end.outcome, end.detail, end.culprit)
            self._show_standing()
        if (found := context.integrity.look()) and verdict.fault != ENVIRONMENT:
            verdict = replace(
                verdict, outcome=Outcome.INTERFERENCE, detail=found, culprit=""
            )
        self.planner_verdict = context.planner.goal.verdict
        context.planner.goal.end()
        return self._explained(verdict)

    def _explained(self, verdict: Verdict) -> Verdict:
        if verdict.outcome not in _UNEXPLAINED:
            return verdict
        clock = (
            self._context.planner.clock_fault()
            if verdict.outcome in _UNEXPLAINED[:2]
            else ""
        )
        own = (
            f"its own verdict: {self.planner_verdict}"
            if self.planner_verdict not in (None, "executing")
            else ""
        )
        return replace(
            verdict, detail="; ".join(filter(None, [verdict.detail, clock, own]))
        )

    def _prepare(self) -> TrialQueue:
        context, patience = self._context, self._context.config.patience
        simulator, planner = context.simulator, context.planner
        limits_s = (
            (patience.start_s,) * 2
            if self._first
            else (patience.simulator_s, patience.gate_s)
        )
        reset_ns = simulator.prepare(self._spec, limits_s[0])
        planner.await_node(limits_s[1])
        if planner.inactive():
            # many a node needs the time to pass, and transforms, to become active
            if context.channel is not None:
                context.channel.ignore()
            simulator.release()
            planner.await_active()
            reset_ns = simulator.prepare(self._spec, patience.simulator_s)
        self._queue = queue = TrialQueue(
            context.subscriber, context.topics, reset_ns, context.channel
        )
        found = planner.await_presence(limits_s[1])
        qos = RELIABLE if found.command_reliable else BEST_EFFORT
        context.subscriber.subscribe(context.topics.command, found.command_type, qos)
        self._await_connections()
        context.integrity.require(context.session)
        if self._first:
            planner.tell_parameters()
        queue.read()
        planner.instruct(self._spec, queue.now_ns)
        queue.release()
        self.released = True
        context.session.tell("released")
        return queue

    def _await_connections(self) -> None:
        """Wait until the evaluator hears all that it judges by, and simulator and planner hear each other."""
        context, patience = self._context, self._context.config.patience
        session, topics, limit_s = context.session, context.topics, patience.service_s

        def silent_topics() -> list[str]:
            silent = self._unheard(topics)
            return (
                silent
                if topics.scan in context.subscriber.topics()
                else [*silent, topics.scan]
            )

        if not session.wait(lambda: not silent_topics(), limit_s, PLANNER, SIMULATOR):
            silent = silent_topics()
            planners = {topics.command, topics.diagnostics}.issuperset(silent)
            outcome = (
                Outcome.PLANNER_NOT_READY if planners else Outcome.ENVIRONMENT_FAILED
            )
            raise TrialEnded(
                outcome, f"no connection to {', '.join(silent)} within {limit_s:g} s"
            )
        # what is only recorded is waited for as well, and then done without
        if not session.wait(
            lambda: not self._unheard(context.subscriber.topics()),
            patience.connection_s,
        ):
            session.note(
                f"no connection to {', '.join(self._unheard(context.subscriber.topics()))}"
            )
        types = context.subscriber.topics()
        _, scans = context.view.known_to_all(topics.scan, types[topics.scan])
        commands, _ = context.view.known_to_all(topics.command, types[topics.command])
        if not context.simulator.await_connections(scans, commands):
            session.note(
                "not all subscriptions to the scan are connected with the simulator"
            )

    def _unheard(self, topics: Iterable[str]) -> list[str]:
        """Return which of the topics have more publishers than are connected, having looked for new topics."""
        context = self._context
        context.recording.discover(everything=self._recorder is not None)
        return context.subscriber.unmatched(
            {topic: len(context.view.publishers(topic)) for topic in topics}
        )

    def _follow(self, queue: TrialQueue) -> Verdict:
        session = self._context.session
        began_s, look_s = time.monotonic(), session.now_s
        watchdog = Watchdog(
            self._context.config.patience, session.now_s, queue.commands
        )
        goal_period_ns = nanoseconds(self._spec.protocol.goal_period_s)
        goal_ns = queue.now_ns + goal_period_ns
        while True:
            session.spin()
            queue.read()
            queue.require_bounded()
            queue.hand_over(self._take)
            self.wall_s = time.monotonic() - began_s
            if self.trial.verdict is not None:
                return self.trial.verdict
            session.check(PLANNER, SIMULATOR)
            if (now_s := session.now_s) >= look_s:
                look_s = now_s + _LOOK_S
                self._look(watchdog, now_s)
            watchdog.hear(now_s, queue.ticks, queue.commands)
            simulated_s = (
                seconds(self._latest_ns - self._origin_ns)
                if self._latest_ns is not None
                else 0.0
            )
            waited_s = self.adapter.waited_s if self.adapter is not None else 0.0
            moved = self.trial.referee.clock_started
            if fault := watchdog.judge(
                now_s, moved=moved, simulated_s=simulated_s, waited_s=waited_s
            ):
                raise TrialEnded(*fault)
            if goal_period_ns and queue.now_ns >= goal_ns:
                goal_ns = queue.now_ns + goal_period_ns
                self._context.planner.repeat_goal(self._spec, queue.now_ns)

    def _look(self, watchdog: Watchdog, now_s: float) -> None:
        self._context.integrity.require(self._context.session)
        if self._context.planner.publishes():
            watchdog.publisher_seen(now_s)
        if self._recorder is not None:
            self._context.recording.discover(everything=True)

    def _begin(self, origin_ns: int) -> TrialAdapter:
        context, self._origin_ns = self._context, origin_ns
        if self._recorder is not None:
            context.recording.begin(self._recorder, origin_ns)
            context.recording.show(
                [initial_scene(self._spec, origin_ns)], origin_ns, self._recorder
            )
        command_type = context.subscriber.topics()[context.topics.command]
        config, map_given = context.config, self._spec.protocol.map_given
        plan_frame = (config.map_frame if map_given else config.odom_frame).lstrip("/")
        return TrialAdapter(
            context.topics, self.trial, origin_ns, command_type, plan_frame
        )

    def _take(self, tick: Tick) -> None:
        if self.adapter is None:
            self.adapter = self._begin(tick.stamp_ns)
        over = (
            self.trial.verdict is not None
        )  # several ticks may arrive at once, some of them after the end
        kept = self.adapter.take(tick)
        if self._recorder is not None:
            self._context.recording.write(self._recorder, kept, tick.stamp_ns)
            moving = (
                []
                if over
                else moving_obstacle_scene(
                    self._spec, tick.stamp_ns - self._origin_ns, tick.stamp_ns
                )
            )
            self._context.recording.show(moving, tick.stamp_ns, self._recorder)
        self._latest_ns = tick.stamp_ns
        self._show_standing()

    def _show_standing(self) -> None:
        """Publish and record how the trial stands at the end of the last tick, when that is due."""
        if self._latest_ns is not None:
            shown = list(self._score.take(self.trial.referee.standing, self._latest_ns))
            self._context.recording.show(shown, self._latest_ns, self._recorder)
