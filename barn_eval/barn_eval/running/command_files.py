"""What decides what ran by a planner's command: the files that it names, and the parameters that its nodes tell."""

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path

from barn_eval.trials.identity import flatten
from barn_worlds.base.errors import ConfigError, convert_os_errors, format_value
from barn_worlds.base.files import write_durably
from barn_worlds.base.text_files import parse_json, read_json

_ENDINGS = (
    ".yaml",
    ".yml",
    ".json",
    ".toml",
    ".xml",
    ".py",
    ".so",
    ".npz",
    ".pt",
    ".onnx",
)
_LARGEST = 1 << 30  # bytes


def command_files(words: Sequence[str]) -> dict[str, str]:
    """Return the SHA-256 of each file that a command names, by the name that it has there.

    That is a word, or what stands behind its := or =, with the ending of a file of parameters, launch, code or weights;
    and the launch file of `ros2 launch PACKAGE FILE`, from the package's share. ConfigError for one too large or
    unreadable.
    """
    named = {
        text: Path(text) for word in words for text in (word, word.rpartition("=")[2])
    }
    if len(words) > 3 and words[1] == "launch":
        named[words[3]] = _launch_file(words[2], words[3])
    return {
        text: _digest(path)
        for text, path in named.items()
        if path.suffix in _ENDINGS and path.is_file()
    }


def folder_digest(folder: Path) -> str:
    """Return the SHA-256 of all files below a folder, with their names, but for compiled Python; as `command_files`."""
    found = hashlib.sha256()
    for path in sorted(
        one
        for one in folder.rglob("*")
        if one.is_file() and "__pycache__" not in one.parts
    ):
        found.update(f"{path.relative_to(folder)}\0{_digest(path)}\n".encode())
    return found.hexdigest()


def told_files(folder: Path, planner: str) -> list[Path]:
    """Return the files below a folder of what the nodes of a planner told of their parameters."""
    return sorted(folder.rglob(f"{'?' * 12}_{planner}.parameters.json"))


def told_parameters(folder: Path, planner: str) -> dict[str, str]:
    """Return what is in these files, by "NODE NAME"; ConfigError for a damaged one."""
    return {
        key: str(value)
        for path in told_files(folder, planner)
        for key, value in flatten(read_json(path))
    }


def keep_told(folder: Path, logs: Path, planner: str, text: str) -> None:
    """Keep in logs, below the folder, what a planner's nodes have told of their parameters, as JSON by "NODE NAME".

    ConfigError, naming it, for one of which they have told something else when earlier trials began.
    """
    there = told_parameters(folder, planner)
    for key, value in flatten(parse_json(text, "parameters")):
        if (before := there.get(key, value)) != value:
            what = f"planner {planner!r}: parameter {key} was {format_value(before)} there, is {format_value(value)} now"
            raise ConfigError(
                f"{folder.parent}: holds results of another configuration: {what}; use another folder"
            )
    digest = hashlib.sha256(text.encode()).hexdigest()
    write_durably(logs / f"{digest[:12]}_{planner}.parameters.json", text.encode())


def _launch_file(package: str, name: str) -> Path:
    """Return where ament has the launch file of a package; the name itself where it has none."""
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    found = (
        path
        for prefix in prefixes
        if prefix
        for path in (Path(prefix) / "share" / package).rglob(name)
    )
    return next(found, Path(name))


def _digest(path: Path) -> str:
    with (
        convert_os_errors(ConfigError, f"planner command: {path}"),
        path.open("rb") as file,
    ):
        if os.fstat(file.fileno()).st_size > _LARGEST:
            raise ConfigError(
                f"planner command: {path}: more than the allowed {_LARGEST} bytes"
            )
        found = hashlib.sha256()
        while block := file.read(1 << 20):
            found.update(block)
    return found.hexdigest()
