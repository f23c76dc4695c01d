"""One trial over ROS, step by step: set up, wait, release, follow, judge."""

import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from rclpy.node import Node

from barn_eval.results.bags.messages import (
    TOPICS,
    ScoreReporter,
    initial_scene,
    moving_obstacle_scene,
)
from barn_eval.results.bags.recorder import Recorder
from barn_eval.ros.adapter import TrialAdapter, TrialTopics
from barn_eval.ros.evaluator_loop import EvaluatorLoop, TrialEnded
from barn_eval.ros.graph import GraphView, Integrity, resolve_node_name
from barn_eval.ros.observed import ObservedQueue, ObservedSystem, ObservedTopics
from barn_eval.ros.planner import PlannerClient
from barn_eval.ros.readiness import Endpoint, Watchdog
from barn_eval.ros.recording import Recording
from barn_eval.ros.sequencer import Tick
from barn_eval.ros.simulator import SimulatorChannel, SimulatorClient, SimulatorServices
from barn_eval.ros.subscriber import Subscriber, TrialQueue
from barn_eval.ros.supervision.process import EventChannel
from barn_eval.trials.result import ENVIRONMENT, PLANNER, SIMULATOR, Outcome, Verdict
from barn_eval.trials.ros_config import EvaluatorConfig
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.system_file import read_system
from barn_eval.trials.trial import RunningTrial
from barn_worlds.base.types import nanoseconds, seconds
from barn_worlds.messages.topics import (
    BEST_EFFORT,
    CLOCK,
    CMD_VEL,
    COLLISION,
    DIAGNOSTICS,
    GROUND_TRUTH,
    ODOM,
    PLAN,
    RELIABLE,
    SCAN,
)
from barn_worlds.ros.private_line import PrivateLine

_TAIL_S = 2.0  # of a system, that are recorded after the verdict
_GRAPH_PERIOD_S = 0.2  # between two looks at the graph while a trial runs
# The simulator's readings, which a private line brings where there is one.
_READINGS = (CLOCK, ODOM, GROUND_TRUTH, COLLISION)
# Outcomes of a planner that does nothing. The row says its own result as well, and for
# the first two whether its clock is to blame.
_UNEXPLAINED = (
    Outcome.NO_FIRST_MOTION,
    Outcome.PLANNER_NOT_READY,
    Outcome.PLANNER_STALLED,
)
_CLOCK_RELATED = _UNEXPLAINED[:2]
# Outcomes that may mean that planner and clock wait for each other. No attempt at such
# a trial would end otherwise.
MUTUAL_WAITS = (Outcome.NO_FIRST_MOTION, Outcome.PLANNER_STALLED)


class RunContext:
    """What all trials of a run share: subscriptions, clients, view of the graph."""

    def __init__(
        self,
        node: Node,
        config: EvaluatorConfig,
        supervisor: EventChannel | None,
    ):
        """Create subscriptions, clients and the view of the graph for all trials.

        Args:
            node: The evaluator node.
            config: Parameters of the evaluator.
            supervisor: Channel to the process that started the other nodes, if any.
        """
        self.config = config
        self._simulator_name = resolve_node_name(node, config.simulator_node)
        # Before the loop, which leaves out what a process had on the graph.
        self.view = GraphView(node)
        self.loop = EvaluatorLoop(node, supervisor, self._forget_process)
        judged = (*_READINGS, CMD_VEL, SCAN, DIAGNOSTICS, PLAN)
        names = [node.resolve_topic_name(topic.name) for topic in judged]
        self.topics = TrialTopics(*names)
        self.subscriber = Subscriber(node)
        # The system that somebody else runs; None for the suite's simulator.
        self.system: ObservedSystem | None = None
        if config.system:
            self.topics = ObservedTopics(*names)
            self.subscriber.by_arrival = True
            file = read_system(Path(config.system))
            self.system = ObservedSystem(
                self.loop, file, config, self.subscriber, self.topics
            )
        # Brings the simulator's readings; None if they come by topics.
        self.channel = self._subscribe_to_readings()

        self.integrity = Integrity(
            self.view,
            self.channel,
            self._simulator_name,
            self.topics,
            [node.resolve_topic_name(topic.name) for topic in TOPICS],
        )
        self.recording = Recording(
            node,
            self.subscriber,
            config.bag_exclude,
            (self.topics.scan, self.topics.diagnostics, self.topics.plan),
        )

        simulator = self.channel or SimulatorServices(
            self.loop, self._simulator_name, SIMULATOR
        )
        self.simulator = self.system or SimulatorClient(
            self.loop, simulator.ask, config
        )
        self.planner = PlannerClient(self.loop, self.view, config)

    def _subscribe_to_readings(self) -> SimulatorChannel | None:
        """Return the private line's channel; without one, subscribe and return None."""
        node = self.loop.node
        is_private = self.config.simulator_fd >= 0
        topic_names = {}
        readings = _READINGS if self.system is None else (ODOM, COLLISION)
        for topic in readings:
            name = node.resolve_topic_name(topic.name)
            topic_names[topic.name] = name
            # /clock is subscribed to in any case: it shows how far DDS is.
            if is_private and topic is not CLOCK:
                self.subscriber.provide(name, topic.type_name)
            else:
                self.subscriber.subscribe(name, topic.type_name)
        if not is_private:
            return None
        return SimulatorChannel(
            self.loop, PrivateLine(self.config.simulator_fd), topic_names
        )

    def make_queue(self, reset_ns: int) -> TrialQueue:
        """Return a trial's queue after a reset; of a system, set planner's origin."""
        if self.system is None:
            return TrialQueue(self.subscriber, self.topics, reset_ns, self.channel)
        self.planner.origin = self.system.origin
        return ObservedQueue(self.system, self.subscriber, self.topics, reset_ns)

    def _forget_process(self, process: str) -> None:
        """Hide the endpoints of an ended "planner" or "simulator"; forget its data.

        All that is not the simulator's counts as the planner's.
        """
        participant = b""
        if self.channel is not None:
            participant = self.channel.participant

        def is_simulator(endpoint: Endpoint) -> bool:
            """Return whether the simulator's process or node has the endpoint."""
            if participant:
                return endpoint.participant == participant
            return endpoint.node == self._simulator_name

        is_planner = process == PLANNER
        self.view.leave_out(lambda endpoint: is_simulator(endpoint) != is_planner)
        if is_planner:
            # The next start of the planner may have other parameters.
            self.planner.parameters.clear()
        elif self.channel is not None:
            # Unknown until the next simulator introduces itself.
            self.channel.participant = b""


class RosTrial:
    """One trial in progress."""

    def __init__(
        self,
        context: RunContext,
        spec: TrialSpec,
        recorder: Recorder | None,
        *,
        first: bool,
    ):
        """Prepare a trial with its referee; send nothing yet.

        Args:
            context: What all trials of the run share.
            spec: The trial.
            recorder: Writes its bag; None where no bag is recorded.
            first: Whether simulator and planner may have been started just now.
        """
        # Readings, commands and verdict.
        self.trial = RunningTrial(spec)
        # Whether the trial came to driving, and for how much wall-clock time.
        self.released = False
        self.wall_s = 0.0
        # What the planner's own action says of the trial, if the goal is an action.
        self.action_result: str | None = None
        # What is measured of the drive; None before its first tick.
        self.adapter: TrialAdapter | None = None
        self._context = context
        self._spec = spec
        self._recorder = recorder
        self._first = first
        self._queue: TrialQueue | None = None
        self._score = ScoreReporter(spec)
        self._latest_ns: int | None = None
        self._origin_ns = 0

    @property
    def uncertainty_s(self) -> float | None:
        """Longest time without a reading, by which times may be off; None if unknown."""
        if isinstance(self._queue, ObservedQueue):
            return seconds(self._queue.longest_gap_ns)
        return None

    def run(self) -> Verdict:
        """Run the trial and return its verdict, also if a node fails or ends."""
        context = self._context
        context.loop.begin_trial()
        context.integrity.begin()
        try:
            queue = self._prepare()
            context.simulator.release()
            verdict = self._follow(queue)
        except TrialEnded as end:
            if self._queue is not None:
                # What was sent before the end belongs to the trial, even if the last
                # tick lacks something.
                self._queue.read()
                self._queue.hand_over(self._take, incomplete=True)
            verdict = self.trial.referee.fail(end.outcome, end.detail, end.culprit)
            self._show_score()

        # The looks while driving leave gaps, so there is a last one. A failure of the
        # environment stands: such a trial runs again in any case.
        interference = context.integrity.look()
        if interference and verdict.fault != ENVIRONMENT:
            verdict = replace(
                verdict, outcome=Outcome.INTERFERENCE, detail=interference, culprit=""
            )
        # Read before `end`, which cancels the goal and forgets its result.
        self.action_result = context.planner.goal.action_result
        context.planner.goal.end()
        return self._explain(verdict)

    def _explain(self, verdict: Verdict) -> Verdict:
        """Return the verdict; of an idle planner, its detail names likely causes."""
        if verdict.outcome not in _UNEXPLAINED:
            return verdict
        details = [verdict.detail]
        if verdict.outcome in _CLOCK_RELATED:
            details.append(self._context.planner.clock_problem())
        if verdict.outcome in MUTUAL_WAITS:
            details.append(self._context.planner.idle_topics())
        if self.action_result not in (None, "executing"):
            details.append(f"its action's result: {self.action_result}")
        return replace(verdict, detail="; ".join(filter(None, details)))

    def _prepare(self) -> TrialQueue:
        """Reset simulator, await and reset planner, send the goal; or TrialEnded.

        Returns the queue of the trial's messages; simulated time is still stopped.
        """
        context = self._context
        patience = context.config.patience
        simulator = context.simulator
        planner = context.planner
        simulator_limit_s = patience.simulator_s
        planner_limit_s = patience.gate_s
        if self._first:
            simulator_limit_s = patience.start_s
            planner_limit_s = patience.start_s

        reset_ns = simulator.prepare(self._spec, simulator_limit_s)
        planner.await_node(planner_limit_s)
        # A node that is active already must not lose the time of a second reset.
        if planner.inactive_nodes():
            # To become active, many nodes need passing time and transforms.
            if context.channel is not None:
                context.channel.ignore()
            simulator.release()
            planner.await_active()
            reset_ns = simulator.prepare(self._spec, patience.simulator_s)
        queue = context.make_queue(reset_ns)
        self._queue = queue

        finding = planner.await_presence(planner_limit_s, first=self._first)
        # A reliable subscription hears nothing of a best-effort publisher.
        qos = RELIABLE if finding.command_reliable else BEST_EFFORT
        context.subscriber.subscribe(context.topics.command, finding.command_type, qos)
        self._await_connections()
        context.integrity.require(context.loop)
        if self._first:
            planner.report_parameters()
        queue.read()
        planner.instruct(self._spec, queue.now_ns)
        queue.release()
        self.released = True
        context.loop.report("released")
        return queue

    def _await_connections(self) -> None:
        """Wait for connections; TrialEnded for judged topics, a note for others."""
        context = self._context
        loop = context.loop
        subscriber = context.subscriber
        topics = context.topics
        limit_s = context.config.patience.service_s

        def silent_topics() -> list[str]:
            """Return judged topics with a publisher that is not connected."""
            silent = self._find_unmatched(topics)
            if topics.scan not in subscriber.topics():
                silent.append(topics.scan)
            return silent

        if not loop.wait(lambda: not silent_topics(), limit_s, PLANNER, SIMULATOR):
            silent = silent_topics()
            outcome = Outcome.ENVIRONMENT_FAILED
            if {topics.command, topics.diagnostics}.issuperset(silent):
                outcome = Outcome.PLANNER_NOT_READY
            raise TrialEnded(
                outcome, f"no connection to {', '.join(silent)} within {limit_s:g} s"
            )

        # The bag does without topics that are not connected after a time.
        if not loop.wait(
            lambda: not self._find_unmatched(subscriber.topics()),
            context.config.patience.connection_s,
        ):
            silent = self._find_unmatched(subscriber.topics())
            loop.note(f"no connection to {', '.join(silent)}")

        # The simulator counts all connections of its types, so the evaluator's own
        # endpoints and those of dead processes count here, too.
        types = subscriber.topics()
        scan_infos = loop.node.get_subscriptions_info_by_topic(topics.scan)
        command_infos = loop.node.get_publishers_info_by_topic(topics.command)
        scans = [info.topic_type for info in scan_infos]
        commands = [info.topic_type for info in command_infos]
        if not context.simulator.await_connections(
            scans.count(types[topics.scan]), commands.count(types[topics.command])
        ):
            loop.note(
                "not all subscriptions to the scan are connected to the simulator"
            )

    def _find_unmatched(self, topics: Iterable[str]) -> list[str]:
        """Discover topics; return those of `topics` with an unconnected publisher."""
        context = self._context
        context.recording.discover(everything=self._recorder is not None)
        return [
            topic
            for topic in topics
            if context.subscriber.count_publishers(topic)
            < len(context.view.publishers(topic))
        ]

    def _follow(self, queue: TrialQueue) -> Verdict:
        """Spin, judge, record, repeat the goal to a verdict, or raise TrialEnded."""
        context = self._context
        loop = context.loop
        start_s = time.monotonic()
        next_look_s = loop.now_s
        tick = "no tick of /clock"
        if context.system is not None:
            tick = f"no message on {context.topics.odometry}"
        watchdog = Watchdog(context.config.patience, loop.now_s, queue.commands, tick)
        goal_period_ns = nanoseconds(self._spec.protocol.goal_period_s)
        next_goal_ns = queue.now_ns + goal_period_ns

        while True:
            loop.spin()
            queue.read()
            queue.require_bounded()
            queue.hand_over(self._take)
            self.wall_s = time.monotonic() - start_s
            if self.trial.verdict is not None:
                self._record_tail(queue)
                return self.trial.verdict

            loop.require_alive(PLANNER, SIMULATOR)
            if context.channel is not None and context.channel.tip:
                raise TrialEnded(Outcome.ROBOT_TIPPED, context.channel.tip)
            # A look at the graph may take time, in which nothing is read: the watchdog
            # must judge by the time before it.
            now_s = loop.now_s
            if now_s >= next_look_s:
                next_look_s = now_s + _GRAPH_PERIOD_S
                self._look_at_graph(watchdog, now_s)
            watchdog.hear(now_s, queue.ticks, queue.commands)
            self._require_progress(watchdog, now_s)
            if goal_period_ns and queue.now_ns >= next_goal_ns:
                next_goal_ns = queue.now_ns + goal_period_ns
                context.planner.repeat_goal(self._spec, queue.now_ns)

    def _record_tail(self, queue: TrialQueue) -> None:
        """End a system's trial for the operator; record 2 s more if there is a bag."""
        loop = self._context.loop
        if self._context.system is None:
            return
        # Its odometry shows the arrival late. What the operator says from now on does
        # not count.
        self._context.system.pause()
        if self._recorder is None:
            return
        end_s = loop.now_s + _TAIL_S
        # Whatever happens now is after the trial.
        with suppress(TrialEnded):
            while loop.now_s < end_s:
                loop.spin()
                queue.read()
                queue.hand_over(self._take)

    def _look_at_graph(self, watchdog: Watchdog, now_s: float) -> None:
        """Raise TrialEnded on interference; note the planner, find topics to record."""
        context = self._context
        context.integrity.require(context.loop)
        if context.view.publishers(context.topics.command):
            watchdog.publisher_seen(now_s)
        if self._recorder is not None:
            context.recording.discover(everything=True)

    def _require_progress(self, watchdog: Watchdog, now_s: float) -> None:
        """Raise TrialEnded if the watchdog says that simulator or planner hangs."""
        simulated_s = 0.0
        waited_s = 0.0
        if self.adapter is not None:
            simulated_s = seconds(self.adapter.now_ns - self._origin_ns)
            waited_s = self.adapter.waited_s
        fault = watchdog.judge(
            now_s,
            has_started=self.trial.referee.clock_started,
            simulated_s=simulated_s,
            waited_s=waited_s,
        )
        if fault is None:
            return
        outcome, detail = fault
        culprit = ""
        # Then neither the planner nor the simulator can go on.
        planner = self._context.planner
        if (
            outcome in MUTUAL_WAITS
            and watchdog.is_clock_standing(now_s)
            and planner.follows_clock()
        ):
            culprit = ENVIRONMENT
            detail += (
                "; lockstep waits for a command, and the planner may wait for the"
                " clock: declare its rate by --ros planner_rate_hz, set command_wait_s"
                " below patience.command_s, or run with --ros lockstep=false"
            )
        raise TrialEnded(outcome, detail, culprit)

    def _begin(self, origin_ns: int) -> TrialAdapter:
        """Begin the bag, if any, at the first tick; return the trial's adapter."""
        context = self._context
        self._origin_ns = origin_ns
        if self._recorder is not None:
            context.recording.begin(self._recorder, origin_ns)
            context.recording.show(
                [initial_scene(self._spec, origin_ns)], origin_ns, self._recorder
            )

        command_type = context.subscriber.topics()[context.topics.command]
        frame = context.config.odom_frame
        if self._spec.protocol.map_given:
            frame = context.config.map_frame
        convert_pose = None
        if context.system is not None:
            convert_pose = context.system.convert_pose
        return TrialAdapter(
            context.topics,
            self.trial,
            origin_ns,
            command_type,
            frame.lstrip("/"),
            convert_pose,
        )

    def _take(self, tick: Tick) -> None:
        """Judge a tick, record messages and scene if there is a bag, show the score."""
        stamp_ns = tick.stamp_ns
        if self.adapter is None:
            self.adapter = self._begin(stamp_ns)
        # Several ticks may arrive at once, some of them after the verdict.
        is_over = self.trial.verdict is not None
        system = self._context.system
        if system is not None and not is_over and system.take_contact():
            self.adapter.touch()
        messages = self.adapter.take(tick)
        if system is not None and is_over:
            messages = tick.messages
        if self._recorder is not None:
            recording = self._context.recording
            recording.write(self._recorder, messages, stamp_ns)
            if not is_over:
                recording.show(
                    moving_obstacle_scene(
                        self._spec, stamp_ns - self._origin_ns, stamp_ns
                    ),
                    stamp_ns,
                    self._recorder,
                )
        self._latest_ns = stamp_ns
        self._show_score()

    def _show_score(self) -> None:
        """Publish and record the score if it is due: twice a second, and at the end."""
        if self._latest_ns is not None:
            messages = self._score.take(self.trial.referee, self._latest_ns)
            self._context.recording.show(
                list(messages), self._latest_ns, self._recorder
            )
