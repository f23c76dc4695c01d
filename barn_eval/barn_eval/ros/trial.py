"""One trial over ROS, step by step: set up, wait, release, follow, judge."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from barn_eval.bags.live_score import LiveScore
from barn_eval.bags.recorder import Recorder
from barn_eval.bags.true_scene import first_scene, moving_scene
from barn_eval.experiments.ros_config import EvaluatorConfig
from barn_eval.ros.adapter import Judge, Judged, Punctuality
from barn_eval.ros.graph import GraphView
from barn_eval.ros.inbox import Feed, Inbox
from barn_eval.ros.instants import Instant
from barn_eval.ros.integrity import Integrity
from barn_eval.ros.planner import PlannerClient
from barn_eval.ros.recording import Recording, Scoreboard
from barn_eval.ros.simulator import SimulatorClient
from barn_eval.ros.simulator_line import SimulatorLine
from barn_eval.ros.station import PLANNER, SIMULATOR, Station, TrialEnded
from barn_eval.ros.watch import Watch
from barn_eval.trials.outcome import ENVIRONMENT, Outcome, Verdict
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trial import Trial
from barn_worlds.base.types import nanoseconds, seconds

_LOOK_S = 0.2  # between two looks at the graph while a trial runs
# Outcomes of a planner that is there and yet does nothing, of which the cause is looked for.
_UNEXPLAINED = (Outcome.NO_FIRST_MOTION, Outcome.PLANNER_STALLED, Outcome.PLANNER_NOT_READY)


@dataclass(frozen=True)
class Stage:
    """What all trials of a run are played on."""

    config: EvaluatorConfig
    station: Station
    view: GraphView
    inbox: Inbox
    recording: Recording
    simulator: SimulatorClient
    planner: PlannerClient
    scoreboard: Scoreboard
    clock_topic: str
    judged: Judged
    dataset: str
    integrity: Integrity
    line: SimulatorLine | None


class RosTrial:
    """One trial in progress.

    trial: what it has come to. first: whether the others may have been started just now. released: whether it came to
    driving. wall_s: how long it drove, in wall-clock time. planner_verdict: what the planner itself said of it, None
    where it is not asked.
    """

    def __init__(self, stage: Stage, spec: TrialSpec, recorder: Recorder | None, *, first: bool) -> None:
        self.trial = Trial(spec)
        self.released = False
        self.wall_s = 0.0
        self.planner_verdict: str | None = None
        self._stage = stage
        self._spec = spec
        self._recorder = recorder
        self._first = first
        self._judge: Judge | None = None
        self._feed: Feed | None = None
        self._score = LiveScore(spec)
        self._latest_ns: int | None = None
        self._origin_ns = 0

    @property
    def response_times_s(self) -> list[float]:
        """Time from each scan to the command that answered it."""
        return self._judge.response_times_s if self._judge is not None else []

    @property
    def punctuality(self) -> Punctuality | None:
        """Of the planner's commands; None where it did not come to driving."""
        return self._judge.punctuality if self._judge is not None else None

    @property
    def _simulated_ns(self) -> int:
        return self._latest_ns - self._origin_ns if self._latest_ns is not None else 0

    def run(self) -> Verdict:
        """Run to the verdict; whatever happens to the others, there is one."""
        stage = self._stage
        stage.station.begin_trial()
        stage.integrity.begin()
        try:
            feed = self._prepare()
            stage.simulator.release()
            verdict = self._follow(feed)
        except TrialEnded as end:
            if self._feed is not None:
                self._feed.read()
                self._feed.hand_over(self._take, all_of_it=True)
            verdict = self.trial.referee.fail(end.outcome, end.detail, end.blamed)
            self._show_standing()
        stage.station.end_trial()
        if (found := stage.integrity.look()) and verdict.fault != ENVIRONMENT:
            verdict = replace(verdict, outcome=Outcome.INTERFERENCE, detail=found, blamed="")
        self.planner_verdict = stage.planner.verdict
        stage.planner.dismiss()
        return self._explained(verdict)

    def _explained(self, verdict: Verdict) -> Verdict:
        """Return a verdict with what else speaks of its cause."""
        if verdict.outcome not in _UNEXPLAINED:
            return verdict
        stamps = self._feed.stamps.text() if self._feed is not None else ""
        clock = stamps or self._stage.planner.clock_fault()
        told = self.planner_verdict not in (None, "executing")
        own = f"its own verdict: {self.planner_verdict}" if told else ""
        return replace(verdict, detail="; ".join(filter(None, [verdict.detail, clock, own])))

    def _prepare(self) -> Feed:
        stage, inbox, patience = self._stage, self._stage.inbox, self._stage.config.patience
        limits_s = (patience.start_s,) * 2 if self._first else (patience.simulator_s, patience.gate_s)
        reset_ns = stage.simulator.prepare(self._spec, stage.dataset, limits_s[0])
        stage.planner.await_node(limits_s[1])
        if stage.planner.lifecycle.waiting_for():
            # many a node needs the time to pass, and transforms, to become active
            if stage.line is not None:
                stage.line.ignore()
            stage.simulator.release()
            stage.planner.lifecycle.await_active(patience.lifecycle_s)
            reset_ns = stage.simulator.prepare(self._spec, stage.dataset, patience.simulator_s)
        self._feed = feed = Feed(inbox, stage.clock_topic, stage.judged.command, reset_ns, stage.line)
        found = stage.planner.await_presence(limits_s[1])
        inbox.subscribe(stage.judged.command, found.command_type, reliable=found.command_reliable)
        self._await_connections([stage.clock_topic, *stage.judged.topics(), stage.judged.diagnostics])
        stage.integrity.require(stage.station)
        feed.check_stamps(stage.planner.topics())
        feed.read()
        stage.planner.instruct(self._spec, feed.now_ns)
        feed.release()
        self.released = True
        return feed

    def _await_connections(self, topics: Sequence[str]) -> None:
        """Wait until the evaluator hears all that it judges by, and simulator and planner hear each other."""
        stage, patience = self._stage, self._stage.config.patience
        limit_s = patience.service_s
        scan, command, diagnostics = stage.judged.scan, stage.judged.command, stage.judged.diagnostics

        def silent_topics() -> list[str]:
            silent = self._unheard(topics)
            return silent if scan in stage.inbox.topics() else [*silent, scan]

        if not stage.station.wait(lambda: not silent_topics(), limit_s, PLANNER, SIMULATOR):
            silent = silent_topics()
            planners = {command, diagnostics}.issuperset(silent)
            outcome = Outcome.PLANNER_NOT_READY if planners else Outcome.ENVIRONMENT_FAILED
            raise TrialEnded(outcome, f"no connection to {', '.join(silent)} within {limit_s:g} s")
        # what is only recorded is waited for as well, and then done without
        if not stage.station.wait(lambda: not self._unheard(stage.inbox.topics()), patience.connection_s):
            stage.station.note(f"no connection to {', '.join(self._unheard(stage.inbox.topics()))}")
        types = stage.inbox.topics()
        _, scans = stage.view.known_to_all(scan, types[scan])
        commands, _ = stage.view.known_to_all(command, types[command])
        if not stage.simulator.await_connections(scans, commands):
            stage.station.note("not all subscriptions to the scan are connected with the simulator")

    def _unheard(self, topics: Iterable[str]) -> list[str]:
        """Return which of the topics have more publishers than are connected, having looked for new topics."""
        stage = self._stage
        stage.recording.discover(everything=self._recorder is not None)
        return stage.inbox.unmatched({topic: len(stage.view.publishers(topic)) for topic in topics})

    def _follow(self, feed: Feed) -> Verdict:
        station = self._stage.station
        began_s = look_s = time.monotonic()
        watch = Watch(self._stage.config.patience, began_s)
        goal_period_ns = nanoseconds(self._spec.protocol.goal_period_s)
        goal_ns = feed.now_ns + goal_period_ns
        while True:
            ticks, commands = feed.ticks, feed.commands
            station.turn()
            feed.read()
            feed.hand_over(self._take)
            now_s = time.monotonic()
            self.wall_s = now_s - began_s
            if self.trial.verdict is not None:
                return self.trial.verdict
            station.check(PLANNER, SIMULATOR)
            if now_s >= look_s:
                look_s = now_s + _LOOK_S
                self._look(watch, now_s)
            self._keep_watch(watch, now_s, ticked=feed.ticks > ticks, commanded=feed.commands > commands)
            if goal_period_ns and feed.now_ns >= goal_ns:
                goal_ns = feed.now_ns + goal_period_ns
                self._stage.planner.repeat_goal(self._spec, feed.now_ns)

    def _keep_watch(self, watch: Watch, now_s: float, *, ticked: bool, commanded: bool) -> None:
        if ticked:
            watch.tick(now_s)
        if commanded:
            watch.command(now_s)
        fault = watch.judge(
            now_s,
            moved=self.trial.referee.clock_started,
            simulated_s=seconds(self._simulated_ns),
            waited_s=self._judge.waited_s if self._judge is not None else 0.0,
        )
        if fault is not None:
            raise TrialEnded(*fault)

    def _look(self, watch: Watch, now_s: float) -> None:
        self._stage.integrity.require(self._stage.station)
        if self._stage.planner.publishes():
            watch.publisher_seen(now_s)
        if self._recorder is not None:
            self._stage.recording.discover(everything=True)

    def _new_punctuality(self) -> Punctuality:
        rate_hz = self._stage.config.planner_rate_hz
        period_s = 1.0 / rate_hz if rate_hz else self._spec.protocol.control_period_s
        silence_s = max(self._spec.simulator.drive.command_timeout_s, 2.0 * period_s)
        return Punctuality(nanoseconds(period_s), nanoseconds(silence_s))

    def _take(self, instant: Instant) -> None:
        recording, recorder = self._stage.recording, self._recorder
        if self._judge is None:
            self._origin_ns = instant.stamp_ns
            self._judge = Judge(self._stage.judged, self.trial, instant.stamp_ns, self._new_punctuality())
            if recorder is not None:
                recording.begin(recorder, instant.stamp_ns)
                scene = first_scene(self._spec, instant.stamp_ns)
                self._stage.scoreboard.show([scene], instant.stamp_ns, recorder)
        over = self.trial.over  # several instants may arrive at once, some of them after the end
        kept = self._judge.take(instant)
        if recorder is not None:
            recording.write(recorder, kept, instant.stamp_ns)
        if recorder is not None and not over:
            moving = moving_scene(self._spec, instant.stamp_ns - self._origin_ns, instant.stamp_ns)
            self._stage.scoreboard.show(moving, instant.stamp_ns, recorder)
        self._latest_ns = instant.stamp_ns
        self._show_standing()

    def _show_standing(self) -> None:
        """Publish and record how the trial stands at the end of the last instant, when that is due."""
        if self._latest_ns is not None:
            shown = list(self._score.take(self.trial.standing, self._latest_ns))
            self._stage.scoreboard.show(shown, self._latest_ns, self._recorder)
