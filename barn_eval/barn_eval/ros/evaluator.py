"""The evaluator node: resets the simulator, waits for the planner, sends the goal, judges, records, repeats.

It judges by /clock, odom, ground_truth/odom and collision, which come by a private line from a simulator that the same
supervisor has started, and by topics from one that was started by hand; the latter is led by its services. For the bags
it subscribes to whatever is published. Parameters are those of `barn_eval.trials.ros_config.EvaluatorConfig`.
"""

import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import rclpy
from rclpy.node import Node

from barn_eval.results.folder import ResultsFolder
from barn_eval.results.store import BagStore, TrialRecord, finish_bag
from barn_eval.ros.adapter import missed_periods, missed_share
from barn_eval.ros.isolation import session_isolation
from barn_eval.ros.session import PLANNER, SIMULATOR, Abandoned, TrialEnded
from barn_eval.ros.supervision.nodes import NOT_TOLD, Assignment
from barn_eval.ros.supervision.process import EventChannel
from barn_eval.ros.trial import RosTrial, RunContext
from barn_eval.trials.outcome import ENVIRONMENT, Outcome, Verdict
from barn_eval.trials.protocol import load_protocol
from barn_eval.trials.result import WallClock, to_json_line
from barn_eval.trials.ros_config import EvaluatorConfig
from barn_eval.trials.run_config import ExecutionConfig, PlannerChoice, RunConfig
from barn_eval.trials.spec import TrialSpec, simulator_config
from barn_eval.trials.trial import finish_trial
from barn_worlds.base.config import from_dict
from barn_worlds.base.errors import BarnError
from barn_worlds.base.text_files import read_json
from barn_worlds.base.types import nanoseconds
from barn_worlds.robots.files import load_robot
from barn_worlds.ros.parameters import declare

# Outcomes after which a process cannot be trusted with the next trial, and which process that is.
FAULTS = {
    **dict.fromkeys(
        (Outcome.NO_FIRST_MOTION, Outcome.PLANNER_NOT_READY, Outcome.PLANNER_STALLED),
        PLANNER,
    ),
    **dict.fromkeys(
        (Outcome.WRONG_MESSAGE_TYPE, Outcome.INVALID_COMMAND, Outcome.INTERFERENCE),
        PLANNER,
    ),
    Outcome.SIMULATOR_DIED: SIMULATOR,
}
STARTS = 3  # how often a trial is begun while it fails for a reason that is not the planner's, or does not begin
_RESTART_S = 20.0


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
    assignment = from_dict(
        Assignment, read_json(Path(config.assignment)), config.assignment
    )
    context = RunContext(
        node, config, supervisor, assignment.experiment.dataset, assignment.robot
    )
    session = context.session

    def keep(record: TrialRecord) -> None:
        session.tell(
            "result", row=to_json_line(record.result), track=record.track or ""
        )

    if assignment.look_first:
        context.integrity.require_alone(session, os.environ.get("ROS_DOMAIN_ID", ""))
        for name in (SIMULATOR, PLANNER):
            session.tell("start", name=name)
    Runner(context, assignment.store, keep, apart=assignment.apart).run(
        assignment.specs()
    )
    session.tell("done")


def run_alone(node: Node, config: EvaluatorConfig) -> None:
    """Run what the parameters say, with a simulator and a planner that somebody else starts."""
    protocol = load_protocol(config.protocol)
    experiment = RunConfig(
        planners=(PlannerChoice(config.planner),),
        protocol=protocol,
        simulator=simulator_config(protocol, robot=load_robot(config.robot)),
        mode="ros",
        **{
            name: getattr(config, name)
            for name in ("dataset", "worlds", "seed", "repetitions", "bags")
        },
    )
    execution, out = ExecutionConfig(workers=1), Path(config.out)
    with ResultsFolder.open(
        out,
        experiment,
        execution,
        experiment.trials(started_by_hand=True),
        isolation=session_isolation(experiment.ros),
    ) as folder:
        context = RunContext(node, config, None, config.dataset, config.robot)
        Runner(context, BagStore(out, config.bags), folder.append).run(folder.remaining)
        folder.complete()


class Runner:
    """Runs trial after trial, each with its bag and row, and puts the others right again after a fault.

    keep: takes what is to be kept of each trial once its bag is in the store. apart: the planner cannot
    have ended another process; by hand nobody says.
    """

    def __init__(
        self,
        context: RunContext,
        store: BagStore,
        keep: Callable[[TrialRecord], None],
        *,
        apart: bool = True,
    ) -> None:
        self._context, self._store, self._keep, self._apart = (
            context,
            store,
            keep,
            apart,
        )
        self._failed_starts = self._driven = 0

    def run(self, trials: Iterable[TrialSpec]) -> None:
        """Run to the end; BarnError where no trial can be made at all."""
        for spec in trials:
            while not self._attempt(spec):
                pass

    def _attempt(self, spec: TrialSpec) -> bool:
        self._context.session.tell("trial", id=spec.trial_id)
        began_s = time.monotonic()
        with self._store.recorder(spec.trial_id) as recorder:
            fresh = (
                not self._driven or self._failed_starts > 0
            )  # processes that have just been started
            trial = RosTrial(self._context, spec, recorder, first=fresh)
            verdict = trial.run()
            if (
                trial.released
                and not self._apart
                and verdict.fault in (SIMULATOR, ENVIRONMENT)
            ):
                verdict = replace(
                    verdict, detail=f"{verdict.detail}; {NOT_TOLD}", culprit=PLANNER
                )
            missed = self._settle(verdict)
            self._driven += trial.released
            if self._is_to_be_repeated(verdict, trial):
                return False
            clock = self._wall_clock(trial, verdict, time.monotonic() - began_s, missed)
            finished = finish_trial(
                spec,
                "ros",
                verdict,
                trial.trial.log.trajectory(),
                wall_clock=clock,
                recoveries=trial.trial.recoveries,
                planner_verdict=trial.planner_verdict,
                remarks="; ".join(
                    filter(None, (clock.remark, self._context.integrity.remarks))
                ),
            )
            if recorder is not None:
                finish_bag(recorder, finished)
        self._keep(self._store.make_record(finished))
        return True

    def _is_to_be_repeated(self, verdict: Verdict, trial: RosTrial) -> bool:
        """Tell whether a trial is worth another start: it did not begin, or the planner is not to blame for its end."""
        # a planner may end between two trials, for instance because it has reached its goal: its successor drives
        unbegun = verdict.outcome is Outcome.PLANNER_DIED and not trial.released
        not_its_fault = verdict.fault in (SIMULATOR, ENVIRONMENT)
        if self._context.session.supervisor is None or not (unbegun or not_its_fault):
            self._failed_starts = 0
            return False
        self._failed_starts += 1
        if self._failed_starts < STARTS:
            if trial.released:
                self._context.session.tell(
                    "repeated", reason=f"{verdict.outcome.value}, {verdict.detail}"
                )
            return True
        self._failed_starts = 0
        if not self._driven:
            raise BarnError(f"{verdict.detail} at its start, {STARTS} times in a row")
        return False

    def _settle(self, verdict: Verdict) -> int:
        """Stop the simulator, restart what is in doubt, and return in how many cycles the simulator waited in vain."""
        session, restart = self._context.session, self._context.config.restart_planner
        doubtful, missed = FAULTS.get(verdict.outcome), 0
        try:
            missed = self._context.simulator.pause() if doubtful != SIMULATOR else 0
        except TrialEnded as end:
            session.node.get_logger().warning(f"after the verdict: {end}")
            doubtful = SIMULATOR
        if doubtful == SIMULATOR:
            session.restart(SIMULATOR, _RESTART_S)
        if restart == "each_trial" or (doubtful == PLANNER and restart == "on_fault"):
            session.restart(PLANNER, _RESTART_S)
        return missed

    def _wall_clock(
        self, trial: RosTrial, verdict: Verdict, lasted_s: float, waited: int
    ) -> WallClock:
        factor = verdict.duration_s / trial.wall_s if trial.wall_s else None
        if (adapter := trial.adapter) is None:
            return WallClock(lasted_s, factor, missed_cycles=waited)
        spec, rate_hz, missed = (
            trial.trial.spec,
            self._context.config.planner_rate_hz,
            waited,
        )
        period_s = (
            1.0 / rate_hz
            if rate_hz
            else spec.simulator.scan_steps * spec.simulator.control_period_s
        )
        silence_s = max(spec.simulator.drive.command_timeout_s, 2.0 * period_s)
        period_ns, came = nanoseconds(period_s), (adapter.commands_ns, adapter.now_ns)
        # while a longer cycle is under way, no command is owed
        if max(spec.compute.charged_s, spec.compute.period_s) <= period_s:
            missed = max(
                missed, missed_periods(*came, period_ns, nanoseconds(silence_s))
            )
        share = missed_share(missed, *came, period_ns)
        return WallClock.from_answer_times(
            lasted_s,
            factor,
            adapter.response_times_s,
            missed_cycles=missed,
            missed_share=share,
        )


if __name__ == "__main__":
    sys.exit(main())
