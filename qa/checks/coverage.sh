#!/usr/bin/env bash
# Run all tests that need no ROS, and report the branches of the packages that they reach. Tests of kernels run a second
# time as Python, since coverage.py does not see what machine code does.
set -euo pipefail
cd "$(dirname "$0")/../.."
export COVERAGE_FILE="$PWD/build/coverage/data"
rm -rf build/coverage
mkdir -p build/coverage
python -m coverage run -m pytest -q -n auto --dist loadfile --ignore-glob='*/test/ros/*'
python -m coverage run -m pytest -q barn_worlds/test/ros/test_domain.py # a lock, which needs no ROS
# These have passed above. As Python some take too long.
kernels() {
    local package=$1
    shift
    NUMBA_DISABLE_JIT=1 python -m coverage run -m pytest -q -n auto --timeout 120 "${@/#/$package/test/}" || true
}
kernels barn_worlds worlds datasets/test_generate.py moving formats/test_gazebo.py
kernels barn_sim body contact sensors test_sim_motion.py test_simulator.py
kernels barn_planners costmap dwa/test_kernels.py eband/test_kernels.py mppi/test_kernels.py global_plan policy gap
kernels barn_metrics test_metrics.py test_features.py
python -m coverage combine --quiet
python qa/checks/coverage_report.py "$@"
