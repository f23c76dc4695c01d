"""The processes of a campaign as Linux shows them under /proc.

They are recognized by a variable that all of them inherit.
"""

import os
import re
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

MARK = "BARN_TOOL_SESSION"  # variable of the environment
# a protocol of short trials
NEAR = (
    "schema_version: 1\nbase: challenge\nname: near\ngoal: {y_m: 2.0}\nlimit_s: 10.0\n"
)
SHARED_MEMORY = Path("/dev/shm")  # noqa: S108  # nosec B108
ROLES = ("campaign", "worker", "guard", "simulator", "planner", "evaluator")
_NODES = {
    "barn_sim.ros": "simulator",
    "barn_planners.ros": "planner",
    "barn_eval.ros": "evaluator",
}


@dataclass(frozen=True)
class Seen:
    """A process: its number, the time of its start and its role.

    The time in ticks tells it from a later process with the same number.
    """

    pid: int
    start: int
    role: str


@dataclass(frozen=True)
class Usage:
    """What a process uses.

    Memory as resident, and that of it which is of no file, in bytes; open handles;
    threads.
    """

    rss_bytes: int = 0
    anonymous_bytes: int = 0
    handles: int = 0
    threads: int = 0


def list_marked(mark: str) -> list[Seen]:
    """Return the living processes with that mark, in the order of their numbers."""
    entry = f"{MARK}={mark}".encode()
    processes = []
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit():
            continue
        with suppress(OSError, IndexError):
            if entry in (folder / "environ").read_bytes().split(b"\0"):
                stat = (folder / "stat").read_text()
                fields = stat.rsplit(")", 1)[1].split()
                if fields[0] not in "ZX":
                    role_here = role(_arguments(folder))
                    processes.append(Seen(int(folder.name), int(fields[19]), role_here))
    return sorted(processes, key=lambda process: process.pid)


def role(arguments: Sequence[str]) -> str:
    """Return what a process of ours is for, by its command line.

    "other" where that is none of the known ones.
    """
    scripts = [argument.rsplit("/", 1)[-1] for argument in arguments[1:4]]
    if "launcher.py" in scripts:
        return "guard"
    if "barn_eval.running.worker" in scripts:
        return "worker"
    if "start.py" in scripts:
        for part, name in _NODES.items():
            if any(part in argument for argument in arguments):
                return name
        return "other"
    return "campaign" if "barn_eval" in arguments else "other"


def usage(process: Seen) -> Usage:
    """Return what a process uses, nothing if it has ended.

    Raises:
        OSError: Where that cannot be told.
    """
    folder = Path("/proc") / str(process.pid)
    try:
        memory = (folder / "smaps_rollup").read_text()
        status = (folder / "status").read_text()
        handles = len(list((folder / "fd").iterdir()))
    except (FileNotFoundError, ProcessLookupError):
        return Usage()
    return Usage(
        _number(memory, "Rss") * 1024,
        _number(memory, "Anonymous") * 1024,
        handles,
        _number(status, "Threads"),
    )


def wait_for_end(mark: str, limit_s: float) -> list[Seen]:
    """Wait for all processes with a mark to end, and return those still alive.

    They are alive after the limit.
    """
    deadline = time.monotonic() + limit_s
    while (left := list_marked(mark)) and time.monotonic() < deadline:
        time.sleep(0.1)
    return left


def list_segments(processes: Sequence[Seen]) -> set[str]:
    """Return the names of the entries of shared memory that processes have mapped."""
    names: set[str] = set()
    for process in processes:
        with suppress(OSError):
            maps = Path(f"/proc/{process.pid}/maps").read_text()
            names.update(re.findall(rf"{SHARED_MEMORY}/(\S+)", maps))
    return names


def campaign_command(**options: object) -> list[str]:
    """Return the command of a campaign with these options."""
    words = [f"--{name}={value}" for name, value in options.items()]
    return [sys.executable, "-m", "barn_eval", "campaign", *words]


def environment(mark: str, temporary: Path) -> dict[str, str]:
    """Return the environment of a campaign whose processes carry that mark."""
    temporary.mkdir(parents=True, exist_ok=True)
    return os.environ | {MARK: mark, "TMPDIR": str(temporary)}


def _arguments(folder: Path) -> list[str]:
    return (folder / "cmdline").read_bytes().decode("utf-8", "replace").split("\0")


def _number(text: str, name: str) -> int:
    match = re.search(rf"^{name}:\s+(\d+)", text, re.MULTILINE)
    return int(match.group(1)) if match else 0
