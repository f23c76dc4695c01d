"""What identifies a planner that a command starts: its files and node parameters."""

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path

from barn_eval.running.planner_packages import find_packaged
from barn_eval.trials.identity import flatten
from barn_worlds.base.errors import ConfigError, convert_os_errors, format_value
from barn_worlds.base.files import parse_json, read_json, write_durably

# Files of parameters, launch, code and weights.
_SUFFIXES = frozenset(
    [".yaml", ".yml", ".json", ".toml", ".xml", ".py", ".so", ".npz", ".pt", ".onnx"]
)
_MAX_BYTES = 1 << 30


def hash_command_files(words: Sequence[str]) -> dict[str, str]:
    """Return SHA-256 by name of files that a command names, and of its package folder.

    A file is a word, or the part of a word after := or =, that ends like a file of
    parameters, launch, code or weights. For `ros2 launch PACKAGE FILE` it is also the
    launch file in the share folder of the package. A package that is started from its
    source has one hash, of its folder.

    Raises:
        ConfigError: If a file is too large or cannot be read.
    """
    paths: dict[str, Path] = {}
    for word in words:
        # An option or a remapping names its file behind the last equals sign.
        for name in (word, word.rpartition("=")[2]):
            paths[name] = Path(name)
    if len(words) > 3 and words[1] == "launch":
        paths[words[3]] = _find_launch_file(words[2], words[3])
    hashes = {}
    for name, path in paths.items():
        with convert_os_errors(ConfigError, f"planner command: {name:.60}"):
            if path.suffix in _SUFFIXES and path.is_file():
                hashes[name] = _hash_file(path)
    executable = find_packaged(words)
    if executable is not None:
        if executable.is_packaged:
            hashes[str(executable.folder)] = hash_folder(executable.folder)
        else:
            source = executable.folder / f"{executable.name}.py"
            hashes[str(source)] = _hash_file(source)
    return hashes


def hash_folder(folder: Path) -> str:
    """Return one SHA-256 of a folder's files, without bytecode and hidden ones.

    Raises:
        ConfigError: If a file is too large or cannot be read.
    """
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder)
        is_hidden = any(part.startswith(".") for part in name.parts)
        # Bytecode differs from one Python to the next, the code does not.
        if path.is_file() and "__pycache__" not in name.parts and not is_hidden:
            line = f"{name}\0{_hash_file(path)}\n"
            digest.update(line.encode())
    return digest.hexdigest()


def find_parameter_files(folder: Path, planner: str) -> list[Path]:
    """Return the .parameters.json files of a planner below a folder of logs, sorted.

    Args:
        folder: Folder of logs.
        planner: Name that the results have for it.
    """
    return sorted(folder.rglob(f"{'?' * 12}_{planner}.parameters.json"))


def read_node_parameters(folder: Path, planner: str) -> dict[str, str]:
    """Return a planner's node parameters as texts by "NODE NAME", from all its logs.

    Args:
        folder: Folder of logs.
        planner: Name that the results have for it.

    Returns:
        Values by "NODE NAME".

    Raises:
        ConfigError: If a file is damaged.
    """
    parameters: dict[str, str] = {}
    for path in find_parameter_files(folder, planner):
        for key, value in flatten(read_json(path)):
            parameters[key] = str(value)
    return parameters


def write_node_parameters(folder: Path, logs: Path, planner: str, text: str) -> None:
    """Write a planner's node parameters as JSON; ConfigError if one has changed.

    Args:
        folder: Folder of all logs of the run.
        logs: Folder in it for the file.
        planner: Name that the results have for it.
        text: JSON of values by "NODE NAME".

    Raises:
        ConfigError: If a parameter had another value in earlier trials of the run.
    """
    earlier = read_node_parameters(folder, planner)
    for key, value in flatten(parse_json(text, "parameters")):
        if earlier.get(key, value) != value:
            raise ConfigError(
                f"{folder.parent}: holds results of a different configuration: planner"
                f" {planner!r}: parameter {key} was {format_value(earlier[key])} there,"
                f" is {format_value(value)} now; use a different folder"
            )
    # By content, so that equal parameters of many trials are kept once.
    digest = hashlib.sha256(text.encode()).hexdigest()
    write_durably(logs / f"{digest[:12]}_{planner}.parameters.json", text.encode())


def _find_launch_file(package: str, name: str) -> Path:
    """Return the path of a package's launch file; the name itself if there is none."""
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    for prefix in filter(None, prefixes):
        for path in (Path(prefix) / "share" / package).rglob(name):
            return path
    return Path(name)


def _hash_file(path: Path) -> str:
    """Return SHA-256 of a file in hexadecimal; ConfigError if it is above 1 GiB."""
    digest = hashlib.sha256()
    with (
        convert_os_errors(ConfigError, f"planner command: {path}"),
        path.open("rb") as file,
    ):
        # Of the open file: its path could meanwhile name another one.
        if os.fstat(file.fileno()).st_size > _MAX_BYTES:
            raise ConfigError(
                f"planner command: {path}: more than the allowed {_MAX_BYTES} bytes"
            )
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
