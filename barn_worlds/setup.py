import os
import sys
from importlib.util import find_spec

from setuptools import setup

# colcon itself runs in the system's Python. Executables get the Python of the
# environment that is active, which has the suite's libraries.
builds = sys.argv[1:2] == ["develop"] or "install" in sys.argv
if "VIRTUAL_ENV" in os.environ:
    sys.executable = os.environ["VIRTUAL_ENV"] + "/bin/python"
elif builds and not find_spec("cattrs"):
    sys.exit("this Python lacks the suite's libraries: activate their environment")

setup()  # setup.cfg has it all; colcon looks for this call without arguments
