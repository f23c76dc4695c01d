#!/usr/bin/env bash
# From nothing to a score, by the README's own lines: install a clone, run the demo, and drive the planner of the examples.
#
#     qa/release/way_in.sh FOLDER [PYTHON]     # a folder that does not exist; needs git and a Python with venv
set -euo pipefail
folder=$1 python=${2:-python3}
root=$(cd "$(dirname "$0")/../.." && pwd)
lines() { awk -v first="$1" 'index($0, first) == 1 { sub(/^    /, ""); print; exit }' "$root/README.md"; }
step() {
  local since=$SECONDS
  echo "\$ $1"
  bash -c "$1"
  echo "($((SECONDS - since)) s)"
}

mkdir "$folder"
cd "$folder"
git clone --quiet --no-hardlinks "$root" clone
"$python" -m venv environment
export PATH=$PWD/environment/bin:$PATH ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
(cd clone && step "$(lines '    pip install ".')")
step "barn demo --out demo"
cp -r clone/examples .
step "$(lines '    barn run --worlds 0 --mode ros --protocol challenge --planner simple')"
