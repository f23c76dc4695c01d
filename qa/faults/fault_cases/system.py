"""Processes of this machine."""

import os
import signal
import subprocess
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path


def command_line(pid: int) -> str:
    """Return the command line of a process, empty once it has ended."""
    with suppress(OSError):
        arguments = Path(f"/proc/{pid}/cmdline").read_bytes()
        return arguments.replace(b"\0", b" ").decode("utf-8", "replace")
    return ""


def kill(pids: Sequence[int], number: int = signal.SIGKILL) -> None:
    """Send a signal to processes that may have ended."""
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, number)


def send(pid: int, number: int) -> None:
    """Send a signal to a process, or to its group where a terminal would send it."""
    if number in (signal.SIGTERM, signal.SIGKILL):
        kill([pid], number)
    else:
        os.killpg(pid, number)


def succeeds(words: Sequence[str]) -> bool:
    """Run a program and tell whether it ends with code 0."""
    return subprocess.run(words, check=False, capture_output=True).returncode == 0


def any_lives(note: str) -> bool:
    """Tell whether a process runs that a planner has noted.

    Args:
        note: A line per process: its PID namespace, as /proc/PID/ns/pid links to it,
            and its number there. A planner in a namespace of its own knows no other.
    """
    noted = set(note.splitlines())
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            status = dict(
                line.split(":", 1)
                for line in (folder / "status").read_text().splitlines()
            )
            # The last of the numbers is that of the innermost namespace.
            number = status["NSpid"].split()[-1]
            namespace = (folder / "ns" / "pid").readlink()
            is_zombie = status["State"].split()[0] == "Z"
            if f"{namespace} {number}" in noted and not is_zombie:
                return True
    return False


def peak_memory_mb(pid: int) -> int:
    """Return the most memory that a process has taken.

    Raises:
        StopIteration: Once it has ended.
    """
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    peak = next(line for line in lines if "VmHWM" in line)
    return int(peak.split()[1]) // 1000
