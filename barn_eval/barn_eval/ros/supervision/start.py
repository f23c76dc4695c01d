"""Start a node by the name of its module and function: `python start.py barn_sim.ros.simulator:main ARGUMENTS...`.

Run as a script by its path, so that neither entry point scripts need to be found nor does the working directory come
into the import path, where a source tree's folders would hide the installed packages.
"""

import sys
from importlib import import_module

if __name__ == "__main__":
    sys.path.pop(0)
    import_module("barn_worlds.base.garbage").reduce_garbage_collection()
    module, _, function = sys.argv[1].partition(":")
    sys.argv[:2] = [module]
    sys.exit(getattr(import_module(module), function)())
