"""Processes of this machine."""

import os
import signal
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


def alive(pid: int) -> bool:
    """Tell whether a process runs."""
    with suppress(OSError):
        stat = Path(f"/proc/{pid}/stat").read_text()
        # The state follows the name, which may hold anything, parentheses too.
        state = stat.rpartition(")")[2].split()[0]
        return state != "Z"
    return False


def peak_memory_mb(pid: int) -> int:
    """Return the most memory that a process has taken.

    Raises:
        StopIteration: Once it has ended.
    """
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    peak = next(line for line in lines if "VmHWM" in line)
    return int(peak.split()[1]) // 1000
