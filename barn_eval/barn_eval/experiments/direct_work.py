"""What a worker does with a trial in direct mode."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from barn_eval.experiments.engine import Emit, Job, Work
from barn_eval.experiments.live import LivePlanner
from barn_eval.experiments.store import Record, Store


@dataclass(frozen=True)
class DirectWork(Work):
    """Trials in one process. planners: those given as Python objects, by name."""

    store: Store
    planners: Mapping[str, LivePlanner] = field(default_factory=dict)

    def run(self, job: Job, emit: Emit) -> Record:  # noqa: ARG002 (one result per job)
        """Run the one trial of a job; BagError where its bag cannot be written."""
        from barn_eval.experiments.direct import run_direct_trial  # noqa: PLC0415 (loads simulator and planners in the worker)
        from barn_eval.experiments.warm_up import warm_up  # noqa: PLC0415

        (spec,) = job.trials
        live = self.planners.get(spec.planner)
        warm_up(spec, with_planner=live is None)
        with self.store.recorder(spec.trial_id) as recorder:
            return self.store.keep(run_direct_trial(spec, recorder, live.make() if live else None))
