"""Folders of settings, which are named by their parameter values."""

import re
from collections.abc import Sequence
from pathlib import Path

from barn_eval.results.run_file import RUN_FILE

LATENCY = "latency"
"""Parameter of a latency study: the delay of all planners' commands [s]."""

_VALUE = re.compile(r"([^=,]+)=([^=,]+)")


def format_setting_value(value: object) -> str:
    """Return a parameter value as text, as folders, tables and figures name it."""
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, bool):
        return str(value).lower()
    return str(value)


def parse_folder_name(folder: Path) -> dict[str, float | str]:
    """Return the parameter values in a setting's folder name; empty for other names."""
    values: dict[str, float | str] = {}
    for part in folder.name.split(","):
        match = _VALUE.fullmatch(part)
        # A part that is not a value shows that the folder is something else.
        if match is None:
            return {}
        values[match[1]] = _parse_value(match[2])
    return values


def _parse_value(text: str) -> float | str:
    """Return a text as a float if it is a number, else as it is."""
    try:
        return float(text)
    except ValueError:
        return text


def find_setting_folders(folder: Path) -> list[Path]:
    """Return a sweep's folders of settings, sorted by values; [] for any other path."""
    if (folder / RUN_FILE).exists() or not folder.is_dir():
        return []
    folders = [
        path
        for path in folder.iterdir()
        if parse_folder_name(path) and (path / RUN_FILE).exists()
    ]
    # Numbers and texts do not compare, so the type decides first.
    return sorted(
        folders,
        key=lambda path: [
            (str(type(value)), value) for value in parse_folder_name(path).values()
        ],
    )


def expand_sweeps(folders: Sequence[Path]) -> list[Path]:
    """Return run folders, a sweep's folder replaced by the folders of its settings."""
    expanded: list[Path] = []
    for folder in folders:
        expanded += find_setting_folders(folder) or [folder]
    return expanded
