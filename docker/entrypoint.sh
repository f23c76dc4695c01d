#!/bin/bash
# Source ROS and the suite, then become the command.
set -e
# shellcheck source=/dev/null
source /opt/ros/jazzy/setup.bash
# shellcheck source=/dev/null
source /opt/barn/workspace/install/setup.bash
exec "$@"
