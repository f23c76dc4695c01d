#!/bin/bash
# Source ROS and the suite, then become the command.
set -e
source /opt/ros/jazzy/setup.bash
source /opt/barn/workspace/install/setup.bash
exec "$@"
