#!/usr/bin/env bash
# Run all tests that need no ROS, and report the branches of the packages that they reach. Tests of kernels run a second
# time as Python, since coverage.py does not see what machine code does.
set -euo pipefail
cd "$(dirname "$0")/../.."
export COVERAGE_FILE="$PWD/build/coverage/data"
rm -rf build/coverage
mkdir -p build/coverage
python -m coverage run -m pytest -q -n auto --dist loadfile --ignore-glob='*/test_*ros*'
python -m coverage run -m pytest -q barn_worlds/test/test_ros_domain.py # a lock, which needs no ROS
# These have passed above. As Python some take too long.
kernels() {
    local package=$1
    shift
    NUMBA_DISABLE_JIT=1 python -m coverage run -m pytest -q -n auto --timeout 120 "${@/#/$package/test/test_}" || true
}
kernels barn_worlds cspace.py path_planner.py generate.py motion.py world.py format_gazebo.py
kernels barn_sim wheels.py tires.py lidar.py particles.py obstacles.py movers.py sim_motion.py simulator.py
kernels barn_planners costmap.py dwa_kernels.py eband_kernels.py mppi_kernels.py global_plan.py policy.py policy_file.py gap.py
kernels barn_metrics metrics.py features.py
python -m coverage combine --quiet
python qa/checks/coverage_report.py "$@"
