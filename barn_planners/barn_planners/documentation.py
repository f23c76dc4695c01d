"""The tables of parameters in the package's README, made from the configurations themselves.

    python -m barn_planners.documentation README.md

writes the part of the file between the two markers anew; a test holds it to the code.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from barn_planners.registry import planner_entry, planner_names
from barn_worlds.config import fields_of

BEGIN, END = "<!-- parameters: begin -->", "<!-- parameters: end -->"


def parameter_table(name: str) -> str:
    """Return the parameters of a planner as a Markdown table with a column per preset."""
    presets = planner_entry(name).presets
    values = [{field: value for field, _, value in fields_of(config)} for config in presets.values()]
    lines = [_row(["parameter", *presets, "unit", "meaning"]), _row(["---"] * (len(presets) + 3))]
    for field, about, _ in fields_of(next(iter(presets.values()))):
        allowed = about.allowed()
        meaning = about.description + (f" ({allowed})" if allowed else "")
        shown = [_text(config[field]) for config in values]
        lines.append(_row([f"`{field}`", *shown, about.unit, meaning]))
    return "\n".join(lines)


def parameter_section() -> str:
    """Return the tables of all planners of this package."""
    parts = [BEGIN]
    for name in planner_names():
        entry = planner_entry(name)
        if not entry.config_class.__module__.startswith("barn_planners."):
            continue
        parts += [f"### `{name}`", entry.summary[:1].upper() + entry.summary[1:] + ".", parameter_table(name)]
    return "\n\n".join([*parts, END])


def updated(text: str) -> str:
    """Return a README with the part between the markers made anew; ValueError if it has no markers."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"no {BEGIN} ... {END} in the text")
    return before + parameter_section() + after


def main(arguments: Sequence[str]) -> int:
    """Rewrite the files named."""
    for name in arguments:
        path = Path(name)
        path.write_text(updated(path.read_text(encoding="utf-8")), encoding="utf-8")
    return 0


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, (int, float)) else str(value)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
