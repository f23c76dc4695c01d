#!/usr/bin/env bash
# Build and test the given packages with colcon, and run the tests of the repository, in several processes: whole files
# of tests, or, where colcon.meta says so, single tests. The last line counts what the test result files hold.
set -euo pipefail
cd "$(dirname "$0")/../.."
python="$(command -v python)"
unset PYTHONDONTWRITEBYTECODE # set in many images: every process that a test starts would compile all modules anew
processes=$(($(nproc) + 1)) # one more than processors: tests of processes wait for them to start and to end
"$python" -m colcon build --packages-select "$@" --event-handlers console_cohesion- desktop_notification-
# What tests start runs from the installation, which holds copies. So that nothing is compiled twice it shares the folders
# of compiled kernels with the source; numba takes a kernel only for a file of the same time, to the nanosecond.
for package in "$@"; do
    # listed first: the loop removes folders that find would still look into
    mapfile -t files < <(find "install/$package" -path "*-packages/$package/*.py")
    for file in "${files[@]}"; do
        source="$PWD/$package/$package/${file#*-packages/"$package"/}"
        [[ -e "$source" ]] || continue # removed since the last build
        touch -r "$source" "$file"
        mkdir -p "${source%/*}/__pycache__"
        rm -rf "${file%/*}/__pycache__"
        ln -s "${source%/*}/__pycache__" "${file%/*}/__pycache__"
    done
done
status=0
# shellcheck disable=SC1091
(
    set +u
    source install/setup.bash
    set -u
    "$python" -m colcon test --packages-select "$@" --executor sequential --return-code-on-test-failure \
        --event-handlers console_direct+ desktop_notification- --pytest-args " -n" "$processes" " --dist" loadfile || ended=$?
    "$python" -m pytest tests -n "$processes" --dist loadfile --no-loadscope-reorder --durations=5 \
        --junit-xml build/tests/pytest.xml || ended=$?
    exit "${ended:-0}"
) || status=$?
"$python" -m colcon test-result --verbose || status=1
"$python" qa/checks/count_results.py build "$@" tests || status=1
exit "$status"
