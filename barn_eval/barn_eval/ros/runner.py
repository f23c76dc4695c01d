"""A run over ROS: trial after trial, each with its bag and row, and the others put right again after a fault."""

import time
from collections.abc import Callable, Iterable

from barn_eval.experiments.store import Record, Store, finish_bag
from barn_eval.ros.session import PLANNER, SIMULATOR, TrialEnded
from barn_eval.ros.trial import RosTrial, RunContext
from barn_eval.trials.outcome import ENVIRONMENT, Outcome, Verdict
from barn_eval.trials.result import WallClock
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trial import conclude
from barn_worlds.base.errors import BarnError

# Outcomes after which a process cannot be trusted with the next trial, and which process that is.
FAULTS = {
    Outcome.NO_FIRST_MOTION: PLANNER,
    Outcome.PLANNER_NOT_READY: PLANNER,
    Outcome.PLANNER_STALLED: PLANNER,
    Outcome.WRONG_MESSAGE_TYPE: PLANNER,
    Outcome.INVALID_COMMAND: PLANNER,
    Outcome.INTERFERENCE: PLANNER,
    Outcome.SIMULATOR_DIED: SIMULATOR,
}
STARTS = 3  # how often a trial is begun while it fails for a reason that is not the planner's, or does not begin
_RESTART_S = 20.0


class Runner:
    """Runs trials; `keep` takes what is to be kept of each once its bag and picture are in the store."""

    def __init__(self, context: RunContext, store: Store, keep: Callable[[Record], None]) -> None:
        self._context = context
        self._store = store
        self._keep = keep
        self._failed_starts = 0
        self._driven = 0

    def run(self, trials: Iterable[TrialSpec]) -> None:
        """Run to the end; BarnError where no trial can be made at all."""
        for spec in trials:
            while not self._attempt(spec):
                pass

    def _attempt(self, spec: TrialSpec) -> bool:
        self._context.session.tell("trial", id=spec.trial_id)
        began_s = time.monotonic()
        with self._store.recorder(spec.trial_id) as recorder:
            fresh = not self._driven or self._failed_starts > 0  # processes that have just been started
            trial = RosTrial(self._context, spec, recorder, first=fresh)
            verdict = trial.run()
            missed = self._settle(verdict)
            self._driven += trial.released
            if self._is_to_be_repeated(verdict, trial):
                return False
            wall_clock = _wall_clock(trial, verdict, time.monotonic() - began_s, missed)
            finished = conclude(
                spec,
                "ros",
                verdict,
                trial.trial.log.trajectory(),
                wall_clock=wall_clock,
                recoveries=trial.trial.recoveries,
                planner_verdict=trial.planner_verdict,
                remarks="; ".join(filter(None, (wall_clock.remark, self._context.integrity.remarks))),
            )
            if recorder is not None:
                finish_bag(recorder, finished)
        self._keep(self._store.keep(finished))
        return True

    def _is_to_be_repeated(self, verdict: Verdict, trial: RosTrial) -> bool:
        """Tell whether a trial is worth another start: it did not begin, or the planner is not to blame for its end.

        A planner may end between two trials, for instance because it has reached its goal: its successor drives.
        """
        unbegun = verdict.outcome is Outcome.PLANNER_DIED and not trial.released
        not_its_fault = verdict.fault in (SIMULATOR, ENVIRONMENT)
        if self._context.session.supervisor is None or not (unbegun or not_its_fault):
            self._failed_starts = 0
            return False
        self._failed_starts += 1
        if self._failed_starts < STARTS:
            if trial.released:
                self._context.session.note(
                    f"{trial.trial.spec.trial_id} is repeated: {verdict.outcome.value}, {verdict.detail}"
                )
            return True
        self._failed_starts = 0
        if not self._driven:
            raise BarnError(f"{verdict.detail} at its start, {STARTS} times in a row")
        return False

    def _settle(self, verdict: Verdict) -> int:
        """Leave the simulator standing still, and processes that are in doubt to be started afresh.

        Returns in how many cycles the simulator has waited in vain, 0 where it cannot say.
        """
        session, restart = self._context.session, self._context.config.restart_planner
        doubtful, missed = FAULTS.get(verdict.outcome), 0
        if doubtful != SIMULATOR:
            try:
                missed = self._context.simulator.pause()
            except TrialEnded as end:
                session.node.get_logger().warning(f"after the verdict: {end}")
                doubtful = SIMULATOR
        if doubtful == SIMULATOR:
            session.restart(SIMULATOR, _RESTART_S)
        if restart == "each_trial" or (doubtful == PLANNER and restart == "on_fault"):
            session.restart(PLANNER, _RESTART_S)
        return missed


def _wall_clock(trial: RosTrial, verdict: Verdict, lasted_s: float, waited: int) -> WallClock:
    """Return the figures of a trial, given in how many cycles the simulator has waited in vain."""
    factor = verdict.duration_s / trial.wall_s if trial.wall_s else None
    if (adapter := trial.adapter) is None:
        return WallClock.of(lasted_s, [], factor, waited)
    missed = max(waited, adapter.punctuality.missed)
    return WallClock.of(lasted_s, adapter.response_times_s, factor, missed, adapter.punctuality.share_of(missed))
