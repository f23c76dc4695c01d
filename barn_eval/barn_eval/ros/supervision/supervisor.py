"""Runs trials of a planner over ROS: starts, watches and ends the three processes."""

import json
import math
import multiprocessing.connection
import os
import shutil
import signal
import socket
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import Any

from barn_eval.results.store import LOGS, BagStore, TrialRecord
from barn_eval.ros.isolation import can_isolate
from barn_eval.ros.supervision import launcher, nodes
from barn_eval.ros.supervision.nodes import PLANNER_SUSPECTED, Assignment, NodeProcess
from barn_eval.ros.supervision.process import (
    EventChannel,
    ProcessError,
    SupervisedProcess,
    last_lines,
)
from barn_eval.running.command_files import write_node_parameters
from barn_eval.running.planner_sources import explain_end
from barn_eval.trials.result import (
    ENVIRONMENT,
    PLANNER,
    SIMULATOR,
    Outcome,
    TrialResult,
    Verdict,
    from_json_line,
)
from barn_eval.trials.run_config import RunConfig
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trajectory import TrajectoryLog
from barn_eval.trials.trial import finish_trial, signal_handler
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import ConfigError, convert_os_errors
from barn_worlds.base.files import write_durably
from barn_worlds.ros import private_line
from barn_worlds.ros.domain import is_domain_in_use, reserve_domain

EVALUATOR = "evaluator"
# Evaluators that may be lost in a row without a result in between.
_MAX_LOST_EVALUATORS = 3
# A file that a planner's command names is kept beside its logs up to this size.
_MAX_COPY_BYTES = 1 << 20
_START_PERIOD_S = 1.0  # shortest time from one start of a process to the next
_LONGEST_WAIT_S = 0.5


def run_ros_trials(
    run: RunConfig,
    trials: Sequence[TrialSpec],
    store: BagStore,
    logs: Path | None = None,
    notice: Callable[[str], None] = lambda _: None,
) -> Generator[TrialRecord, None, None]:
    """Run one planner's trials over ROS in three processes, and yield a record of each.

    All processes have ended when the iteration has, whatever ends it, and also if this
    process is killed.

    Args:
        run: The run.
        trials: Its trials of one planner.
        store: Where trials leave their bags.
        logs: Folder for what the nodes print; by default one in the store's.
        notice: Gets a line about each process that has ended unasked.

    Yields:
        Record of each trial.

    Raises:
        ProcessError: If the nodes cannot be run, with the last lines of a log.
        ConfigError: For what is not allowed.
    """
    if not trials:
        return
    logs = logs or store.folder / LOGS
    with convert_os_errors(ConfigError, logs):
        logs.mkdir(parents=True, exist_ok=True)
    with reserve_domain(os.environ) as domain, signal_handler(signal.SIGTERM, _exit):
        node_environment = nodes.environment(os.environ, domain)
        # Nodes that take part in the domain may be in the way: the evaluator looks.
        look_first = is_domain_in_use(domain)
        supervisor = _Supervisor(
            run, trials, store, logs, node_environment, notice, look_first
        )
        try:
            yield from supervisor.run()
        finally:
            supervisor.stop()


@dataclass
class _Supervisor:
    """Keeps the three processes running until the evaluator has run all trials."""

    config: RunConfig
    trials: Sequence[TrialSpec]
    store: BagStore
    logs: Path
    environment: Mapping[str, str]
    notice: Callable[[str], None]

    # Whether the evaluator looks for other nodes before any of these starts.
    look_first: bool

    def __post_init__(self) -> None:
        """Prepare processes, copy the planner's files to logs; start nothing."""
        # Trials without a result.
        self._remaining = {spec.trial_id: spec for spec in self.trials}
        planner = self.config.planner(self.trials[0].planner)
        self._planner = planner
        # Evaluator and planner node know no other planners of the run.
        self.config = replace(self.config, planners=(planner,))
        if planner.takes_goal_at_start:
            # It is not told of a second goal, so each trial has a planner of its own.
            inputs = [x for x in self.config.ros.required_inputs if x != "goal_pose"]
            ros = replace(
                self.config.ros,
                restart_planner="each_trial",
                required_inputs=tuple(inputs),
            )
            self.config = replace(self.config, ros=ros)
        self._evaluator: EventChannel | None = None
        self._processes: dict[str, SupervisedProcess] = {}
        # Monotonic times at which processes are to be started, and were last.
        self._due_s: dict[str, float] = {}
        self._started_s: dict[str, float] = {}
        self._quoted_logs: set[str] = set()
        self._parameters_kept = False
        self._lost_evaluators = 0
        self._isolated = self.config.ros.isolate and can_isolate()
        self._done = False

        # The trial in progress, whether its robot drives, and why trials are repeated
        # that drove. The file names the last of those: if it has no row when a run
        # begins, the run before ended in its midst.
        self._trial = ""
        self._driving = False
        self._driving_file = self.logs / "released"
        self._repeats: dict[str, list[str]] = {}
        if self._driving_file.exists():
            interrupted = self._driving_file.read_text("utf-8")
            if interrupted in self._remaining:
                self._repeats[interrupted] = ["the run was ended"]

        # Both ends stay open here, for a simulator or an evaluator that is started in
        # place of one that has ended.
        self._simulator_line, self._evaluator_line = private_line.create_ends()
        self._robot = nodes.name_robot(self.config.simulator, self.logs)
        line = self._simulator_line.fileno()
        self._nodes = {
            SIMULATOR: nodes.simulator(self.config.ros, line, self._robot),
            PLANNER: self._planner_of_next_trial(),
        }
        # Names of the copies begin with a part of the hash.
        for text, digest in planner.files.items():
            path = Path(text)
            if path.is_file() and path.stat().st_size <= _MAX_COPY_BYTES:
                shutil.copyfile(path, self.logs / f"{digest[:12]}_{path.name}")

    def run(self) -> Iterator[TrialRecord]:
        """Start, watch and replace the processes; yield a record as each trial ends."""
        if not self.look_first:
            for name in self._nodes:
                self._schedule_start(name)
        self._schedule_start(EVALUATOR)

        while not self._done:
            self._start_due()
            self._await_events()
            # Ends before events: what an evaluator sent before its end can then be
            # received below, so that no result is lost with it.
            for process in list(self._processes.values()):
                process.read()
            if self._evaluator is not None:
                for event in self._evaluator.receive():
                    if event["event"] == "result":
                        result = from_json_line(event["row"], "result of the evaluator")
                        yield self._record(result, event["track"], event["commands"])
                    else:
                        self._handle(event)
            for process in list(self._processes.values()):
                if process.ended and not self._done:
                    yield from self._handle_end(process)

    def _record(self, result: TrialResult, track: str, commands: str) -> TrialRecord:
        """Take a trial off the list; return its record, with its repetitions."""
        self._lost_evaluators = 0
        del self._remaining[result.trial_id]
        repeats = self._repeats.pop(result.trial_id, [])
        wall_clock = replace(
            result.wall_clock, attempts=1 + len(repeats), repeated="; ".join(repeats)
        )
        result = replace(result, wall_clock=wall_clock)
        return TrialRecord(result, track or None, commands or None)

    def stop(self) -> None:
        """End all processes, wait until they have ended, and close the private line."""
        if self._evaluator is not None:
            # The evaluator ends by itself when its channel closes.
            self._evaluator.close()
        for process in self._processes.values():
            process.ask_to_stop()
        try:
            for process in self._processes.values():
                process.stop()
        except BaseException:
            # Interrupted again: no more patience.
            for process in self._processes.values():
                process.send_stop()
            raise
        self._processes.clear()
        self._simulator_line.close()
        self._evaluator_line.close()

    def _await_events(self) -> None:
        """Wait up to 0.5 s until there is something to read or a start is due."""
        wait_s = _LONGEST_WAIT_S
        if self._due_s:
            wait_s = min(wait_s, min(self._due_s.values()) - time.monotonic())
        sources: list[Any] = list(self._processes.values())
        if self._evaluator is not None and not self._evaluator.closed:
            sources.append(self._evaluator)
        multiprocessing.connection.wait(sources, max(0.0, wait_s))

    def _start_due(self) -> None:
        """Start each process whose time has come, unless it is still running."""
        now_s = time.monotonic()
        for name, due_s in list(self._due_s.items()):
            if due_s > now_s or name in self._processes:
                continue
            del self._due_s[name]
            if name == EVALUATOR:
                self._start_evaluator()
            else:
                if name == PLANNER and self._remaining:
                    self._nodes[name] = self._planner_of_next_trial()
                # The planner gets no socket: it must not reach the private line.
                sockets = [self._simulator_line] if name == SIMULATOR else []
                self._start(self._nodes[name], sockets)

    def _planner_of_next_trial(self) -> NodeProcess:
        """Return the planner's process with the goal of the next trial."""
        spec = next(iter(self._remaining.values()))
        return nodes.planner(self._planner, self.config, spec.goal)

    def _start_evaluator(self) -> None:
        """Write assignment.json with the trials left, and start an evaluator."""
        specs = self._remaining.values()
        assignment = Assignment(
            self.config,
            tuple(self._remaining),
            tuple(dict.fromkeys(spec.world_number for spec in specs)),
            str(self.store.folder),
            self._robot,
            self.look_first,
            self._isolated,
        )
        # The next evaluator finds the nodes of this run.
        self.look_first = False
        path = self.logs / "assignment.json"
        write_durably(path, json.dumps(as_dict(assignment)).encode())

        supervisor_end, evaluator_end = socket.socketpair()
        with evaluator_end:
            node = nodes.evaluator(
                path,
                self.config.ros,
                evaluator_end.fileno(),
                self._evaluator_line.fileno(),
            )
            self._start(node, [evaluator_end, self._evaluator_line])
        self._evaluator = EventChannel(supervisor_end)

    def _start(self, node: NodeProcess, sockets: Sequence[socket.socket]) -> None:
        """Start a node with `sockets`; tell the simulator the planner's PID."""
        name = node.name
        self._started_s[name] = time.monotonic()

        # Only the planner is isolated: simulator and evaluator are trusted.
        kind = launcher.SUITE
        if name == PLANNER:
            kind = launcher.PLANNER
            if self._isolated:
                kind = f"{launcher.ISOLATED}:{self.store.folder}"
        self._processes[name] = node.start(self.environment, self.logs, sockets, kind)
        # A restarted simulator has not heard of the planner yet, either.
        if name != EVALUATOR and PLANNER in self._processes:
            line = private_line.PrivateLine(os.dup(self._evaluator_line.fileno()))
            line.send(planner=self._processes[PLANNER].pid)

    def _handle(self, event: dict[str, str]) -> None:
        """Do what an event of the evaluator asks for; ProcessError if it refuses."""
        match event:
            case {"event": "trial", "id": trial}:
                self._trial = trial
                self._driving = False
            case {"event": "released"}:
                self._driving = True
                self._driving_file.write_text(self._trial, "utf-8")
            case {"event": "repeated", "reason": reason}:
                self._repeat(reason)
            case {"event": "note", "text": text}:
                self.notice(text)
            case {"event": "parameters", "text": text} if not self._parameters_kept:
                # Planners that start again report again; one trial is enough.
                self._parameters_kept = True
                folder = self.store.folder / LOGS
                write_node_parameters(folder, self.logs, self._planner.name, text)
            case {"event": "stop", "name": name} if name in self._processes:
                self._processes[name].ask_to_stop()
            case {"event": "start", "name": name} if name not in self._processes:
                self._schedule_start(name)
            case {"event": "refused", "reason": reason}:
                raise self._refusal(reason)
            case {"event": "done"}:
                self._done = True

    def _refusal(self, reason: str) -> ProcessError:
        """Return the error that ends a run, with the log of the process it names."""
        for name in self._nodes:
            if f"the {name} " in reason:
                log = self.logs / f"{name}.log"
                # The notice of its end has quoted more, once.
                printed = last_lines(log, 1 if name in self._quoted_logs else 10)
                command = self._planner.command
                if name == PLANNER and command:
                    hint = explain_end(command, last_lines(log))
                    if hint:
                        printed = f"{hint}; see {log}"
                return ProcessError(f"{reason}; {printed}")
        return ProcessError(reason)

    def _repeat(self, reason: str) -> None:
        """Note that the trial in progress is repeated, and why; tell the user."""
        self._repeats.setdefault(self._trial, []).append(reason)
        self.notice(f"{self._trial} is repeated: {reason}")

    def _handle_end(self, process: SupervisedProcess) -> Iterator[TrialRecord]:
        """Clear up an ended process, tell others; yield a trial it costs, or raise.

        The evaluator is told of the end, or replaced if it was the one.
        """
        name = process.name
        end = process.end or ""
        # The evaluator may want a planner of its own for each trial: no news. Asked
        # before the process is stopped, which counts as stopping whatever went before.
        policy = self.config.ros.restart_planner
        is_asked = process.stopping
        is_expected = name == PLANNER and is_asked and policy == "each_trial"

        del self._processes[name]
        process.stop()
        if end.startswith("cannot be started"):
            raise ProcessError(f"the {name} {end}")

        if not is_expected:
            # However a process takes the signal that we sent is no news.
            self._notice_end(process, "is restarted" if is_asked else end)

        if name == EVALUATOR:
            yield from self._handle_lost_evaluator(process)
        elif self._evaluator is not None:
            # The evaluator says when to start the process again.
            culprit = ENVIRONMENT if process.lost else ""
            self._evaluator.send("exited", name=name, how=end, culprit=culprit)
        else:
            self._schedule_start(name)

    def _notice_end(self, process: SupervisedProcess, end: str) -> None:
        """Tell the user how a process ended; at its first end, quote its log."""
        text = f"{process.name} {end}"
        if self._trial:
            text += f" in trial {self._trial}"
        # Its log is quoted once: later ends are often consequences of the first.
        if process.name not in self._quoted_logs:
            self._quoted_logs.add(process.name)
            text += f"; {last_lines(process.log, begin=process.log_begin)}"
        self.notice(text)

    def _handle_lost_evaluator(
        self, process: SupervisedProcess
    ) -> Iterator[TrialRecord]:
        """Plan another evaluator; repeat the trial, yield its failure or raise.

        A trial that drove beside a planner without isolation is not repeated: the
        planner may have ended the evaluator. It counts as interference.
        """
        self._evaluator = None
        self._lost_evaluators += 1
        may_retry = self._lost_evaluators < _MAX_LOST_EVALUATORS
        reason = f"the evaluator {process.end}"
        if self._driving and self._trial in self._remaining:
            if self._isolated and may_retry:
                self._repeat(reason)
            else:
                detail = f"{reason}; {PLANNER_SUSPECTED}"
                verdict = Verdict(Outcome.INTERFERENCE, detail, None, 0.0, 0.0)
                trajectory = TrajectoryLog().trajectory()
                spec = self._remaining[self._trial]
                finished = finish_trial(spec, "ros", verdict, trajectory)
                yield self._record(finished.result, "", "")
        elif not may_retry:
            raise ProcessError(
                f"{reason}, {_MAX_LOST_EVALUATORS} times in a row;"
                f" {last_lines(process.log)}"
            )

        if not self._remaining:
            self._done = True
            return
        for name in (*self._nodes, EVALUATOR):
            if name not in self._processes:
                self._schedule_start(name)

    def _schedule_start(self, name: str) -> None:
        """Plan a process's start, 1 s or more after its last; start nothing."""
        if name not in self._due_s:
            self._due_s[name] = self._started_s.get(name, -math.inf) + _START_PERIOD_S


def _exit(number: int, _frame: FrameType | None) -> None:
    """Raise SystemExit with 128 + `number`, so SIGTERM ends the run as Ctrl-C does."""
    raise SystemExit(128 + number)
