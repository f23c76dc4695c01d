"""What a planner that is kept apart may try: room.py DEED OUT PID.

It prints SUCCESS if it reaches the folder OUT, the process PID or the kernel, and else
what kept it from that.
"""

import ctypes
import os
import signal
import stat
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

DEED = sys.argv[1]
OUT = Path(sys.argv[2])
PID = int(sys.argv[3])
LIBC = ctypes.CDLL(None, use_errno=True)
NEW_NAMESPACES = 0x10000000 | 0x00020000  # of users and mounts
BIND = 0x1000
ATTACH = 16


def is_seen(out: Path = OUT) -> bool:
    """Return whether the secret of the folder can be read."""
    return (out / "bags" / "secret").exists()


def call(result: int) -> None:
    """Raise OSError if a function of libc has failed."""
    if result:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def unmount() -> bool:
    """Take the mount over the folder away."""
    call(LIBC.umount2(bytes(OUT), 2))
    return is_seen()


def unshare() -> bool:
    """Do the same with all rights in namespaces of its own."""
    call(LIBC.unshare(NEW_NAMESPACES))
    return unmount()


def bind() -> bool:
    """Mount the root alone at another place, without the mounts on it."""
    call(LIBC.unshare(NEW_NAMESPACES))
    place = OUT.parent.parent / "place"
    place.mkdir()
    call(LIBC.mount(b"/", bytes(place), None, BIND, None))
    return is_seen(place / OUT.relative_to("/"))


def move() -> bool:
    """Move the folder, or one above, and put another into its place."""
    for folder in (OUT, *OUT.parents[:-1]):
        try:
            folder.rename(f"{folder}_moved")
        except OSError as error:
            print(error)
        else:
            return True
    return False


def ways_around() -> Iterator[Path]:
    """Yield paths that may lead to the root from before the mounts."""
    yield from (Path(f"/proc/{pid}/root") for pid in ("1", "self", PID))
    for link in Path("/proc/self/fd").iterdir():
        if link.is_dir():
            yield link


def root() -> bool:
    """Look for the folder by other roots and open folders."""
    print("no other way leads there")
    return any(is_seen(way / OUT.relative_to("/")) for way in ways_around())


def trace() -> bool:
    """Stop the supervisor, then attach to the process that started this one."""
    try:
        os.kill(PID, signal.SIGSTOP)
    except OSError as error:
        print(error)
    else:
        return True
    call(LIBC.ptrace(ATTACH, PID, None, None))
    return True


def kernel() -> bool:
    """Look for a file by which the kernel or the group of processes takes orders."""
    print("no file of the kernel can be written")
    for top in ("/proc/sys", "/sys"):
        for folder, _, names in os.walk(top):
            if any(os.access(f"{folder}/{name}", os.W_OK) for name in names):
                print(folder)
                return True
    return False


def disk() -> bool:
    """Open each block device, on which the results are."""
    print("there is no disk to be read")
    for path in Path("/dev").rglob("*"):
        if path.is_block_device() and os.access(path, os.R_OK):
            print(path)
            return True
    return False


def overlay() -> bool:
    """Lay an empty folder over the root, below which nothing may be hidden."""
    user = os.getuid()
    call(LIBC.unshare(NEW_NAMESPACES))
    Path("/proc/self/setgroups").write_text("deny")
    for name in ("uid_map", "gid_map"):
        Path("/proc/self", name).write_text(f"0 {user} 1")
    place = OUT.parent.parent
    for name in ("place", "upper", "work"):
        (place / name).mkdir()
    os.chdir(place)
    options = b"lowerdir=/,upperdir=upper,workdir=work,userxattr"
    call(LIBC.mount(b"overlay", b"place", b"overlay", 0, options))
    return is_seen(place / "place" / OUT.relative_to("/"))


def handle() -> bool:
    """Open a folder by the number of its file, which no mount hides."""
    handle = (ctypes.c_uint32 * 34)(128)
    mount = ctypes.c_int()
    above = os.open(OUT.parent.parent, os.O_RDONLY)
    call(LIBC.name_to_handle_at(above, b"above", handle, ctypes.byref(mount), 0))
    call(LIBC.open_by_handle_at(above, handle, os.O_RDONLY) < 0)
    return True


def memory() -> bool:
    """Look for processes whose memory could be read."""
    pids = {path.name for path in Path("/proc").glob("[0-9]*")}
    print(f"there are processes {', '.join(sorted(pids))} only")
    return len(pids) > 2  # its own and the first of its namespace


def descriptors() -> bool:
    """Look for sockets and folders that the suite has left open."""
    print("only pipes and files")
    for number in range(256):
        with suppress(OSError):
            mode = os.fstat(number).st_mode
            if stat.S_ISSOCK(mode) or stat.S_ISDIR(mode):
                return True
    return False


def listing() -> bool:
    """List the folder."""
    print(f"the folder has {list(OUT.iterdir())}")
    return is_seen()


DEEDS: dict[str, Callable[[], bool]] = {
    "list": listing,
    "move": move,
    "unmount": unmount,
    "unshare": unshare,
    "bind": bind,
    "root": root,
    "trace": trace,
    "kernel": kernel,
    "disk": disk,
    "overlay": overlay,
    "handle": handle,
    "memory": memory,
    "descriptors": descriptors,
}

try:
    if DEEDS[DEED]():
        print("SUCCESS")
except OSError as error:
    print(error)
