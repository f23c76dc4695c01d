"""Reading files of bounded size and replacing files atomically.

No other module of the suite opens files that others wrote, or replaces files.
"""

import errno
import gzip
import io
import os
import stat
import tempfile
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from barn_worlds.base.errors import StoreError, WorldError, convert_os_errors

LARGEST_FILE_BYTES = 256 * 1024 * 1024

# What zipfile raises for damaged or hostile files.
ZIP_ERRORS = (
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    NotImplementedError,
    RuntimeError,
    ValueError,
    OSError,
)

# Ending of files that are being written. A process that is killed leaves them behind.
PARTIAL_SUFFIX = ".partial"


def read_bytes(path: Path, largest: int = LARGEST_FILE_BYTES) -> bytes:
    """Return the bytes of a world, map or data set file; WorldError if too large.

    Args:
        path: A regular file.
        largest: Most bytes that it may hold.

    Raises:
        WorldError: If the file cannot be read or is larger.
    """
    with convert_os_errors(WorldError, f"{path}: cannot be read"):
        return read_at_most(path, largest)


def read_at_most(path: Path, largest: int) -> bytes:
    """Return the bytes of a regular file; OSError if it holds more than `largest`.

    Args:
        path: A regular file.
        largest: Most bytes that it may hold, whatever size its folder gives.

    Raises:
        OSError: If the file cannot be read or is larger.
    """
    with open_regular(path) as file:
        # One byte more shows that there is more, without reading it all.
        content = file.read(largest + 1)
    if len(content) > largest:
        raise OSError(errno.EFBIG, f"more than the allowed {largest} bytes", str(path))
    return content


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading bytes; OSError for a folder, pipe or device."""
    # Without O_NONBLOCK, opening a pipe waits for a writer.
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except ValueError as error:
        # The name contains a NUL.
        raise OSError(errno.EINVAL, str(error), str(path)) from None

    mode = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(mode):
        os.close(descriptor)
        problem = "is a folder" if stat.S_ISDIR(mode) else "not a regular file"
        raise OSError(errno.EINVAL, problem, str(path))
    return os.fdopen(descriptor, "rb")


def read_maybe_gzipped(path: Path, largest: int = LARGEST_FILE_BYTES) -> bytes:
    """Return the bytes of a file, unpacked if its content, not its name, is gzip.

    Args:
        path: A regular file.
        largest: Most bytes that the file may hold, and most that it may unpack to.

    Raises:
        WorldError: If the file cannot be read, is damaged or is larger.
    """
    content = read_bytes(path, largest)
    # The magic number of gzip. Names do not tell: downloads lose or keep their .gz.
    if content[:2] != b"\x1f\x8b":
        return content
    # Unpacking stops at the limit, so a small file cannot fill the memory.
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(content)) as file:
            unpacked = file.read(largest + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise WorldError(f"{path}: damaged gzip file: {error}") from None
    if len(unpacked) > largest:
        raise WorldError(f"{path}: unpacks to more than the allowed {largest} bytes")
    return unpacked


def pack_zip(members: Mapping[str, bytes]) -> bytes:
    """Return a zip file of members by name as bytes; equal members, equal bytes."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name, data in members.items():
            # A ZipInfo of its own has a fixed date instead of the present time.
            archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED, 9)
    return content.getvalue()


def write_bytes(path: Path, content: bytes) -> None:
    """Write a world, map or data set file atomically, with the folders above it.

    Args:
        path: File to write; missing folders above it are created.
        content: Bytes of the whole file.

    Raises:
        WorldError: If the file cannot be written.
    """
    with convert_os_errors(WorldError, f"{path}: cannot be written"):
        path.parent.mkdir(parents=True, exist_ok=True)
        with replace_file(path) as temporary:
            temporary.write_bytes(content)


def write_durably(path: Path, content: bytes) -> None:
    """Write a result file atomically and sync it to the disk, in an existing folder.

    Args:
        path: File to write, in a folder that exists.
        content: Bytes of the whole file. The old file stays until they are on the disk.

    Raises:
        StoreError: If the file cannot be written.
    """
    write_parts_durably(path, [content])


def write_parts_durably(path: Path, parts: Iterable[bytes]) -> None:
    """Write a result file as `write_durably`, part by part as they are made."""
    with (
        convert_os_errors(StoreError, f"{path}: cannot be written"),
        replace_file(path, durable=True) as temporary,
        temporary.open("wb") as file,
    ):
        file.writelines(parts)


@contextmanager
def replace_file(path: Path, *, durable: bool = False) -> Iterator[Path]:
    """Yield an empty temporary file that replaces `path` if the block succeeds.

    Only a kill leaves the temporary file behind: hidden, private to the user and with
    the ending `PARTIAL_SUFFIX`.

    Args:
        path: File to replace.
        durable: Whether the content must be on the disk at the end of the block.

    Yields:
        Path of the temporary file, in the same folder.

    Raises:
        OSError: If the file cannot be written.
    """
    # In the same folder: a rename is atomic within one file system only.
    handle, name = tempfile.mkstemp(
        prefix=f".{path.name}.", suffix=PARTIAL_SUFFIX, dir=path.parent
    )
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        # mkstemp makes files that only their owner can read.
        temporary.chmod(0o666 & ~_read_umask())
        if durable:
            _sync(temporary)
        temporary.replace(path)
        # The new name is on the disk only once its folder is.
        if durable:
            _sync(path.parent)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def remove_partial_files(folder: Path) -> None:
    """Delete hidden .partial files, left by killed writers, directly in a folder.

    Nobody else may be writing to the folder.
    """
    for file in folder.glob(f".*{PARTIAL_SUFFIX}"):
        file.unlink(missing_ok=True)


@contextmanager
def create_folder(path: Path) -> Iterator[Path]:
    """Yield a temporary folder that is renamed to `path` if the block succeeds.

    Args:
        path: Folder to create. An empty one may exist.

    Yields:
        Path of the temporary folder, which is removed if the block fails.

    Raises:
        WorldError: If the folder has content already or cannot be written.
    """
    with convert_os_errors(WorldError, f"{path}: cannot be written"):
        # A rename replaces an empty folder, but none with content.
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise WorldError(
                f"{path}: exists already; name a new folder or an empty one"
            )
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(
            prefix=f".{path.name}.", dir=path.parent, ignore_cleanup_errors=True
        ) as name:
            temporary = Path(name)
            yield temporary
            temporary.chmod(0o777 & ~_read_umask())
            # Nothing is left under the old name, which the cleanup does not mind.
            temporary.replace(path)


def _read_umask() -> int:
    """Return the umask of the process, which changes for a moment."""
    # It can only be read by setting it. Files of other threads are private meanwhile.
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def _sync(path: Path) -> None:
    """Flush a file's content, or the names in a folder, to the disk (fsync)."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
