"""What tests of processes wait for: a condition, or the end of a process."""

import os
import shlex
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]  # of the repository
HANG_S = 600.0  # nothing here takes so long unless it hangs


def until(condition):
    """Wait until a condition holds and return what it gave."""
    deadline = time.monotonic() + HANG_S
    while not (value := condition()):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return value


def barn_words(line):
    """Return the words that run a line of `barn` in a process of its own."""
    return [sys.executable, "-m", "barn_eval", *shlex.split(line)]


def with_search_path(*folders):
    """Return the environment with folders before those where Python looks already.

    In a workspace, these have the packages themselves.
    """
    all_folders = [*map(str, folders), os.environ.get("PYTHONPATH")]
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, all_folders))}


def run_python(*arguments, check=True, **options):
    """Run Python to its end and return the process with what it has written."""
    command = [sys.executable, *map(str, arguments)]
    done = subprocess.run(
        command, check=False, capture_output=True, text=True, **options
    )
    assert not check or done.returncode == 0, done.stderr
    return done


def parent(pid):
    """Return the process that has started another one."""
    return int(_status(pid)[1])


def alive(pid):
    """Tell whether a process has not ended."""
    try:
        return _status(pid)[0] != "Z"
    except OSError:
        return False


def processes():
    """Yield the pid, the parent and the command line of each process."""
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError):  # it has ended meanwhile
                yield (
                    int(entry.name),
                    parent(entry.name),
                    (entry / "cmdline").read_bytes(),
                )


def _status(pid):
    return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
