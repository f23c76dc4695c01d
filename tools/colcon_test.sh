#!/usr/bin/env bash
# Build and test the given packages with colcon, files of tests in one process more than there are processors: those of
# trials over ROS wait for much of their time. The last line counts what the test result files hold.
set -euo pipefail
cd "$(dirname "$0")/.."
python="$(command -v python)"
"$python" -m colcon build --packages-select "$@" --event-handlers console_cohesion- desktop_notification-
status=0
# shellcheck disable=SC1091
(
    set +u
    source install/setup.bash
    set -u
    processes=$("$python" -c "import os; print(len(os.sched_getaffinity(0)) + 1)")
    "$python" -m colcon test --packages-select "$@" --executor sequential --return-code-on-test-failure \
        --event-handlers console_direct+ desktop_notification- --pytest-args " -n" "$processes" " --dist" loadfile
) || status=$?
"$python" -m colcon test-result --verbose || status=1
"$python" tools/count_results.py build "$@" || status=1
exit "$status"
