"""Run one command and see to it that nothing of it is left, whatever happens to the process that asked for it.

Started as a script of its own, with nothing but the standard library, as `python guard.py FD -- COMMAND...`. FD is a
socket to the supervisor. The guard reports "started PID", "exited CODE" (negative: the signal) or "failed REASON"
there, one per line. When the supervisor writes "stop", or its end of the socket closes because it died, the command
and all its descendants are ended: by SIGINT first, as Ctrl-C does it, then SIGTERM, then SIGKILL.
"""

import ctypes
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

_PR_SET_PDEATHSIG = 1
_PR_SET_CHILD_SUBREAPER = 36
# How long each signal is given. Python nodes need some 100 ms for SIGINT, ros2 launch several seconds.
PATIENCE_S = ((signal.SIGINT, 5.0), (signal.SIGTERM, 3.0), (signal.SIGKILL, 5.0))
_ORPHANS_PATIENCE_S = 0.5  # for what is left when the command itself has ended


def main(arguments: list[str]) -> int:
    """Run the command given behind "--" and return 0 once nothing of it is left."""
    link = socket.socket(fileno=int(arguments[0]))
    link.setblocking(False)
    command = arguments[2:]
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)  # orphans of the command become children of the guard
    wake = _wake_on_signals()
    try:
        child = subprocess.Popen(  # noqa: S603
            command,
            start_new_session=True,
            close_fds=False,  # what the supervisor hands down is for the command
            preexec_fn=_prepare(libc, link.fileno()),  # noqa: PLW1509 (no threads here)
        )
    except OSError as error:
        _report(link, f"failed {command[0]}: {error.strerror or error}")
        return 0
    _report(link, f"started {child.pid}")
    _wait(child, link, wake)
    _end(child, link)
    _report(link, f"exited {child.wait()}")
    return 0


def _wake_on_signals() -> socket.socket:
    """Make a dead child, or a signal to end the guard itself, readable on the socket returned."""
    reader, writer = socket.socketpair()
    reader.setblocking(False)
    writer.setblocking(False)
    signal.set_wakeup_fd(writer.detach(), warn_on_full_buffer=False)
    for number in (signal.SIGCHLD, signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, lambda *_: None)
    return reader


def _prepare(libc: ctypes.CDLL, link: int) -> Callable[[], None]:
    def prepare() -> None:
        os.close(link)
        libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)  # the command dies with the guard
        for number in (signal.SIGCHLD, signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)

    return prepare


def _wait(child: subprocess.Popen[bytes], link: socket.socket, wake: socket.socket) -> None:
    """Return when the command has ended by itself, or is to be ended."""
    while child.poll() is None:
        ready, _, _ = select.select([link, wake], [], [])
        if link in ready:
            return  # "stop", or the end of the supervisor
        if set(wake.recv(64)) & {signal.SIGTERM, signal.SIGINT, signal.SIGHUP}:
            return


def _end(child: subprocess.Popen[bytes], link: socket.socket) -> None:
    """End the command and its descendants; a second "stop" skips what patience is left."""
    hurried = False
    _drain(link)
    for number, patience_s in PATIENCE_S:
        if hurried and number != signal.SIGKILL:
            continue
        if not _descendants(child):
            return
        _signal_all(child, number)
        sent_s = time.monotonic()
        while _descendants(child) and not hurried:
            waited_s = time.monotonic() - sent_s
            if waited_s > (patience_s if child.returncode is None else _ORPHANS_PATIENCE_S):
                break
            ready, _, _ = select.select([link], [], [], 0.02)
            hurried = bool(ready) and _drain(link)


def _drain(link: socket.socket) -> bool:
    """Tell whether the supervisor has written something; if it is gone, nothing more will come."""
    with suppress(OSError):
        if link.recv(4096):
            return True
    time.sleep(0.02)  # the closed socket stays readable: do not spin on it
    return False


def _signal_all(child: subprocess.Popen[bytes], number: int) -> None:
    """Signal the command's process group; from SIGTERM on also descendants that have left it."""
    with suppress(ProcessLookupError):
        os.killpg(child.pid, number)
    if number != signal.SIGINT:
        for pid in _descendants(child):
            with suppress(ProcessLookupError):
                os.kill(pid, number)


def _descendants(child: subprocess.Popen[bytes]) -> list[int]:
    """Return the living descendants of the guard, after reaping the dead ones."""
    child.poll()
    while True:
        try:
            pid, _ = os.waitpid(-1, os.WNOHANG) if child.returncode is not None else (0, 0)
        except ChildProcessError:
            break
        if pid == 0:
            break
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError):
                state, parent = (entry / "stat").read_text().rsplit(")", 1)[1].split()[:2]
                if state != "Z":
                    parents[int(entry.name)] = int(parent)
    family = {os.getpid()}
    while more := {pid for pid, parent in parents.items() if parent in family} - family:
        family |= more
    return sorted(family - {os.getpid()})


def _report(link: socket.socket, line: str) -> None:
    with suppress(OSError):
        link.sendall(line.encode() + b"\n")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
