"""Compiling what trials need before the first of them, so that no deadline and no figure contains it."""

from __future__ import annotations

from contextlib import closing, suppress

from barn_eval.experiments.runs import RunPlan
from barn_eval.trials.spec import TrialSpec
from barn_planners.registry import make_planner
from barn_planners.session import PlannerSession
from barn_sim.simulator import Simulator
from barn_worlds.types import STOP


def warm_up(plan: RunPlan) -> None:
    """Let simulator and planner of a plan do a few cycles.

    The machine code of their kernels is kept on disk, where the processes of a run over ROS find it: on a new machine
    they would else be busy compiling for longer than anybody waits for a node. A planner that does not survive this
    fails its trials, which say why.
    """
    trial = next(plan.trials())
    _run_simulator(trial)
    if not plan.planner_command:
        _run_planner(trial)


def _run_simulator(trial: TrialSpec) -> None:
    with closing(Simulator(trial.world, trial.simulator, trial.course.start, trial.simulator_seed)) as simulator:
        simulator.sense()
        simulator.step(STOP)


def _run_planner(trial: TrialSpec) -> None:
    planner = make_planner(trial.planner, trial.preset, trial.overrides)
    session = PlannerSession(planner, seed=0, use_map=trial.protocol.map_given)
    with suppress(Exception):  # the trials report it
        session.warm_up()
