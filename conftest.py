"""Imports the packages before pytest names the modules of tests after their folders.

Folders and packages have the same names, so the folders would hide the packages.
"""

import barn_eval  # noqa: F401
import barn_metrics  # noqa: F401
import barn_planners  # noqa: F401
import barn_sim  # noqa: F401
import barn_worlds  # noqa: F401
