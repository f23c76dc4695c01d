#!/usr/bin/env bash
# Build and test the given packages with colcon, in as many processes as there are processors: whole files of tests, or,
# where colcon.meta says so, single tests. The last line counts what the test result files hold.
set -euo pipefail
cd "$(dirname "$0")/.."
python="$(command -v python)"
"$python" -m colcon build --packages-select "$@" --event-handlers console_cohesion- desktop_notification-
# What tests start runs from the installation, which holds copies. So that nothing is compiled twice it shares the folders
# of compiled kernels with the source; numba takes a kernel only for a file of the same time, to the nanosecond.
for package in "$@"; do
    source="$PWD/$package/$package"
    installed="$(find "install/$package" -type d -path "*-packages/$package")"
    (cd "$installed" && find . -name '*.py') | while IFS= read -r file; do
        kernels="$(dirname "$file")/__pycache__"
        touch -r "$source/$file" "$installed/$file"
        mkdir -p "$source/$kernels"
        rm -rf "${installed:?}/$kernels"
        ln -s "$source/$kernels" "$installed/$kernels"
    done
done
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
