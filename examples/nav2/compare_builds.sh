#!/usr/bin/env bash
# Drive the same worlds with two builds of Nav2's plugins in lockstep, and say which is better:
#
#     examples/nav2/compare_builds.sh OUT WORLDS BASE HEAD CONTROLLER [FILE...]
#
# OUT: folder for the results. WORLDS: as 0:300:15. BASE, HEAD: setup.bash of two workspaces, each with nav2_lockstep.
# CONTROLLER: a file of params without its ending, such as rpp. FILE: more parameters, which count most.
set -euo pipefail

if [ $# -lt 5 ]; then
    sed -n '4s/^# *//p' "$0" >&2
    exit 1
fi
out=$1 worlds=$2 base=$3 head=$4 controller=$5
shift 5
params=$(cd "$(dirname "$0")" && pwd)/params

arguments=(--ros-args)
for file in "$params"/{common,mapless,"$controller"}.yaml "$@"; do
    arguments+=(--params-file "$(realpath -e "$file")")
done

# drive NAME SETUP: a run of its own, resumed if it was interrupted
drive() {
    local inner command
    printf -v inner '. %q && exec ros2 run nav2_lockstep nav2_lockstep %s' "$(realpath -e "$2")" "${arguments[*]@Q}"
    printf -v command 'bash -c %q' "$inner"
    barn run --worlds "$worlds" --protocol challenge --mode ros --planner "nav2_$controller" --out "$out/$1" \
        --bags none --no-pictures --ros restart_planner=each_trial --ros command_wait_s=30 --planner-command "$command"
}

drive base "$base"
drive head "$head"
barn compare "$out/base" "$out/head"
