#!/usr/bin/env bash
# Compile the suite's kernels: drive each planner once, and a robot among obstacles. Results go to the given folder.
set -euo pipefail
drive() { barn campaign --worlds 0 --repetitions 1 --overwrite --out "$1" "${@:2}" > /dev/null; }
drive "$1" --planners dwa,eband,mppi,gap,policy
drive "$1" --planners dwa,eband --protocol paper2020
python3 -c "from barn_sim.simulator import warm_up; warm_up()"
