"""Imports the packages before pytest names the modules of tests after their folders.

Folders and packages have the same names, so the folders would hide the packages.
"""

import sys
from importlib.util import find_spec

import barn_eval  # noqa: F401
import barn_metrics  # noqa: F401
import barn_planners  # noqa: F401
import barn_sim  # noqa: F401
import barn_worlds  # noqa: F401

# The colcon of the system runs tests in the system's Python.
if not find_spec("cattrs"):
    raise ImportError(
        f"{sys.executable} lacks the suite's libraries: activate their environment"
        " and run python -m colcon test"
    )
