from setuptools import setup

setup()  # setup.cfg has it all; colcon runs this file
