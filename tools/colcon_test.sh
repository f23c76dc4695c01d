#!/usr/bin/env bash
# Build and test the given packages with colcon, files of tests in as many processes as there are processors. The last
# line counts what the test result files hold.
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
    "$python" -m colcon test --packages-select "$@" --executor sequential --return-code-on-test-failure \
        --event-handlers console_direct+ desktop_notification- --pytest-args " -n" auto " --dist" loadfile
) || status=$?
"$python" -m colcon test-result --verbose || status=1
"$python" tools/count_results.py build "$@" || status=1
exit "$status"
