"""Run trials of a planner over ROS: simulator, planner and evaluator as processes, started, watched and ended."""

import json
import math
import multiprocessing.connection
import os
import shutil
import signal
import socket
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any

from barn_eval.results.store import LOGS, BagStore, TrialRecord
from barn_eval.ros.isolation import is_isolated
from barn_eval.ros.supervision import guard, nodes
from barn_eval.ros.supervision.nodes import NOT_TOLD, Assignment, NodeProcess
from barn_eval.ros.supervision.process import (
    EventChannel,
    GuardedProcess,
    ProcessError,
    last_lines,
)
from barn_eval.running.command_files import write_node_parameters
from barn_eval.trials.outcome import ENVIRONMENT, Outcome, Verdict
from barn_eval.trials.result import TrialResult, from_json_line
from barn_eval.trials.run_config import RunConfig
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trajectory import TrajectoryLog
from barn_eval.trials.trial import finish_trial, signal_handler
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import ConfigError, convert_os_errors
from barn_worlds.base.files import write_durably
from barn_worlds.ros import private_line
from barn_worlds.ros.domain import in_use, reserved_domain

_EVALUATOR_STARTS = (
    3  # evaluators that may be lost in a row without a result in between
)
_LARGEST_KEPT = (
    1 << 20
)  # bytes of a file that a planner's command names and that is kept beside its logs
_FRESH_S = 1.0  # shortest time from one start of a process to the next


def run_ros_trials(
    experiment: RunConfig,
    trials: Sequence[TrialSpec],
    store: BagStore,
    logs: Path | None = None,
    notice: Callable[[str], None] = lambda _: None,
    environment: Mapping[str, str] = os.environ,
) -> Generator[TrialRecord, None, None]:
    """Run trials of one planner of an experiment and yield what is to be kept of each once it has ended.

    notice: gets a line about each process that has ended unasked. environment: of the nodes. All processes have ended
    when the iteration has, whatever ends it, and also if this process is killed. Raises ProcessError, with the last
    lines of a log, where the nodes cannot be run, and ConfigError for what is not allowed.
    """
    if not trials:
        return
    logs = logs or store.folder / LOGS
    with convert_os_errors(ConfigError, logs):
        logs.mkdir(parents=True, exist_ok=True)
    # others that take part in the domain may be in the way: then the evaluator is to look first
    with reserved_domain(environment) as domain, signal_handler(signal.SIGTERM, _end):
        given, shared = nodes.environment(environment, domain), in_use(domain)
        supervisor = _Supervisor(experiment, trials, store, logs, given, notice, shared)
        try:
            yield from supervisor.run()
        finally:
            supervisor.stop()


class _Supervisor:
    """Keeps the three processes running until the evaluator says that all trials have been made."""

    def __init__(
        self,
        experiment: RunConfig,
        trials: Sequence[TrialSpec],
        store: BagStore,
        logs: Path,
        environment: Mapping[str, str],
        notice: Callable[[str], None],
        look_first: bool,
    ) -> None:
        (self._planner,) = (planner,) = [
            one for one in experiment.planners if one.name == trials[0].planner
        ]
        self._told = False  # the planner's parameters
        self._trials = {
            spec.trial_id: spec for spec in trials
        }  # those without a result
        self._logs, self._environment, self._notice = logs, environment, notice
        self._evaluator: EventChannel | None = None
        self._processes: dict[str, GuardedProcess] = {}
        self._due: dict[str, float] = {}  # processes to be started, and when
        self._started_s: dict[str, float] = {}
        self._seen_ending: set[str] = set()
        self._lost_evaluators = 0
        self._apart = experiment.ros.isolate and is_isolated()
        # Whether the robot has been released, and why trials are repeated in which it had been. The file names the last
        # of them: if that has no row when a run begins, the run before ended in its midst.
        self._trial, self._driving, self._done = "", False, False
        self._released = logs / "released"
        ended = self._released.read_text("utf-8") if self._released.exists() else ""
        self._repeats = {ended: ["the run was ended"]} if ended in self._trials else {}
        # Both ends stay open here, for a simulator or an evaluator that is started in place of one that has ended.
        self._line, self._far_line = private_line.pair()
        robot = nodes.robot_of_simulator(experiment.simulator, logs)
        self._others = {
            "simulator": nodes.simulator(experiment.ros, self._line.fileno(), robot),
            "planner": nodes.planner(planner, experiment),
        }
        for text, digest in planner.files.items():
            if Path(text).is_file() and Path(text).stat().st_size <= _LARGEST_KEPT:
                shutil.copyfile(text, logs / f"{digest[:12]}_{Path(text).name}")
        alone = replace(experiment, planners=(planner,))
        self._assignment = Assignment(
            alone, (), (), str(store.folder), robot, look_first, self._apart
        )

    def run(self) -> Iterator[TrialRecord]:
        """Yield records as they come, until there is one of each trial."""
        for name in (
            ("evaluator",)
            if self._assignment.look_first
            else (*self._others, "evaluator")
        ):
            self._plan_start(name)
        while not self._done:
            self._start_due()
            self._await_news()
            for process in list(self._processes.values()):
                process.read()
            if self._evaluator is not None:
                for event in self._evaluator.receive():
                    if event["event"] == "result":
                        yield self._record(
                            from_json_line(event["row"], "result of the evaluator"),
                            event["track"],
                        )
                    else:
                        self._handle(event)
            for process in list(self._processes.values()):
                if process.ended and not self._done:
                    yield from self._ended(process)

    def _record(self, result: TrialResult, track: str) -> TrialRecord:
        """Return what is kept of a trial, with why it was repeated."""
        self._lost_evaluators = 0
        del self._trials[result.trial_id]
        repeats = self._repeats.pop(result.trial_id, [])
        clock = replace(
            result.wall_clock, attempts=1 + len(repeats), repeated="; ".join(repeats)
        )
        return TrialRecord(replace(result, wall_clock=clock), track or None)

    def stop(self) -> None:
        """End all processes, at the same time."""
        if self._evaluator is not None:
            self._evaluator.close()  # upon which the evaluator ends by itself
        for process in self._processes.values():
            process.ask_to_stop()
        try:
            for process in self._processes.values():
                process.stop()
        except BaseException:  # interrupted again: no more patience
            for process in self._processes.values():
                process.stop_now()
            raise
        self._processes.clear()
        self._line.close()
        self._far_line.close()

    def _await_news(self) -> None:
        wait_s = max(
            0.0, min([0.5, *(at - time.monotonic() for at in self._due.values())])
        )
        evaluator = (
            [self._evaluator]
            if self._evaluator is not None and not self._evaluator.closed
            else []
        )
        heard: list[Any] = [*self._processes.values(), *evaluator]
        multiprocessing.connection.wait(heard, wait_s)

    def _start_due(self) -> None:
        for name in [
            name
            for name, at in self._due.items()
            if at <= time.monotonic() and name not in self._processes
        ]:
            del self._due[name]
            if name == "evaluator":
                self._start_evaluator()
            else:
                self._start(
                    self._others[name], [self._line] if name == "simulator" else []
                )

    def _start_evaluator(self) -> None:
        ours, theirs = socket.socketpair()
        path, setup = self._logs / "assignment.json", self._assignment.experiment.ros
        worlds = tuple(
            dict.fromkeys(spec.world_number for spec in self._trials.values())
        )
        assigned = replace(self._assignment, trials=tuple(self._trials), worlds=worlds)
        write_durably(path, json.dumps(as_dict(assigned)).encode())
        self._assignment = replace(self._assignment, look_first=False)
        with theirs:
            node = nodes.evaluator(
                path, setup, theirs.fileno(), self._far_line.fileno()
            )
            self._start(node, [theirs, self._far_line])
        self._evaluator = EventChannel(ours)

    def _start(self, node: NodeProcess, handed: Sequence[socket.socket]) -> None:
        name, command = node.name, node.with_parameter_file(self._logs)
        self._started_s[name] = time.monotonic()
        environment = (
            nodes.foreign_environment(self._environment)
            if node.foreign
            else self._environment
        )
        planner = (
            f"{guard.APART}:{self._assignment.out}" if self._apart else guard.PLANNER
        )
        kind = planner if name == "planner" else guard.SUITE
        self._processes[name] = GuardedProcess(
            name, command, environment, self._log(name), handed, kind
        )

    def _handle(self, event: dict[str, str]) -> None:
        match event:
            case {"event": "trial", "id": trial}:
                self._trial, self._driving = trial, False
            case {"event": "released"}:
                self._driving = True
                self._released.write_text(self._trial, "utf-8")
            case {"event": "repeated", "reason": reason}:
                self._repeat(reason)
            case {"event": "note", "text": text}:
                self._notice(text)
            case {"event": "parameters", "text": text} if not self._told:
                self._told = True
                write_node_parameters(
                    Path(self._assignment.out) / LOGS,
                    self._logs,
                    self._planner.name,
                    text,
                )
            case {"event": "stop", "name": name} if name in self._processes:
                self._processes[name].ask_to_stop()
            case {"event": "start", "name": name} if name not in self._processes:
                self._plan_start(name)
            case {"event": "refused", "reason": reason}:
                concerned = [
                    last_lines(self._log(name))
                    for name in self._others
                    if f"the {name} " in reason
                ]
                raise ProcessError("; ".join([reason, *concerned[:1]]))
            case {"event": "done"}:
                self._done = True

    def _repeat(self, reason: str) -> None:
        """Note why a trial is repeated that had begun."""
        self._repeats.setdefault(self._trial, []).append(reason)
        self._notice(f"{self._trial} is repeated: {reason}")

    def _ended(self, process: GuardedProcess) -> Iterator[TrialRecord]:
        """Tell the evaluator of a process that has ended: it says when to start it afresh; yield what that costs."""
        how, name, wanted = (
            process.end or "",
            process.name,
            process.asked and process.name == "planner",
        )
        del self._processes[name]
        process.stop()
        if how.startswith("cannot be started"):
            raise ProcessError(f"the {name} {how}")
        said = f"{name} {how}" + (f" in trial {self._trial}" if self._trial else "")
        if (
            not wanted
            or self._assignment.experiment.ros.restart_planner != "each_trial"
        ):
            # what it wrote last, before the noise of others' ends
            self._notice(
                said
                if name in self._seen_ending
                else f"{said}; {last_lines(process.log)}"
            )
            self._seen_ending.add(name)
        if name == "evaluator":
            yield from self._evaluator_lost(process)
        elif self._evaluator is not None:
            self._evaluator.send(
                "exited",
                name=name,
                how=how,
                culprit=ENVIRONMENT if process.lost else "",
            )
        else:
            self._plan_start(name)

    def _evaluator_lost(self, process: GuardedProcess) -> Iterator[TrialRecord]:
        """Start another evaluator, which repeats the trial that has no result; if the planner may have ended it, no."""
        self._evaluator = None
        self._lost_evaluators += 1
        lost, again = (
            f"the evaluator {process.end}",
            self._lost_evaluators < _EVALUATOR_STARTS,
        )
        if self._trial in self._trials and self._driving:
            if self._apart and again:
                self._repeat(lost)
            else:
                verdict = Verdict(
                    Outcome.INTERFERENCE, f"{lost}; {NOT_TOLD}", None, 0.0, 0.0
                )
                empty = TrajectoryLog().trajectory()
                yield self._record(
                    finish_trial(
                        self._trials[self._trial], "ros", verdict, empty
                    ).result,
                    "",
                )
        elif not again:
            raise ProcessError(
                f"{lost}, {_EVALUATOR_STARTS} times in a row; {last_lines(process.log)}"
            )
        if not self._trials:
            self._done = True
            return
        for name in (*self._others, "evaluator"):
            if name not in self._processes:
                self._plan_start(name)

    def _plan_start(self, name: str) -> None:
        self._due.setdefault(name, self._started_s.get(name, -math.inf) + _FRESH_S)

    def _log(self, name: str) -> Path:
        return self._logs / f"{name}.log"


def _end(number: int, _frame: FrameType | None) -> None:
    """Let SIGTERM end the run as orderly as Ctrl-C does."""
    raise SystemExit(128 + number)
