"""Parameter files for `--params-file` and the launch argument `params_file`, written from the configurations.

    python -m barn_worlds.ros.parameter_files config

writes those of this package; the other packages have a module of the same name. A test holds them to the code.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from barn_worlds.config import fields_of
from barn_worlds.ros.map_server import MapServerConfig


def parameter_file(
    node: str, title: str, configs: Sequence[Any], more: Mapping[str, Any] | None = None, leave_out: Sequence[str] = ()
) -> str:
    """Return a file with all parameters of a node, each with its meaning.

    node: which nodes it is for, such as "/**/simulator" (that node in any namespace). more: parameters that come first
    and are in none of the configurations. A parameter that is in two of them is as in the last.
    """
    found = {name: (about, value) for config in configs for name, about, value in fields_of(config)}
    lines = [f"# {title}", f"{node}:", "  ros__parameters:"]
    lines += [f"    {_entry(name, value)}" for name, value in (more or {}).items()]
    for name, (about, value) in found.items():
        if name in leave_out:
            continue
        unit, allowed = f" [{about.unit}]" if about.unit else "", about.allowed()
        lines.append(f"    # {about.description}{unit}" + (f" ({allowed})" if allowed else ""))
        lines.append(f"    {_entry(name, value)}")
    return "\n".join(lines) + "\n"


def write(files: Mapping[str, str], arguments: Sequence[str]) -> int:
    """Write files, given by name, to the folder that the only argument names."""
    (folder,) = map(Path, arguments)
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return 0


def files() -> dict[str, str]:
    """Return the parameter files of this package by name."""
    return {
        "map_server.yaml": parameter_file("/**/map_server", "The map server with its defaults.", [MapServerConfig()])
    }


def _entry(name: str, value: Any) -> str:
    if isinstance(value, tuple):
        return f"{name}: {yaml.safe_dump(list(value), default_flow_style=True, width=1000).strip()}"
    return yaml.safe_dump({name: value}, width=1000).strip()


if __name__ == "__main__":
    sys.exit(write(files(), sys.argv[1:]))
