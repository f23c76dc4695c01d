"""Files that a planner's command names, which decide what ran: parameters, a launch file, a script or a library."""

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path

from barn_worlds.base.errors import ConfigError, reported_as

_ENDINGS = (".yaml", ".yml", ".json", ".toml", ".xml", ".py", ".so", ".npz", ".pt", ".onnx")
_LARGEST = 1 << 30  # bytes


def command_files(words: Sequence[str]) -> dict[str, str]:
    """Return the SHA-256 of each file that a command names, by the name that it has there.

    That is a word, or what stands behind its := or =, with the ending of a file of parameters, launch, code or weights;
    and the launch file of `ros2 launch PACKAGE FILE`, from the package's share. ConfigError for one too large or
    unreadable.
    """
    named = {text: Path(text) for word in words for text in (word, word.rpartition("=")[2])}
    if len(words) > 3 and words[1] == "launch":
        named[words[3]] = _launch_file(words[2], words[3])
    return {text: _digest(path) for text, path in named.items() if path.suffix in _ENDINGS and path.is_file()}


def folder_digest(folder: Path) -> str:
    """Return the SHA-256 of all files below a folder, with their names, but for compiled Python; as `command_files`."""
    found = hashlib.sha256()
    for path in sorted(one for one in folder.rglob("*") if one.is_file() and "__pycache__" not in one.parts):
        found.update(f"{path.relative_to(folder)}\0{_digest(path)}\n".encode())
    return found.hexdigest()


def _launch_file(package: str, name: str) -> Path:
    """Return where ament has the launch file of a package; the name itself where it has none."""
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    found = (path for prefix in prefixes if prefix for path in (Path(prefix) / "share" / package).rglob(name))
    return next(found, Path(name))


def _digest(path: Path) -> str:
    with reported_as(ConfigError, f"planner command: {path}"), path.open("rb") as file:
        if os.fstat(file.fileno()).st_size > _LARGEST:
            raise ConfigError(f"planner command: {path}: more than the allowed {_LARGEST} bytes")
        found = hashlib.sha256()
        while block := file.read(1 << 20):
            found.update(block)
    return found.hexdigest()
