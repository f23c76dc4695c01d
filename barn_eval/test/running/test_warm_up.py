"""Preparing a run: planners are tried out, and one that fails there is left to fail its
trials.
"""

from unittest.mock import Mock

import pytest
from planners import Faulty, Straight
from waiting import run_python

from barn_eval.running import direct as module
from barn_eval.running.direct import warm_up
from barn_eval.trials.run_config import PlannerChoice, RunConfig
from barn_worlds.formats.dataset_file import write_dataset_file

# A process of its own: in this one, other tests have compiled kernels already.
SCRIPT = """
import gc
import sys

from numba.core.dispatcher import Dispatcher

from barn_eval.running.direct import run_direct_trial, warm_up
from barn_eval.running.request import read_request


def compiled_kernels():
    kernels = [item for item in gc.get_objects() if isinstance(item, Dispatcher)]
    return {
        (kernel.py_func.__module__, kernel.py_func.__name__)
        for kernel in kernels
        if kernel.signatures
    }


options = {"planners": sys.argv[1], "worlds": "244", "seed": 5, "out": "none"}
request = read_request(None, options)
(trial,) = request.config.trials(started_by_hand=False)
warm_up(trial, with_planner=True)
before = compiled_kernels()
run_direct_trial(trial)
for module, name in compiled_kernels() - before:
    if module.startswith("barn_planners"):
        print(module, name)
"""


@pytest.fixture
def spec(tmp_path, open_world, monkeypatch):
    """A trial, and a process that has not run any."""
    monkeypatch.setattr(module, "_warm", set())
    write_dataset_file(tmp_path / "one.npz", "one", {0: open_world})
    (spec,) = RunConfig(
        dataset=str(tmp_path / "one.npz"), planners=(PlannerChoice("dwa"),)
    ).trials()
    return spec


def test_the_planner_has_decided_before_the_first_trial(spec, monkeypatch):
    planner = Mock(wraps=Straight())
    monkeypatch.setattr(module, "make_planner", lambda *_: planner)
    warm_up(spec, with_planner=True)
    steps = planner.step.call_count
    assert steps > 0
    warm_up(spec, with_planner=True)
    assert planner.step.call_count == steps, "once per process is enough"


def test_a_planner_that_fails_is_left_to_its_trials(spec, monkeypatch):
    planner = Faulty("raises", after=0)
    monkeypatch.setattr(module, "make_planner", lambda *_: planner)
    warm_up(spec, with_planner=True)
    assert planner.cycle == 1


def test_a_foreign_planner_is_not_made_here(spec, monkeypatch):
    monkeypatch.setattr(
        module, "make_planner", lambda *_: pytest.fail("there is no such planner here")
    )
    warm_up(spec, with_planner=False)


@pytest.mark.parametrize("planner", ["dwa", "eband", "gap", "mppi", "policy"])
def test_a_planner_compiles_nothing_in_its_first_trial(planner):
    process = run_python("-c", SCRIPT, planner, check=False)
    assert (process.returncode, process.stdout) == (0, ""), process.stderr
