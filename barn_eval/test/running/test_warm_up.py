"""The warm-up of a process compiles what its first trial needs."""

import subprocess
import sys

import pytest

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


@pytest.mark.parametrize("planner", ["dwa", "eband", "gap", "mppi", "policy"])
def test_a_planner_compiles_nothing_in_its_first_trial(planner):
    words = [sys.executable, "-c", SCRIPT, planner]
    process = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (process.returncode, process.stdout) == (0, ""), process.stderr
