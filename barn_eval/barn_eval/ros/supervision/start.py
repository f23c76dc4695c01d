"""Start a node by its module and function.

    python start.py barn_sim.ros.simulator:main ARGUMENTS...

Run as a script by its path: no entry point scripts need to be found, and the working
directory does not come into the import path, where the folders of a source tree would
hide the installed packages.
"""

import sys
from importlib import import_module

if __name__ == "__main__":
    # The folder of this script, whose files no node needs to import.
    sys.path.pop(0)
    import_module("barn_worlds.base.garbage").reduce_garbage_collection()
    module, _, function = sys.argv[1].partition(":")
    sys.argv[:2] = [module]
    sys.exit(getattr(import_module(module), function)())
