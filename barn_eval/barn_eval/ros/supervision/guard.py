"""Run one command and see to it that nothing of it is left, whatever happens to the process that asked for it.

Started as a script of its own, with nothing but the standard library, as `python guard.py FD KIND -- COMMAND...`. FD is
a socket to the supervisor, which is told there how the command has ended, as an event of `process`. KIND is "suite" for
a process of the suite, "planner" for one under test, which the kernel is to end first when memory runs out, and
"apart:FOLDER" for one that besides gets a user, PID and mount namespace of its own, in which it can neither see nor
signal any process but its own, nor write into the folder of results. `python guard.py probe` prints whether the kernel
allows that. When the supervisor writes, or its end of the socket closes because it died, the command and all its
descendants are ended: by SIGINT first, as Ctrl-C does it, then SIGTERM, then SIGKILL.
What the command prints goes to the guard's own output, of a great deal the beginning and the end.

The guard is two processes, of which the second does the work: if either is killed, at the same time as the supervisor
too, the other ends what is left. A guard that was told to end by somebody else kills what it guards, which so is not
seen to go first, reports nothing and is lost.
"""

import ctypes
import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

_PR_SET_PDEATHSIG = 1
_PR_SET_CHILD_SUBREAPER = 36
_NO_MOUNTS = 24, 21  # PR_CAPBSET_DROP, CAP_SYS_ADMIN
# How long each signal is given. Python nodes need some 100 ms for SIGINT, ros2 launch several seconds.
PATIENCE_S = ((signal.SIGINT, 5.0), (signal.SIGTERM, 3.0), (signal.SIGKILL, 5.0))
_ENDING = (
    signal.SIGTERM,
    signal.SIGINT,
    signal.SIGHUP,
    signal.SIGQUIT,
)  # of the guard itself
_ORPHANS_PATIENCE_S = 0.5  # for what is left when the command itself has ended
HEAD_BYTES = TAIL_BYTES = 5_000_000  # of what one start of a command prints
SUITE, PLANNER, APART = "suite", "planner", "apart"
_FIRST_TO_GO = "500"  # added to what the kernel's choice goes by when memory runs out, of at most 1000
_NEW_MOUNTS, _NEW_USERS, _NEW_PIDS = (
    0x00020000,
    0x10000000,
    0x20000000,
)  # flags of unshare
_PRIVATE_MOUNTS = 0x4000 | 0x40000  # recursively
_BIND, _READ_ONLY_AGAIN, _KEPT_FLAGS = (
    0x1000,
    0x1000 | 0x20 | 1,
    2 | 4 | 8,
)  # of mount; the last are locked
_LIBC = ctypes.CDLL(None, use_errno=True)


def main(arguments: list[str]) -> int:
    """Run the command given behind "--" and return 0 once nothing of it is left."""
    if arguments == ["probe"]:
        return _probe()
    _LIBC.prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)  # for orphans of the second
    first = os.getpid()
    second = os.fork()
    if second:
        return _stand_by(second)
    wake = _wake_on_signals()
    _end_with(first, signal.SIGTERM)
    _LIBC.prctl(
        _PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0
    )  # orphans of the command become children of the guard
    return _guard(
        arguments[3:], arguments[1], socket.socket(fileno=int(arguments[0])), wake
    )


def _probe() -> int:
    """Print in a line what keeps a planner apart here, and return 0 if it cannot signal the suite's processes."""
    reader, writer = os.pipe()
    try:
        _leave_namespaces()
        if not (child := os.fork()):
            os.write(writer, b"apart" if _mount_own("") else b"visible")
            os._exit(0)
        os.waitpid(child, 0)
    except OSError as error:
        print(f"{error.strerror}")
        return 1
    print(os.read(reader, 16).decode())
    return 0


def _checked(result: int, what: str) -> None:
    if result != 0:
        raise OSError(ctypes.get_errno(), f"{what}: {os.strerror(ctypes.get_errno())}")


def _leave_namespaces() -> None:
    """Put this process into a user namespace of its own, and its children to come into a PID namespace; OSError."""
    user, group = os.getuid(), os.getgid()
    _checked(
        _LIBC.unshare(_NEW_USERS | _NEW_PIDS), "no namespaces for users and processes"
    )
    for name, content in (
        ("setgroups", "deny"),
        ("uid_map", f"{user} {user} 1"),
        ("gid_map", f"{group} {group} 1"),
    ):
        Path(f"/proc/self/{name}").write_text(content, "ascii")


def _mount_own(results: str) -> bool:
    """Show in /proc only the processes of this namespace, and a folder as one that nothing can be written into.

    Return whether the first is allowed: in many containers it is not.
    """
    if _LIBC.unshare(_NEW_MOUNTS) or _LIBC.mount(
        None, b"/", None, _PRIVATE_MOUNTS, None
    ):
        return False
    if results and not _LIBC.mount(
        (folder := os.fsencode(results)), folder, None, _BIND, None
    ):
        flags = _READ_ONLY_AGAIN | (os.statvfs(results).f_flag & _KEPT_FLAGS)
        _checked(
            _LIBC.mount(None, folder, None, flags, None),
            f"{results} cannot be made read-only",
        )
        with suppress(OSError):
            os.chdir(Path.cwd())  # by the new mount, should it be in there
    return bool(_LIBC.mount(b"proc", b"/proc", b"proc", 0, None) == 0)


class _ApartProcess:
    """A command in a PID namespace of its own, as `subprocess.Popen` has one; it ends with all that it has started.

    pid: of the namespace's first process, which leads the command's session, tells by a pipe how it has ended, and with
    which the kernel ends all others. OSError if the command cannot be started.
    """

    def __init__(
        self, command: list[str], output: int, before: Callable[[], None], results: str
    ) -> None:
        self.returncode: int | None = None
        _leave_namespaces()
        self._end, told = os.pipe()
        if not (pid := os.fork()):
            _be_first(command, output, before, told, results)
        self.pid = pid
        os.close(told)
        if os.read(self._end, 1) != b"+":
            reason = os.read(self._end, 4096).decode()
            self.wait()
            raise OSError(0, reason or "ended at its start")

    def poll(self) -> int | None:
        return self.wait(os.WNOHANG)

    def wait(self, options: int = 0) -> int | None:
        """Wait for the end and return it; without a word of the first process, that was killed."""
        if self.returncode is None and os.waitpid(self.pid, options)[0]:
            text = os.read(self._end, 4096)
            self.returncode = (
                int(text) if text.lstrip(b"-").isdigit() else -signal.SIGKILL
            )
        return self.returncode


def _started(
    command: list[str],
    output: int,
    before: Callable[[], None],
    *,
    start_new_session: bool = False,
) -> subprocess.Popen[bytes]:
    """Start a command, which inherits what the supervisor hands down; there are no threads here."""
    how: dict[str, Any] = {
        "preexec_fn": before,
        "start_new_session": start_new_session,
        "close_fds": False,
    }
    return subprocess.Popen(command, stdout=output, stderr=output, **how)  # noqa: S603


def _be_first(
    command: list[str], output: int, before: Callable[[], None], told: int, results: str
) -> None:
    """Be the first process of a namespace: start the command, take in orphans, and end with the command."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    os.setsid()
    for number in _ENDING:
        signal.signal(number, signal.SIG_IGN)
    signal.set_wakeup_fd(-1)
    try:
        _mount_own(results)
        child = _started(command, output, before)
    except OSError as error:
        os.write(told, f"-{error.strerror or error}".encode())
        os._exit(1)
    os.closerange(0, told)
    os.closerange(told + 1, os.sysconf("SC_OPEN_MAX"))
    os.write(told, b"+")
    while (ended := os.wait())[0] != child.pid:
        pass
    os.write(told, str(os.waitstatus_to_exitcode(ended[1])).encode())
    os._exit(0)


def _stand_by(second: int) -> int:
    """Wait for the second process; if it is killed, end what it has left."""
    os.closerange(
        3, os.sysconf("SC_OPEN_MAX")
    )  # the link is the other's, and so is what is handed down
    for number in _ENDING:
        signal.signal(number, signal.SIG_IGN)
    os.waitpid(second, 0)
    while left := _family():
        _signal_all(left, signal.SIGKILL)
        time.sleep(0.01)
    return 0


def _end_with(parent: int, number: int) -> None:
    """Have this process signalled when its parent dies, or end now if that has happened."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, number, 0, 0, 0)
    if os.getppid() != parent:
        os._exit(1)


def _guard(
    command: list[str], kind: str, supervisor: socket.socket, wake: socket.socket
) -> int:
    supervisor.setblocking(False)
    output = _Output()
    kind, _, results = kind.partition(":")
    apart = partial(_ApartProcess, results=results)
    started = apart if kind == APART else partial(_started, start_new_session=True)
    try:
        child: _Child = started(
            command, output.writer, _prepare(supervisor.fileno(), kind)
        )
    except OSError as error:
        _report(
            supervisor, f"cannot be started: {command[0]}: {error.strerror or error}"
        )
        return 0
    finally:
        os.close(output.writer)
    ordered = _wait(child, supervisor, wake, output)
    _end(child, supervisor, output, hurried=not ordered)
    output.finish()
    if ordered:
        _report(supervisor, _described(child.wait() or 0))
    return 0


_Child = subprocess.Popen[bytes] | _ApartProcess


def _wake_on_signals() -> socket.socket:
    """Make a dead child, or a signal to end the guard itself, readable on the socket returned."""
    reader, writer = socket.socketpair(type=socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
    signal.set_wakeup_fd(writer.detach(), warn_on_full_buffer=False)
    for number in (signal.SIGCHLD, *_ENDING):
        signal.signal(number, lambda *_: None)
    return reader


def _prepare(supervisor: int, kind: str) -> Callable[[], None]:
    guard = os.getpid()

    def prepare() -> None:
        os.close(supervisor)
        # the command dies with the guard, or with the first process of its namespace
        _end_with(1 if kind == APART else guard, signal.SIGKILL)
        if kind != SUITE:
            with suppress(OSError):
                Path("/proc/self/oom_score_adj").write_text(_FIRST_TO_GO, "ascii")
        if kind == APART:
            _LIBC.prctl(*_NO_MOUNTS, 0, 0)  # which a user root could undo
        for number in (signal.SIGCHLD, *_ENDING):
            signal.signal(number, signal.SIG_DFL)

    return prepare


class _Output:
    """What a command prints, by a pipe: the first bytes are passed on at once, the last of the others at the end."""

    def __init__(self) -> None:
        reader, self.writer = os.pipe()
        os.set_blocking(reader, False)
        self.readers: list[Any] = [reader]  # none once all has been read
        self._tail = bytearray()
        self._room, self._dropped = HEAD_BYTES, 0

    def read(self, most: int = 2 * TAIL_BYTES) -> None:
        """Take in some of what has been printed, and keep of what is for the end at most that much."""
        for reader in self.readers:
            with suppress(BlockingIOError):
                data = os.read(reader, 1 << 16)
                if not data:
                    os.close(reader)
                    self.readers = []
                _print(data[: self._room])
                self._tail += data[self._room :]
                self._room = max(0, self._room - len(data))
        if len(self._tail) > most:
            self._dropped += len(self._tail) - TAIL_BYTES
            del self._tail[:-TAIL_BYTES]

    def finish(self) -> None:
        """Pass on the rest, the command and its descendants having ended."""
        while select.select(self.readers, [], [], 0.0)[0]:
            self.read()
        self.read(TAIL_BYTES)
        if self._dropped:
            _print(f"\n[{self._dropped} bytes are left out here]\n".encode())
        _print(bytes(self._tail))


def _print(data: bytes) -> None:
    """Write to the guard's output; a full disk costs the output, not the command."""
    with suppress(OSError):
        while data:
            data = data[os.write(sys.stdout.fileno(), data) :]


def _wait(
    child: "_Child", supervisor: socket.socket, wake: socket.socket, output: _Output
) -> bool:
    """Return when the command has ended by itself, or is to be ended, and whether the supervisor knows why."""
    while child.poll() is None:
        ready, _, _ = select.select([supervisor, wake, *output.readers], [], [])
        if supervisor in ready:
            return True  # it has written, or has ended
        output.read()
        if wake in ready and set(wake.recv(64)) & set(_ENDING):
            return False
    return True


def _end(
    child: "_Child", supervisor: socket.socket, output: _Output, *, hurried: bool
) -> None:
    """End the command and its descendants; hurried, as after a second word of the supervisor, without patience."""
    _drain(supervisor)
    for number, patience_s in PATIENCE_S:
        if hurried and number != signal.SIGKILL:
            continue
        if not (left := _descendants(child)):
            return
        with suppress(ProcessLookupError):
            os.killpg(child.pid, number)
        if number != signal.SIGINT:
            _signal_all(
                left, number
            )  # those that have left the command's process group, too
        sent_s = time.monotonic()
        while _descendants(child) and not (hurried and number != signal.SIGKILL):
            waited_s = time.monotonic() - sent_s
            if waited_s > (
                patience_s if child.returncode is None else _ORPHANS_PATIENCE_S
            ):
                break
            ready, _, _ = select.select([supervisor, *output.readers], [], [], 0.02)
            output.read()
            hurried = supervisor in ready and _drain(supervisor)


def _drain(supervisor: socket.socket) -> bool:
    """Tell whether the supervisor has written something; if it is gone, nothing more will come."""
    with suppress(OSError):
        if supervisor.recv(4096):
            return True
    time.sleep(0.02)  # the closed socket stays readable: do not spin on it
    return False


def _signal_all(pids: list[int], number: int) -> None:
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, number)


def _descendants(child: "_Child") -> list[int]:
    """Return the living descendants of the guard, after reaping the dead ones."""
    child.poll()
    with suppress(ChildProcessError):
        while child.returncode is not None and os.waitpid(-1, os.WNOHANG)[0]:
            pass
    return _family()


def _family() -> list[int]:
    """Return the living descendants of this process."""
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError):
                state, parent = (
                    (entry / "stat").read_text().rsplit(")", 1)[1].split()[:2]
                )
                if state != "Z":
                    parents[int(entry.name)] = int(parent)
    family = {os.getpid()}
    while more := {pid for pid, parent in parents.items() if parent in family} - family:
        family |= more
    return sorted(family - {os.getpid()})


def _described(code: int) -> str:
    """Return how a process ended in words; a negative code is a signal."""
    if code >= 0:
        return f"exited with code {code}"
    names = {one.value: one.name for one in signal.Signals}
    return f"was killed by {names.get(-code, f'signal {-code}')}"


def _report(supervisor: socket.socket, how: str) -> None:
    with suppress(OSError):
        supervisor.sendall(json.dumps({"event": "ended", "how": how}).encode() + b"\n")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
