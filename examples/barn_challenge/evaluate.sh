#!/usr/bin/env bash
# Score an entry of the BARN Challenge by its rules, 10 trials in each of 50 worlds that nobody has tuned for:
#
#     bash examples/barn_challenge/evaluate.sh FOLDER SEED --planner mine --planner-command "ros2 launch my_entry entry.launch.py"
#
# FOLDER gets the worlds, which follow from SEED, and the results. Other options of barn run may follow.
set -euo pipefail
folder=$1
seed=$2
shift 2
mkdir -p "$folder"
test -e "$folder/worlds.npz" || barn worlds generate "$folder/worlds.npz" --seed "$seed" --keep 50
exec barn run "$(dirname "$0")/run.yaml" --dataset "$folder/worlds.npz" --out "$folder/results" "$@"
