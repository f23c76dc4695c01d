"""Reading files of bounded size, and writing atomically."""

import errno
import gzip
import io
import os
import shutil
import stat
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from barn_worlds.errors import WorldError

LARGEST_FILE = 256 * 1024 * 1024


def read_bytes(path: Path, largest: int = LARGEST_FILE) -> bytes:
    """Return the content of a file of at most `largest` bytes; WorldError names the path otherwise."""
    try:
        if path.is_dir():
            raise WorldError(f"{path}: is a folder, must be a file")
        if path.stat().st_size > largest:
            raise WorldError(f"{path}: has {path.stat().st_size} bytes, at most {largest} are read")
        return read_at_most(path, largest)
    except OSError as error:
        raise WorldError(f"{path}: cannot be read: {error.strerror or error}") from None


def read_at_most(path: Path, largest: int) -> bytes:
    """Return the content of a regular file; OSError if it holds more than `largest` bytes, whatever its size says."""
    if not stat.S_ISREG(path.stat().st_mode) and not path.is_dir():  # a pipe would block
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    with path.open("rb") as file:
        content = file.read(largest + 1)
    if len(content) > largest:
        raise OSError(errno.EFBIG, f"more than the allowed {largest} bytes", str(path))
    return content


def read_maybe_gzipped(path: Path, largest: int = LARGEST_FILE) -> bytes:
    """Return the content of a file, unpacked if it is gzipped, of at most `largest` bytes (checked while unpacking)."""
    content = read_bytes(path, largest)
    if content[:2] != b"\x1f\x8b":
        return content
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(content)) as file:
            unpacked = file.read(largest + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise WorldError(f"{path}: damaged gzip file: {error}") from None
    if len(unpacked) > largest:
        raise WorldError(f"{path}: unpacks to more than the allowed {largest} bytes")
    return unpacked


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file atomically; WorldError if that fails."""
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        Path(temporary).chmod(0o666 & ~_umask())
        os.replace(temporary, path)  # noqa: PTH105, the atomic replacement by name
    except OSError as error:
        if temporary is not None:
            with suppress(OSError):
                Path(temporary).unlink()
        raise WorldError(f"{path}: cannot be written: {error.strerror or error}") from None


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Provide a temporary folder that becomes `path` if the block succeeds and is removed if it fails.

    Raises WorldError if `path` exists and is not an empty folder, or if it cannot be written.
    """
    try:
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise WorldError(f"{path}: exists already; name a new folder or an empty one")
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    except OSError as error:
        raise WorldError(f"{path}: cannot be written: {error.strerror or error}") from None
    try:
        yield temporary
        temporary.chmod(0o777 & ~_umask())
        os.replace(temporary, path)  # noqa: PTH105, the atomic replacement by name
    except OSError as error:
        raise WorldError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _umask() -> int:
    """Return the process's umask, which can only be read by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
