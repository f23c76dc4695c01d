#!/bin/bash
# Run a command in a ROS workspace, from a shell in which none is sourced:
#
#     bash examples/in_workspace.sh install/setup.bash ros2 run my_nav planner
#
# So the workspace's Python and the suite's need not be the same.
unset PYTHONPATH
source "$1" && exec "${@:2}"
