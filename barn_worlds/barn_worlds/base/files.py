"""Files that anyone may have written: bytes, YAML, JSON and lines of JSON.

Only this module opens them and replaces files. It limits size, depth, number of values,
numbers and encoding. Every mistake in a text is a ConfigError of one line that names
the file.
"""

import errno
import gzip
import io
import json
import math
import os
import stat
import tempfile
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from importlib import resources
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

import yaml

from barn_worlds.base.errors import (
    ConfigError,
    StoreError,
    WorldError,
    convert_os_errors,
    format_error,
    format_value,
    refuse_duplicates,
)
from barn_worlds.base.yaml_scalars import CoreLoader, Dumper

LARGEST_FILE_BYTES = 256 * 1024 * 1024
LARGEST_JSON_BYTES = 64 * 1024 * 1024
LARGEST_YAML_BYTES = 256 * 1024
LONGEST_LINE_BYTES = 1 << 20
MOST_VALUES = 1_000_000
DEEPEST = 60
PlainData: TypeAlias = Any  # None, bool, int, float, str, lists and mappings of them
_LARGEST_INTEGER = 2**63 - 1

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
    """Return the bytes of a world file; WorldError if it is unreadable or too large.

    Args:
        path: A regular file.
        largest: Most bytes that it may hold.

    Raises:
        WorldError: If the file cannot be read or is larger.
    """
    with convert_os_errors(WorldError, f"{path}: cannot be read"):
        return read_at_most(path, largest)


def read_at_most(path: Path, largest: int) -> bytes:
    """Return a regular file's bytes; OSError for other kinds or above `largest` bytes.

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
    """Return a file's bytes, unpacked if its content is gzip; WorldError if damaged.

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
    """Return a zip file of members by name; equal members give equal bytes."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name, data in members.items():
            # A ZipInfo of its own has a fixed date instead of the present time.
            archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED, 9)
    return content.getvalue()


def write_bytes(path: Path, content: bytes) -> None:
    """Write a world file atomically, creating folders; WorldError if that fails.

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
    """Write a file atomically to an existing folder, sync it; StoreError if that fails.

    Args:
        path: File to write, in a folder that exists.
        content: Bytes of the whole file. The old file stays until they are on the disk.

    Raises:
        StoreError: If the file cannot be written.
    """
    write_parts_durably(path, [content])


def write_parts_durably(path: Path, parts: Iterable[bytes]) -> None:
    """Write a file atomically from its parts, sync it; StoreError if that fails."""
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
    """Delete hidden .partial files that killed writers left directly in a folder.

    Call it only while no other process writes to the folder.
    """
    for file in folder.glob(f".*{PARTIAL_SUFFIX}"):
        file.unlink(missing_ok=True)


@contextmanager
def create_folder(path: Path) -> Iterator[Path]:
    """Yield a folder that becomes `path` on success; WorldError if that has content.

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
    """Return the umask of the process; it is 0o077 for a moment."""
    # Only setting it returns it. Meanwhile, files of other threads are private.
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def _sync(path: Path) -> None:
    """Flush a file's content, or the file names in a folder, to the disk (fsync)."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def read_json(path: Path, largest: int = LARGEST_JSON_BYTES) -> PlainData:
    """Return the data in a JSON file; ConfigError if it cannot be read or is refused.

    Args:
        path: A regular file.
        largest: Most bytes that it may hold.

    Raises:
        ConfigError: If the file cannot be read or `parse_json` refuses it.
    """
    return parse_json(_read(path, largest), str(path))


def as_mapping(content: PlainData) -> dict[str, Any]:
    """Return `content` itself if it is a dict, else an empty dict."""
    return content if isinstance(content, dict) else {}


def parse_json(text: str | bytes, where: str) -> PlainData:
    """Return JSON's data; ConfigError if invalid, too large, NaN, or beyond 64 bits.

    Args:
        text: JSON as text or UTF-8 bytes.
        where: Path or name of the source, to begin an error message with.

    Raises:
        ConfigError: If the text is not JSON, has a key twice, numbers that are not
            finite, integers of more than 64 bits or texts that are not Unicode, or is
            too large.
    """
    try:
        content = text if isinstance(text, str) else text.decode("utf-8")
        # Every value but the first follows one of these characters.
        if sum(map(content.count, ",[{")) > MOST_VALUES:
            raise ValueError(f"more than {MOST_VALUES} values")
        data = json.loads(
            content, parse_constant=_refuse_constant, object_pairs_hook=_read_object
        )
        _check(data)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{where}: not JSON: {format_error(error)}") from None
    return data


def read_lines(path: Path, file: BinaryIO | None = None) -> Iterator[tuple[str, str]]:
    """Yield "PATH, line N", text of whole lines, none if missing; ConfigError if bad.

    A missing file has no lines. A last line without a newline, which a killed writer
    may leave, is skipped.

    Args:
        path: A regular file.
        file: The file if it is open already; it stays open.

    Raises:
        ConfigError: If the file cannot be read, is not UTF-8 or has too long a line.
    """
    number = 1
    try:
        with nullcontext(file) if file else open_regular(path) as lines:
            # One byte more than allowed shows that a line is too long.
            while line := lines.readline(LONGEST_LINE_BYTES + 1):
                if len(line) > LONGEST_LINE_BYTES:
                    raise ConfigError(
                        f"{path}, line {number}: more than the allowed "
                        f"{LONGEST_LINE_BYTES} bytes"
                    )
                if line.endswith(b"\n"):
                    yield f"{path}, line {number}", line[:-1].decode("utf-8")
                number += 1
    except FileNotFoundError:
        return
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}, line {number}: not JSON: {error}") from None
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from None


def read_yaml(
    path: Path, schema_version: int, largest: int = LARGEST_YAML_BYTES
) -> dict[str, Any]:
    """Return a YAML file's mapping, schema_version removed; ConfigError if it differs.

    Args:
        path: A regular file.
        schema_version: Required value of the key `schema_version`.
        largest: Most bytes that it may hold.

    Returns:
        The mapping without its `schema_version`.

    Raises:
        ConfigError: If the file cannot be read, is not YAML or of another version.
    """
    content = parse_yaml(_read(path, largest), str(path))
    if not isinstance(content, dict):
        raise ConfigError(
            f"{path}: must be a mapping of names to values, got {format_value(content)}"
        )
    version = content.pop("schema_version", None)
    if version != schema_version:
        raise ConfigError(
            f"{path}: schema_version must be {schema_version}, "
            f"got {format_value(version)}"
        )
    return content


def parse_yaml(text: str | bytes, where: str, loader: Any = CoreLoader) -> PlainData:
    """Return the data in YAML; ConfigError for aliases, deep nesting or invalid YAML.

    Args:
        text: YAML as text or as UTF-8 or UTF-16 bytes.
        where: Path or name of the source, to begin an error message with.
        loader: The loader of `yaml_scalars` for the program that reads such files.

    Raises:
        ConfigError: If the text is not YAML, has aliases or is nested too deeply.
    """
    try:
        _check_events(text)
        data = yaml.load(text, loader)  # a safe loader  # noqa: S506  # nosec B506
        # The configuration checks numbers itself, because it can name the key.
        _check(data, numbers=False)
    # PyYAML does not convert what its constructors raise for a bad date, `!!int x` etc.
    except (
        yaml.YAMLError,
        ValueError,
        TypeError,
        LookupError,
        AttributeError,
        ArithmeticError,
    ) as error:
        raise ConfigError(f"{where}: not YAML: {format_error(error)}") from None
    return data


def dump_yaml(content: PlainData, **options: Any) -> str:
    """Return plain data as YAML that YAML 1.1, 1.2 and ROS read alike.

    Args:
        content: Mappings, lists and scalars.
        options: Options of `yaml.dump`, such as its width.
    """
    text: str = yaml.dump(content, Dumper=Dumper, sort_keys=False, **options)
    return text


def read_package_yaml(package: str, file: str) -> PlainData:
    """Return the data in a YAML file in the folder `data` of a Python package.

    Args:
        package: Python package with the file in its folder `data`.
        file: File name, with folders below `data` if there are any.
    """
    return parse_yaml((package_data(package) / file).read_text("utf-8"), file)


def package_data(package: str) -> Path:
    """Return the folder `data` of a Python package."""
    return Path(str(resources.files(package))) / "data"


def make_json_safe(content: PlainData) -> PlainData:
    """Return a copy of plain data that JSON can hold, with None for NaN and infinity.

    Keys become text, tuples become lists.
    """
    if isinstance(content, dict):
        return {str(key): make_json_safe(value) for key, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [make_json_safe(value) for value in content]
    if isinstance(content, float) and not math.isfinite(content):
        return None
    return content


def markdown_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table as text without a final newline; pipes are escaped.

    Args:
        headings: Text over each column.
        rows: Cells of each row, in the order of the headings.
    """
    lines = []
    for cells in (headings, ["---"] * len(headings), *rows):
        text = " | ".join(cell.replace("|", "\\|") for cell in cells)
        lines.append(f"| {text} |")
    return "\n".join(lines)


def _read(path: Path, largest: int) -> bytes:
    """Return the bytes of a file; ConfigError if it cannot be read or is too large."""
    with convert_os_errors(ConfigError, path):
        return read_at_most(path, largest)


def _refuse_constant(name: str) -> None:
    """Raise ValueError with the name of a constant (NaN, Infinity) that JSON lacks."""
    raise ValueError(f"numbers must be finite, got {name}")


def _read_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the mapping of a JSON object; ValueError if a key occurs twice.

    JSON readers disagree about which of its values counts.
    """
    mapping = dict(pairs)
    # Rows are many, so that equal lengths must be enough.
    if len(mapping) < len(pairs):
        refuse_duplicates(key for key, _ in pairs)
    return mapping


def _check(content: PlainData, *, numbers: bool = True) -> None:
    """Raise ValueError for plain data that is nested too deeply or has invalid values.

    Args:
        content: Plain data.
        numbers: Whether to check the range of numbers, too.
    """
    # Level by level, because recursion would fail on the depth that is checked here.
    level = [content]
    for _ in range(DEEPEST):
        next_level: list[Any] = []
        for value in level:
            # Most values are small numbers.
            if isinstance(value, (int, float)) and abs(value) <= _LARGEST_INTEGER:
                continue
            if isinstance(value, dict):
                next_level += value
                next_level += value.values()
            elif isinstance(value, (list, tuple, set)):
                next_level += value
            elif isinstance(value, str):
                # Raises UnicodeEncodeError for lone surrogates, which no file can hold.
                value.encode()
            elif numbers and isinstance(value, int):
                raise ValueError(
                    f"integers must fit in 64 bits, got {format_value(value)}"
                )
            elif numbers and isinstance(value, float) and not math.isfinite(value):
                raise ValueError(f"numbers must be finite, got {value}")
        if not next_level:
            return
        level = next_level
    raise ValueError(f"nested more than {DEEPEST} deep")


def _check_events(text: str | bytes) -> None:
    """Raise YAMLError for aliases and for a structure that is nested too deeply."""
    # Events come before any object is built, so a hostile file costs no memory yet.
    depth = 0
    for event in yaml.parse(text, CoreLoader):
        # Aliases let a file of a few bytes describe gigabytes.
        if isinstance(event, yaml.AliasEvent):
            raise yaml.YAMLError("aliases (*name) are not allowed")
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > DEEPEST:
            raise yaml.YAMLError(f"nested more than {DEEPEST} deep")
