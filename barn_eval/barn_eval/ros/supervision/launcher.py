"""Run one command, and leave nothing of it whatever happens to the supervisor.

    python launcher.py FD KIND -- COMMAND...
    python launcher.py probe

This is a script of its own that needs nothing but the standard library. FD is a socket
to the supervisor, which gets an event (see `process`) with how the command has ended.
KIND says what the command is:

- "suite": a process of the suite.
- "planner": a planner under test; the kernel ends it first when memory runs out.
- "isolated:FOLDER": a planner in a user, PID and mount namespace of its own. It can
  neither see nor signal any process but its own, nor see the folder of results or move
  a folder above it.

`probe` prints whether the kernel allows the last.

When the supervisor writes, or its end of the socket closes because it died, the
launcher ends the command and all its descendants: by SIGINT first, as Ctrl-C does it,
then SIGTERM, then SIGKILL. What the command prints goes to the launcher's own output.
If it prints very much, only beginning and end are kept; of a planner, nothing after
such a signal is, since complaints about the signal would look like a fault.

The launcher is two processes, of which the second does the work. If either is killed,
even together with the supervisor, the other ends what is left. A launcher that
somebody else tells to end kills its command, so the command is not seen to end first,
and reports nothing: it counts as lost.
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
from pathlib import Path
from typing import Any

SUITE = "suite"
PLANNER = "planner"
ISOLATED = "isolated"
# How long each signal is given. Python nodes need some 100 ms for SIGINT, ros2 launch
# several seconds.
PATIENCE_S = ((signal.SIGINT, 5.0), (signal.SIGTERM, 3.0), (signal.SIGKILL, 5.0))
_ORPHANS_PATIENCE_S = 0.5  # for what is left when the command itself has ended
# Of what one start of a command prints, so much is passed on.
HEAD_BYTES = 5_000_000
TAIL_BYTES = 5_000_000
# Signals that end the launcher itself.
_ENDING_SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT)
# Added to the score, of at most 1000, by which the kernel chooses when memory runs out.
_OUT_OF_MEMORY_SCORE = "500"

# Constants of Linux: linux/prctl.h, linux/capability.h, linux/sched.h, linux/mount.h.
_PR_SET_PDEATHSIG = 1
_PR_CAPBSET_DROP = 24
_PR_SET_CHILD_SUBREAPER = 36
_CAP_SYS_ADMIN = 21
_CLONE_NEWNS = 0x00020000
_CLONE_NEWUSER = 0x10000000
_CLONE_NEWPID = 0x20000000
_MS_RDONLY = 0x1
_MS_REMOUNT = 0x20
_MS_BIND = 0x1000
_MS_REC = 0x4000
_MS_PRIVATE = 0x40000
# nosuid, nodev and noexec: an unprivileged remount must keep them.
_LOCKED_MOUNT_FLAGS = 2 | 4 | 8
# Below /proc, where the user root may write.
_KERNEL_FOLDERS = ("/proc/sys", "/proc/sysrq-trigger", "/proc/irq", "/proc/bus")
_LIBC = ctypes.CDLL(None, use_errno=True)


def main(arguments: list[str]) -> int:
    """Fork, run "FD KIND -- COMMAND...", return 0 whatever its end; or run "probe"."""
    if arguments == ["probe"]:
        return _probe()
    # Orphans of the second process become children of the first.
    _become_subreaper()
    first = os.getpid()
    second = os.fork()
    if second:
        return _stand_by(second)

    wake = _wake_on_signals()
    _end_with(first, signal.SIGTERM)
    _become_subreaper()
    descriptor, kind, _, *command = arguments
    _Launcher(socket.socket(fileno=int(descriptor)), wake).run(command, kind)
    return 0


def _probe() -> int:
    """Print "apart", "visible" or why a planner cannot be isolated; return 0 or 1.

    0 says that it cannot signal other processes.

    "apart" says that it sees only its own processes, "visible" that it sees all.
    """
    reader, writer = os.pipe()
    try:
        _enter_namespaces()
        child = os.fork()
        if not child:
            # Any folder shows whether one can be hidden.
            is_apart = False
            with suppress(OSError):
                is_apart = _mount_views(str(Path(__file__).parent), [])
            os.write(writer, b"apart" if is_apart else b"visible")
            os._exit(0)
        os.waitpid(child, 0)
    except OSError as error:
        print(f"{error.strerror}")
        return 1
    print(os.read(reader, 16).decode())
    return 0


def _require_success(result: int, problem: str) -> None:
    """Raise OSError from errno if `result`, returned by a libc call, is not 0."""
    if result != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"{problem}: {os.strerror(number)}")


def _enter_namespaces() -> None:
    """Move this process into a new user namespace, and its children into a PID one.

    Raises:
        OSError: If the kernel does not allow it.
    """
    user = os.getuid()
    group = os.getgid()
    _require_success(
        _LIBC.unshare(_CLONE_NEWUSER | _CLONE_NEWPID),
        "no namespaces for users and processes",
    )
    # Groups must be denied before an unprivileged process may map its own.
    Path("/proc/self/setgroups").write_text("deny", "ascii")
    Path("/proc/self/uid_map").write_text(f"{user} {user} 1", "ascii")
    Path("/proc/self/gid_map").write_text(f"{group} {group} 1", "ascii")


def _mount_views(results: str, command: list[str]) -> bool:
    """Hide results and disks, mount a read-only /proc; False if that is not allowed.

    Args:
        results: The folder, empty for none.
        command: Words of the command. Files of the folder that they name stay.

    Returns:
        Whether a /proc of its own is allowed: in many containers it is not.
    """
    if _LIBC.unshare(_CLONE_NEWNS):
        return False
    # Without this, the mounts below could show outside the namespace as well.
    if _LIBC.mount(None, b"/", None, _MS_REC | _MS_PRIVATE, None):
        return False

    if results:
        _hide(Path(results).absolute(), command)
    if _LIBC.mount(b"proc", b"/proc", b"proc", 0, None):
        return False
    # The user root could otherwise change settings of the kernel, or freeze the suite.
    mounts = Path("/proc/self/mountinfo").read_text().splitlines()
    names = [line.split()[4] for line in mounts]
    for name in (*_KERNEL_FOLDERS, *names):
        if name.startswith(("/proc/", "/sys")) and Path(name).exists():
            _bind(Path(name), _MS_RDONLY)
    # It could also read the results from the disk itself.
    for path in Path("/dev").rglob("*"):
        if path.is_block_device() and not path.is_symlink():
            _bind(path, source=Path("/dev/null"))
    return True


def _bind(path: Path, flags: int = 0, source: Path | None = None) -> None:
    """Bind-mount `source`, by default the path itself, onto a path; or OSError.

    Args:
        path: The path. Nobody can move or replace it while it is a mount.
        flags: Flags that the mount gets, such as that of read-only.
        source: What takes its place, by default itself.
    """
    name = os.fsencode(path)
    origin = os.fsencode(source or path)
    problem = f"{path} cannot be mounted"
    _require_success(_LIBC.mount(origin, name, None, _MS_BIND | _MS_REC, None), problem)
    if flags:
        # A bind mount gets flags only when it is mounted again.
        flags |= os.statvfs(path).f_flag & _LOCKED_MOUNT_FLAGS
        remount = _MS_BIND | _MS_REMOUNT | flags
        _require_success(_LIBC.mount(None, name, None, remount, None), problem)


def _hide(folder: Path, command: list[str]) -> None:
    """Put a read-only mount over a folder, with its ROS prefix and what a command names.

    Bags would tell the true pose while the robot drives. The folders above become
    mounts, too: a folder that another replaces would give the planner a second try.

    Args:
        folder: The folder, absolute.
        command: Words of a command, such as one of a file of parameters below.
    """
    contents = {}
    for word in command:
        path = Path(word.rpartition(":=")[2]).absolute()
        if folder in path.parents and path.is_file():
            contents[path] = path.read_bytes()
    # This handle leads to the prefix of a package in source although it is hidden.
    prefix = Path(os.environ.get("AMENT_PREFIX_PATH", "").partition(":")[0])
    handle = os.open(prefix, os.O_PATH) if folder in prefix.parents else None

    for parent in reversed(folder.resolve().parents[:-1]):
        _bind(parent)
    name = os.fsencode(folder)
    problem = f"{folder} cannot be hidden"
    _require_success(_LIBC.mount(b"none", name, b"tmpfs", 0, None), problem)
    for path, content in contents.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    if handle is not None:
        prefix.mkdir(parents=True)
        _bind(prefix, _MS_RDONLY, Path("/proc/self/fd", str(handle)))
        os.close(handle)
    flags = _MS_REMOUNT | _MS_RDONLY
    _require_success(_LIBC.mount(None, name, None, flags, None), problem)

    # A working directory from before the mounts would lead around them.
    try:
        os.chdir(Path.cwd())
    except OSError:
        os.chdir("/")


class _IsolatedProcess:
    """A command in a PID namespace, with the interface of `subprocess.Popen`.

    The namespace's first process leads the command's session and writes into a pipe how
    the command ended. When it ends, the kernel ends all others of the namespace.
    """

    def __init__(
        self, command: list[str], output: int, prepare: Callable[[], None], results: str
    ):
        """Start the command in namespaces of its own; OSError if that fails."""
        self.returncode: int | None = None
        _enter_namespaces()
        self._reader, writer = os.pipe()
        self.pid = os.fork()
        if not self.pid:
            _lead_namespace(command, output, prepare, writer, results)
        os.close(writer)
        if os.read(self._reader, 1) != b"+":
            reason = os.read(self._reader, 4096).decode()
            self.wait()
            raise OSError(0, reason or "ended at its start")

    def poll(self) -> int | None:
        """Return the exit code without waiting, None while the command runs."""
        return self.wait(os.WNOHANG)

    def wait(self, options: int = 0) -> int | None:
        """Return the exit code, -N for signal N; with WNOHANG, None while it runs."""
        if self.returncode is None and os.waitpid(self.pid, options)[0]:
            text = os.read(self._reader, 4096)
            # A first process that was killed has written nothing.
            is_code = text.lstrip(b"-").isdigit()
            self.returncode = int(text) if is_code else -signal.SIGKILL
        return self.returncode


_Child = subprocess.Popen[bytes] | _IsolatedProcess


def _start_command(
    command: list[str],
    output: int,
    prepare: Callable[[], None],
    *,
    new_session: bool = False,
) -> subprocess.Popen[bytes]:
    """Start a command that prints to descriptor `output` and inherits all sockets.

    `prepare` runs in the child before the command.
    """
    # There are no threads here, so code may run before the command.
    options: dict[str, Any] = {"preexec_fn": prepare, "close_fds": False}
    return subprocess.Popen(  # noqa: S603
        command, stdout=output, stderr=output, start_new_session=new_session, **options
    )


def _lead_namespace(
    command: list[str],
    output: int,
    prepare: Callable[[], None],
    writer: int,
    results: str,
) -> None:
    """Run a command as PID 1 of a namespace, tell pipe `writer` its exit code, exit.

    It also reaps orphans, and never returns.
    """
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    os.setsid()
    for number in _ENDING_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    # The socket is the launcher's, which a signal to this process must not wake.
    signal.set_wakeup_fd(-1)
    try:
        _mount_views(results, command)
        child = _start_command(command, output, prepare)
    except OSError as error:
        os.write(writer, f"-{error.strerror or error}".encode())
        os._exit(1)

    # Sockets that were handed down must close with the command.
    os.closerange(0, writer)
    os.closerange(writer + 1, os.sysconf("SC_OPEN_MAX"))
    os.write(writer, b"+")
    pid, status = os.wait()
    while pid != child.pid:
        pid, status = os.wait()
    os.write(writer, str(os.waitstatus_to_exitcode(status)).encode())
    os._exit(0)


def _become_subreaper() -> None:
    """Have orphaned descendants become children of this process."""
    _LIBC.prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def _stand_by(second: int) -> int:
    """Ignore signals, wait for PID `second`, kill all descendants left; return 0."""
    # The sockets are the second's: none may stay open because of this process.
    os.closerange(3, os.sysconf("SC_OPEN_MAX"))
    for number in _ENDING_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    os.waitpid(second, 0)
    while pids := _living_descendants():
        signal_all(pids, signal.SIGKILL)
        time.sleep(0.01)
    return 0


def _end_with(parent: int, number: int) -> None:
    """Have the kernel send signal `number` when PID `parent` dies; exit if it has."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, number, 0, 0, 0)
    if os.getppid() != parent:
        os._exit(1)


def _wake_on_signals() -> socket.socket:
    """Catch SIGCHLD and ending signals; return a socket that gets their numbers."""
    reader, writer = socket.socketpair(type=socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
    signal.set_wakeup_fd(writer.detach(), warn_on_full_buffer=False)
    for number in (signal.SIGCHLD, *_ENDING_SIGNALS):
        signal.signal(number, lambda *_: None)
    return reader


class _Launcher:
    """Starts the command, passes on its output, ends it with its descendants."""

    def __init__(self, supervisor: socket.socket, wake: socket.socket):
        """Take the socket to the supervisor and the one that signals wake."""
        supervisor.setblocking(False)
        self._supervisor = supervisor
        self._wake = wake
        self._output = _Output()

    def run(self, command: list[str], kind: str) -> None:
        """Run a command to its end or an order, end descendants, report its end.

        After a signal to this process, nothing is reported.
        """
        try:
            child = self._start(command, kind)
        except OSError as error:
            reason = error.strerror or error
            self._report(f"cannot be started: {command[0]}: {reason}")
            return
        finally:
            os.close(self._output.writer)
        is_orderly = self._wait(child)
        if kind != SUITE and child.poll() is None:
            self._output.mute()
        self._end(child, hurried=not is_orderly)
        self._output.finish()
        if is_orderly:
            self._report(_describe_exit(child.wait() or 0))

    def _start(self, command: list[str], kind: str) -> _Child:
        """Start the command; kind "isolated:FOLDER" gives it its own namespaces."""
        kind, _, results = kind.partition(":")
        # The parent of the command: this process, or its namespace's first process.
        parent = 1 if kind == ISOLATED else os.getpid()

        def prepare() -> None:
            """Set up the child before it becomes the command: it dies with us."""
            self._supervisor.close()
            _end_with(parent, signal.SIGKILL)
            if kind != SUITE:
                with suppress(OSError):
                    Path("/proc/self/oom_score_adj").write_text(
                        _OUT_OF_MEMORY_SCORE, "ascii"
                    )
            if kind == ISOLATED:
                # The user root could otherwise undo the mounts.
                _LIBC.prctl(_PR_CAPBSET_DROP, _CAP_SYS_ADMIN, 0, 0, 0)
            for number in (signal.SIGCHLD, *_ENDING_SIGNALS):
                signal.signal(number, signal.SIG_DFL)

        writer = self._output.writer
        if kind == ISOLATED:
            return _IsolatedProcess(command, writer, prepare, results)
        return _start_command(command, writer, prepare, new_session=True)

    def _wait(self, child: _Child) -> bool:
        """Pass on output until the command or an order ends it; False after a signal.

        Returns:
            Whether the supervisor knows why: False if a signal ends this process.
        """
        while child.poll() is None:
            ready, _, _ = select.select(
                [self._supervisor, self._wake, *self._output.readers], [], []
            )
            # The supervisor has written, or it has ended.
            if self._supervisor in ready:
                return True
            self._output.read()
            if self._wake in ready:
                numbers = set(self._wake.recv(64))
                if numbers.intersection(_ENDING_SIGNALS):
                    return False
        return True

    def _end(self, child: _Child, *, hurried: bool) -> None:
        """Send SIGINT, SIGTERM, SIGKILL until no descendant lives; or only KILL.

        Args:
            child: The command, which may have ended.
            hurried: Kill at once, as after a second message of the supervisor.
        """
        self._drain()
        for number, patience_s in PATIENCE_S:
            if hurried and number != signal.SIGKILL:
                continue
            descendants = _reap_and_list(child)
            if not descendants:
                return
            with suppress(ProcessLookupError):
                os.killpg(child.pid, number)
            if number != signal.SIGINT:
                # Those that have left the command's process group, too.
                signal_all(descendants, number)

            signal_s = time.monotonic()
            while _reap_and_list(child) and (not hurried or number == signal.SIGKILL):
                limit_s = _ORPHANS_PATIENCE_S
                if child.returncode is None:
                    limit_s = patience_s
                if time.monotonic() - signal_s > limit_s:
                    break
                ready, _, _ = select.select(
                    [self._supervisor, *self._output.readers], [], [], 0.02
                )
                self._output.read()
                hurried = self._supervisor in ready and self._drain()

    def _drain(self) -> bool:
        """Take what the supervisor wrote; return False after 20 ms if nothing."""
        with suppress(OSError):
            if self._supervisor.recv(4096):
                return True
        # A closed socket stays readable: do not spin on it.
        time.sleep(0.02)
        return False

    def _report(self, end: str) -> None:
        """Send the supervisor the event "ended" with a text; ignore a dead one."""
        event = {"event": "ended", "how": end}
        with suppress(OSError):
            self._supervisor.sendall(json.dumps(event).encode() + b"\n")


class _Output:
    """What a command prints: the head is passed on at once, the tail at the end."""

    def __init__(self) -> None:
        """Open the pipe that the command prints to."""
        reader, self.writer = os.pipe()
        os.set_blocking(reader, False)
        # To be waited for; empty once everything has been read.
        self.readers: list[Any] = [reader]
        self._tail = bytearray()
        self._head_room = HEAD_BYTES
        self._dropped = 0
        self._is_muted = False

    def mute(self) -> None:
        """Print what has been written so far, and drop what follows."""
        self._read_all()
        self._is_muted = True

    def read(self, max_tail: int = 2 * TAIL_BYTES) -> None:
        """Print the first 5 MB of the output, and keep the end of what follows.

        Takes at most 64 KiB, without waiting. A tail of more than `max_tail` bytes is
        cut to 5 MB.
        """
        for reader in self.readers:
            with suppress(BlockingIOError):
                data = os.read(reader, 1 << 16)
                if not data:
                    os.close(reader)
                    self.readers = []
                if self._is_muted:
                    continue
                _print(data[: self._head_room])
                self._tail += data[self._head_room :]
                self._head_room = max(0, self._head_room - len(data))
        if len(self._tail) > max_tail:
            self._dropped += len(self._tail) - TAIL_BYTES
            del self._tail[:-TAIL_BYTES]

    def finish(self) -> None:
        """Read the rest of the output; print how much is left out, and the tail."""
        self._read_all()
        self.read(TAIL_BYTES)
        if self._dropped:
            _print(f"\n[{self._dropped} bytes are left out here]\n".encode())
        _print(bytes(self._tail))

    def _read_all(self) -> None:
        """Read what has been written so far, without waiting."""
        while select.select(self.readers, [], [], 0.0)[0]:
            self.read()


def _print(data: bytes) -> None:
    """Write bytes to stdout, all of them; if that fails, drop the rest and go on."""
    with suppress(OSError):
        while data:
            data = data[os.write(sys.stdout.fileno(), data) :]


def signal_all(pids: list[int], number: int) -> None:
    """Send signal `number` to each PID; those that have ended are skipped.

    Args:
        pids: Processes.
        number: The signal.
    """
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, number)


def _reap_and_list(child: _Child) -> list[int]:
    """Reap the command, then all dead children; return PIDs of living descendants."""
    child.poll()
    with suppress(ChildProcessError):
        while child.returncode is not None and os.waitpid(-1, os.WNOHANG)[0]:
            pass
    return _living_descendants()


def _living_descendants() -> list[int]:
    """Return the sorted PIDs of this process's descendants, without zombies."""
    parents = {}
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            # The name of the command, in parentheses, may hold anything.
            fields = (entry / "stat").read_text().rsplit(")", 1)[1].split()
            state, parent = fields[:2]
            if state != "Z":
                parents[int(entry.name)] = int(parent)

    this_pid = os.getpid()
    family = {this_pid}
    size = 0
    # Children may be listed before their parents, so look until nobody is added.
    while len(family) > size:
        size = len(family)
        family.update(pid for pid, parent in parents.items() if parent in family)
    return sorted(family - {this_pid})


def _describe_exit(code: int) -> str:
    """Return "exited with code N", or "was killed by SIGNAL" for a negative code."""
    if code >= 0:
        return f"exited with code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    return f"was killed by {name}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
