"""Reading files of bounded size, and writing atomically: the one place where the suite opens and replaces files."""

import errno
import gzip
import io
import os
import shutil
import stat
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from barn_worlds.base.errors import StoreError, WorldError, convert_os_errors

LARGEST_FILE_BYTES = 256 * 1024 * 1024
ZIP_ERRORS = (
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    NotImplementedError,
    RuntimeError,
    ValueError,
    OSError,
)
PARTIAL_SUFFIX = (
    ".partial"  # ending of files that are being written; of a killed process they stay
)


def read_bytes(path: Path, largest: int = LARGEST_FILE_BYTES) -> bytes:
    """Return the content of a file of at most `largest` bytes; WorldError names the path otherwise."""
    with convert_os_errors(WorldError, f"{path}: cannot be read"):
        return read_at_most(path, largest)


def read_at_most(path: Path, largest: int) -> bytes:
    """Return the content of a regular file; OSError if it holds more than `largest` bytes, whatever its size says."""
    with open_regular(path) as file:
        content = file.read(largest + 1)
    if len(content) > largest:
        raise OSError(errno.EFBIG, f"more than the allowed {largest} bytes", str(path))
    return content


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading; OSError for anything else, such as a pipe, which would block, or a device."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except ValueError as error:  # a NUL in the name
        raise OSError(errno.EINVAL, str(error), str(path)) from None
    mode = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(mode):
        os.close(descriptor)
        raise OSError(
            errno.EINVAL,
            "is a folder" if stat.S_ISDIR(mode) else "not a regular file",
            str(path),
        )
    return os.fdopen(descriptor, "rb")


def read_maybe_gzipped(path: Path, largest: int = LARGEST_FILE_BYTES) -> bytes:
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


def pack_zip(members: Mapping[str, bytes]) -> bytes:
    """Return a zip file of members by name; equal members give equal bytes, at any time."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name, data in members.items():
            archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED, 9)
    return content.getvalue()


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file atomically; WorldError if that fails."""
    with convert_os_errors(WorldError, f"{path}: cannot be written"):
        path.parent.mkdir(parents=True, exist_ok=True)
        with replace_file(path) as temporary:
            temporary.write_bytes(content)


def write_durably(path: Path, content: bytes) -> None:
    """Write a file onto the disk, so that it is there as a whole or as it was before; StoreError if that fails."""
    with (
        convert_os_errors(StoreError, f"{path}: cannot be written"),
        replace_file(path, durable=True) as temporary,
    ):
        temporary.write_bytes(content)


@contextmanager
def replace_file(path: Path, *, durable: bool = False) -> Iterator[Path]:
    """Provide an empty file, private to the user, that takes the place of `path` if the block succeeds.

    However the block ends, nothing else is left; only a kill leaves a hidden file that ends in `PARTIAL`. durable:
    whether the content is to be on the disk at the end. OSError if that fails.
    """
    handle, name = tempfile.mkstemp(
        prefix=f".{path.name}.", suffix=PARTIAL_SUFFIX, dir=path.parent
    )
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o666 & ~_umask())
        if durable:
            _sync(temporary)
        temporary.replace(path)
        if durable:
            _sync(path.parent)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def remove_partial_files(folder: Path) -> None:
    """Remove what killed writers have left in a folder, of which the caller must be the only writer."""
    for left in folder.glob(f".*{PARTIAL_SUFFIX}"):
        left.unlink(missing_ok=True)


@contextmanager
def create_folder(path: Path) -> Iterator[Path]:
    """Provide a temporary folder that becomes `path` if the block succeeds and is removed if it fails.

    Raises WorldError if `path` exists and is not an empty folder, or if it cannot be written.
    """
    with convert_os_errors(WorldError, f"{path}: cannot be written"):
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise WorldError(
                f"{path}: exists already; name a new folder or an empty one"
            )
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
        try:
            yield temporary
            temporary.chmod(0o777 & ~_umask())
            temporary.replace(path)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def _umask() -> int:
    """Return the process's umask, which can only be read by setting it; files made meanwhile are private."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def _sync(path: Path) -> None:
    """See a file, or the names in a folder, onto the disk."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
