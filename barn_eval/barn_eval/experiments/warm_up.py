"""Compiling and loading what trials need before the first of them, so that no deadline and no figure contains it."""

from contextlib import closing, suppress

from barn_eval.trials.spec import TrialSpec
from barn_planners.registry import make_planner
from barn_planners.session import PlannerSession
from barn_sim.simulator import Simulator
from barn_worlds.types import STOP

_ready: set[tuple[str, str]] = set()  # what this process has done so far; it decides no result


def warm_up(spec: TrialSpec, *, with_planner: bool) -> None:
    """Let the simulator, and a new planner of the trial's kind, do a few cycles, once per process.

    The machine code of their kernels is also kept on disk, where nodes of ROS find it: on a new machine they would else
    be busy compiling for longer than anybody waits for a node. A planner that does not survive this fails its trials,
    which say why.
    """
    if ("", "") not in _ready:
        _ready.add(("", ""))
        with closing(Simulator(spec.world, spec.simulator, spec.course.start, spec.simulator_seed)) as simulator:
            simulator.sense()
            simulator.step(STOP)
    if with_planner and (spec.planner, spec.preset) not in _ready:
        _ready.add((spec.planner, spec.preset))
        planner = make_planner(spec.planner, spec.preset, spec.overrides)
        with suppress(Exception):  # the trials report it
            PlannerSession(planner, seed=0, use_map=spec.protocol.map_given).warm_up()
