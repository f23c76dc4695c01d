"""The evaluator node: resets, waits for the planner, sends the goal, judges, records.

It judges by /clock, odom, ground_truth/odom and collision. They come by a private line
from a simulator that the same supervisor has started. A simulator that was started by
hand publishes them as topics and is led by its services. For bags the evaluator
subscribes to whatever is published. Its parameters are the fields of
`barn_eval.trials.ros_config.EvaluatorConfig`.
"""

import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import mean

import numpy as np
import rclpy
from rclpy.node import Node

from barn_eval.results.folder import ResultsFolder
from barn_eval.results.store import BagStore, TrialRecord, finish_bag
from barn_eval.ros.adapter import count_missed_periods, share_of_missed
from barn_eval.ros.evaluator_loop import StopRequested, TrialEnded
from barn_eval.ros.isolation import session_isolation
from barn_eval.ros.supervision.nodes import PLANNER_SUSPECTED, Assignment
from barn_eval.ros.supervision.process import EventChannel
from barn_eval.ros.trial import MUTUAL_WAITS, RosTrial, RunContext
from barn_eval.running.pool import now_text
from barn_eval.running.reporting import Reporter, RunProgress
from barn_eval.running.run import describe_unscored
from barn_eval.trials.protocol import load_protocol
from barn_eval.trials.result import (
    ENVIRONMENT,
    PLANNER,
    SIMULATOR,
    Outcome,
    Rows,
    Verdict,
    WallClock,
    exit_code,
    to_json_line,
)
from barn_eval.trials.ros_config import EvaluatorConfig, RosConfig
from barn_eval.trials.run_config import ExecutionConfig, PlannerChoice, RunConfig
from barn_eval.trials.spec import TrialSpec, simulator_config
from barn_eval.trials.system import ObservedTrial
from barn_eval.trials.system_file import read_system
from barn_eval.trials.trial import doubt_poses, finish_trial
from barn_worlds.base.config import from_dict
from barn_worlds.base.errors import BarnError, ConfigError, ExitCode
from barn_worlds.base.files import read_json
from barn_worlds.base.types import nanoseconds, seconds
from barn_worlds.robots.files import load_robot
from barn_worlds.ros.parameters import (
    declare_parameters,
    warn_about_unknown_parameters,
)
from barn_worlds.ros.starting import start_ros

# Outcomes after which a process cannot be trusted with the next trial.
_DOUBTFUL_PROCESS = {
    Outcome.NO_FIRST_MOTION: PLANNER,
    Outcome.PLANNER_NOT_READY: PLANNER,
    Outcome.PLANNER_STALLED: PLANNER,
    Outcome.WRONG_MESSAGE_TYPE: PLANNER,
    Outcome.INVALID_COMMAND: PLANNER,
    Outcome.INTERFERENCE: PLANNER,
    Outcome.SIMULATOR_DIED: SIMULATOR,
}
# Attempts at a trial that does not begin, or fails through no fault of the planner.
_MAX_ATTEMPTS = 3
_RESTART_LIMIT_S = 20.0


def main(
    arguments: list[str] | None = None,
    defaults: EvaluatorConfig | None = None,
    *,
    raises: bool = False,
) -> int:
    """Run the evaluator node until its trials end; log mistakes; return an exit code.

    Args:
        arguments: Words of its command line; by default those of this process.
        defaults: Values of parameters that these do not set.
        raises: Whether a mistake in the input is raised and not logged.

    Returns:
        Exit code: the run's, for trials started by hand.

    Raises:
        BarnError: After a mistake in the input, if `raises`.
    """
    # rclpy ends its context on Ctrl-C, and so every wait; an exception on top of that
    # would strike anywhere.
    signal.signal(signal.SIGINT, lambda *_: None)
    try:
        start_ros(arguments)
    except ConfigError as error:
        print(f"evaluator: {error}", file=sys.stderr)
        return error.exit_code

    node = Node("evaluator")
    supervisor = None
    try:
        defaults = defaults or EvaluatorConfig()
        config = declare_parameters(node, defaults, read_only=True)
        warn_about_unknown_parameters(node)
        if config.system:
            # The names of its topics are known only now.
            renamed = _create_node(Path(config.system))
            node.destroy_node()
            node = renamed
        if config.supervisor_fd < 0:
            return _run_by_hand(node, config)
        supervisor = EventChannel(socket.socket(fileno=config.supervisor_fd))
        _run_assignment(node, config, supervisor)
        return ExitCode.DONE
    except BarnError as error:
        if raises:
            raise
        node.get_logger().fatal(str(error))
        if supervisor is not None:
            supervisor.send("refused", reason=str(error))
        return error.exit_code
    except StopRequested:
        return ExitCode.INTERRUPTED
    except Exception:
        # A signal may end ROS while something is being made with it.
        if rclpy.ok():
            raise
        return ExitCode.INTERRUPTED
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def _create_node(system: Path) -> Node:
    """Return a node with the topics of a system; ConfigError if its file is wrong."""
    rules = ["--ros-args"]
    for rule in read_system(system).remappings():
        rules += ["-r", rule]
    return Node("evaluator", cli_args=rules)


def _run_assignment(
    node: Node, config: EvaluatorConfig, supervisor: EventChannel
) -> None:
    """Run assigned trials, send results; first, if told to, refuse a shared domain."""
    assignment = from_dict(
        Assignment, read_json(Path(config.assignment)), config.assignment
    )
    config = replace(config, dataset=assignment.run.dataset, robot=assignment.robot)
    context = RunContext(node, config, supervisor)
    loop = context.loop

    def send_record(record: TrialRecord) -> None:
        """Send the supervisor row, track and commands of a trial as JSON lines."""
        loop.report(
            "result",
            row=to_json_line(record.result),
            track=record.track or "",
            commands=record.commands or "",
        )

    if assignment.look_first:
        context.integrity.require_alone(loop, os.environ.get("ROS_DOMAIN_ID", ""))
        for name in (SIMULATOR, PLANNER):
            loop.report("start", name=name)
    runner = TrialRunner(context, assignment.store, send_record, assignment.isolated)
    runner.run(assignment.specs())
    loop.report("done")


def _run_by_hand(node: Node, config: EvaluatorConfig) -> int:
    """Run trials of the parameters that the folder lacks; return the run's exit code.

    Simulator and planner are started by somebody else; the trials wait for them.
    """
    protocol = load_protocol(config.protocol)
    # No planner has this configuration: somebody else starts it, so only its name
    # counts.
    run = RunConfig(
        dataset=config.dataset,
        worlds=config.worlds,
        planners=(PlannerChoice(config.planner),),
        repetitions=config.repetitions,
        protocol=protocol,
        simulator=simulator_config(protocol, robot=load_robot(config.robot)),
        seed=config.seed,
        mode="ros",
        bags=config.bags,
    )
    if config.system:
        system = read_system(Path(config.system)).system
        run = replace(run, system=system, ros=RosConfig(lockstep=False))
    out = Path(config.out)
    specs = run.trials(started_by_hand=True)
    isolation = session_isolation(run.ros)
    with ResultsFolder.open(
        out, run, ExecutionConfig(workers=1), specs, isolation=isolation
    ) as folder:
        context = RunContext(node, config, None)
        log = Reporter(node.get_logger())
        remaining = folder.remaining
        log.notify(
            f"{len(remaining)} of {folder.total} trials to do, protocol {protocol.name}"
        )
        if remaining:
            simulator = f"{config.simulator_node} (ros2 run barn_sim simulator)"
            log.notify(
                f"waiting for {config.system or simulator} "
                f"and for a planner on {context.topics.command}"
            )
        progress = RunProgress(folder.total, folder.results(), log)

        def keep(record: TrialRecord) -> None:
            """Append a trial to the results folder, and log the progress."""
            folder.append(record)
            progress.take(record.result)

        TrialRunner(context, BagStore(out, config.bags), keep).run(remaining)
        results = folder.complete()
        warning = describe_unscored(results)
        if warning:
            log.warn(warning)
        scored = [row for row in results if row.is_scored]
        if scored:
            log.notify(_summarize(scored, scored[0].metric))
        log.notify(f"results in {out}; for a report: barn report {out}")
        return exit_code(results)


def _summarize(results: Rows, metric: str) -> str:
    """Return the share of successes as text, with a mean score if all rows have it."""
    success_percent = 100.0 * mean(row.scores.success for row in results)
    values = [getattr(row.scores, metric) for row in results]
    text = f"success {success_percent:.0f}%"
    # The efficiency has no value where its bound is not computed.
    if None not in values:
        text += f", mean {metric} metric {mean(values):.3f}"
    return text


@dataclass
class TrialRunner:
    """Runs trial after trial, and restarts the other processes after a fault."""

    # What all trials share.
    context: RunContext

    # Where bags go.
    store: BagStore

    # Takes the record of each trial once its bag is in the store.
    keep: Callable[[TrialRecord], None]

    # Whether the planner cannot have ended another process. Nodes that are started by
    # hand count as isolated.
    isolated: bool = True

    def __post_init__(self) -> None:
        """Begin without a trial."""
        self._failed_attempts = 0
        self._driven_trials = 0
        self._has_told_rate = False

    def run(self, trials: Iterable[TrialSpec]) -> None:
        """Run each trial, again where it must be repeated, and keep its record.

        Raises:
            BarnError: If no trial can begin at all.
        """
        for spec in trials:
            while not self._attempt(spec):
                pass

    def _attempt(self, spec: TrialSpec) -> bool:
        """Run a trial once; keep its record, or return False if it must run again."""
        self.context.loop.report("trial", id=spec.trial_id)
        start_s = time.monotonic()
        started_at = now_text()
        with self.store.recorder(spec.trial_id) as recorder:
            # Simulator and planner have just been started.
            first = self._driven_trials == 0 or self._failed_attempts > 0
            trial = RosTrial(self.context, spec, recorder, first=first)
            verdict = trial.run()
            if trial.released and _is_others_fault(verdict) and not self.isolated:
                verdict = replace(
                    verdict,
                    detail=f"{verdict.detail}; {PLANNER_SUSPECTED}",
                    culprit=PLANNER,
                )

            status = self._settle(verdict)
            if trial.released:
                self._driven_trials += 1
            if self._must_repeat(verdict, trial):
                return False

            duration_s = time.monotonic() - start_s
            wall_clock = self._wall_clock(trial, verdict, duration_s, status)
            wall_clock = replace(wall_clock, started_at=started_at)
            trajectory = trial.trial.log.trajectory()
            clearance_by = "world"
            if spec.system.frame != "world":
                # Odometry drifts, so nothing follows about the gaps to the plan.
                unknown_m = np.full(len(trajectory.stamps_ns), np.nan)
                trajectory = replace(trajectory, clearance_m=unknown_m)
                clearance_by = ""
            remarks = [wall_clock.remark, self.context.integrity.remarks]
            error_s = trial.uncertainty_s
            if error_s is not None:
                jumps, arrival_error_s = doubt_poses(spec, verdict, trajectory)
                remarks += jumps
                error_s += arrival_error_s
            finished = finish_trial(
                spec,
                "ros",
                verdict,
                trajectory,
                wall_clock=wall_clock,
                recoveries=trial.trial.recoveries,
                planner_verdict=trial.action_result,
                remarks="; ".join(filter(None, remarks)),
                observed=ObservedTrial.of(spec.system, clearance_by, error_s),
            )
            if recorder is not None:
                finish_bag(recorder, finished)
        self.keep(self.store.make_record(finished))
        return True

    def _must_repeat(self, verdict: Verdict, trial: RosTrial) -> bool:
        """Count attempts; return whether to repeat a trial; BarnError if none began.

        Under a supervisor, a trial whose planner died before it began, or that failed
        by another's fault, runs up to three times; by hand, once.

        Raises:
            BarnError: If no attempt is left and no trial has driven yet.
        """
        loop = self.context.loop
        # A planner may end between two trials, for instance because it has reached its
        # goal: its successor drives.
        never_began = verdict.outcome is Outcome.PLANNER_DIED and not trial.released
        if loop.supervisor is None or not (never_began or _is_others_fault(verdict)):
            self._failed_attempts = 0
            return False

        self._failed_attempts += 1
        if self._failed_attempts < _MAX_ATTEMPTS:
            if trial.released:
                loop.report(
                    "repeated", reason=f"{verdict.outcome.value}, {verdict.detail}"
                )
            return True
        self._failed_attempts = 0
        if self._driven_trials == 0:
            raise BarnError(
                f"{verdict.detail} at its start, {_MAX_ATTEMPTS} times in a row"
            )
        return False

    def _settle(self, verdict: Verdict) -> dict[str, int]:
        """Pause the simulator, restart doubtful processes; return its status, or {}."""
        loop = self.context.loop
        doubtful = _DOUBTFUL_PROCESS.get(verdict.outcome)
        status = {}
        if doubtful != SIMULATOR:
            try:
                status = self.context.simulator.pause()
            except TrialEnded as end:
                loop.node.get_logger().warning(f"after the verdict: {end}")
                doubtful = SIMULATOR

        if doubtful == SIMULATOR:
            loop.restart(SIMULATOR, _RESTART_LIMIT_S)
        policy = self.context.config.restart_planner
        if policy == "each_trial" or (policy == "on_fault" and doubtful == PLANNER):
            loop.restart(PLANNER, _RESTART_LIMIT_S)
        return status

    def _wall_clock(
        self,
        trial: RosTrial,
        verdict: Verdict,
        duration_s: float,
        status: Mapping[str, int],
    ) -> WallClock:
        """Return duration, pace, answer times and missed cycles for a trial's row."""
        missed_cycles = status.get("missed_commands", 0)
        # Only the drive counts: the waits before it say nothing about the speed.
        factor = verdict.duration_s / trial.wall_s if trial.wall_s else None
        adapter = trial.adapter
        # A system has a pace of its own.
        if adapter is None or self.context.system is not None:
            return WallClock(duration_s, factor, missed_cycles=missed_cycles)

        spec = trial.trial.spec
        period_s = spec.simulator.scan_steps * spec.simulator.control_period_s
        rate_hz, rate_source = self._planner_rate(status)
        # A planner slower than the scans misses none of its own periods.
        if rate_hz:
            period_s = 1.0 / rate_hz
        period_ns = nanoseconds(period_s)
        commands_ns = adapter.commands_ns

        # The wait for a planner's timer says nothing about its computing.
        answer_times_s = adapter.response_times_s
        compute_clock = "wall"
        channel = self.context.channel
        if rate_source and channel is not None and channel.processor_times_s:
            answer_times_s = channel.processor_times_s
            compute_clock = "processor"

        # While a longer cycle is under way, no command is owed.
        if max(spec.compute.charged_s, spec.compute.period_s) <= period_s:
            silence_s = max(spec.simulator.drive.command_timeout_s, 2.0 * period_s)
            silence_ns = nanoseconds(silence_s)
            missed = count_missed_periods(
                commands_ns, adapter.now_ns, period_ns, silence_ns
            )
            missed_cycles = max(missed_cycles, missed)
        return WallClock.from_answer_times(
            duration_s,
            factor,
            answer_times_s,
            compute_clock=compute_clock,
            planner_rate_hz=rate_hz,
            rate_source=rate_source,
            missed_cycles=missed_cycles,
            missed_share=share_of_missed(
                missed_cycles, commands_ns, adapter.now_ns, period_ns
            ),
        )

    def _planner_rate(self, status: Mapping[str, int]) -> tuple[float | None, str]:
        """Return a planner's rate [Hz] and source, or (None, ""); note a found one."""
        declared_hz = self.context.config.planner_rate_hz
        period_ns = status.get("period_ns", 0)
        if period_ns and not status["is_declared"]:
            rate_hz = 1.0 / seconds(period_ns)
            if not self._has_told_rate:
                self._has_told_rate = True
                self.context.loop.note(
                    f"the planner sends {rate_hz:.3g} commands per simulated second; lockstep waits"
                    " only for these commands; to declare the rate, use --ros planner_rate_hz"
                )
            return rate_hz, "found"
        if declared_hz:
            return declared_hz, "declared"
        if period_ns:
            return 1.0 / seconds(period_ns), "declared"
        return None, ""


def _is_others_fault(verdict: Verdict) -> bool:
    """Return whether something other than the planner failed and may not fail again."""
    is_others = verdict.fault in (SIMULATOR, ENVIRONMENT)
    # The same commands would tip the robot over again.
    is_final = verdict.outcome in (*MUTUAL_WAITS, Outcome.ROBOT_TIPPED)
    return is_others and not is_final


if __name__ == "__main__":
    sys.exit(main())
