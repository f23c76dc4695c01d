import os
import sys

from setuptools import setup

# colcon itself runs in the system's Python. Executables get the Python of the
# environment that is active, which has the suite's libraries.
if "VIRTUAL_ENV" in os.environ:
    sys.executable = os.environ["VIRTUAL_ENV"] + "/bin/python"

setup()  # setup.cfg has it all; colcon looks for this call without arguments
