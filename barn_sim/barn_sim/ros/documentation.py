"""The tables of parameters in the package's README, made from the code.

    python -m barn_sim.ros.documentation PACKAGE_FOLDER

writes the part of README.md between the two markers anew; a test holds it to the code.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from barn_sim.config import PRESETS, SimulatorConfig
from barn_sim.ros.node_config import NodeConfig, RunConfig
from barn_worlds.config import Quantity, fields_of

BEGIN, END = "<!-- parameters: begin -->", "<!-- parameters: end -->"


def parameter_section() -> str:
    """Return the tables of all parameters of the node."""
    presets = [{name: value for name, _, value in fields_of(config)} for config in PRESETS.values()]
    simulator = [_row(["parameter", *PRESETS, "unit", "meaning"]), _row(["---"] * (len(PRESETS) + 3))]
    for name, about, _ in fields_of(SimulatorConfig()):
        shown = [_text(values[name]) for values in presets]
        simulator.append(_row([f"`{name}`", *shown, about.unit, _meaning(about)]))
    parts = [
        BEGIN,
        "World, start and pace; taken over by `~/reset`:",
        _table(RunConfig(), leave_out={name for name, _, _ in fields_of(SimulatorConfig())}),
        "The simulator, with its presets (`barn_sim.config.PRESETS`, `config/PRESET.yaml`); taken over by `~/reset`:",
        "\n".join(simulator),
        "Fixed when the node starts:",
        _table(NodeConfig()),
        END,
    ]
    return "\n\n".join(parts)


def updated(text: str) -> str:
    """Return a README with the part between the markers made anew; ValueError if it has no markers."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"no {BEGIN} ... {END} in the text")
    return before + parameter_section() + after


def main(arguments: Sequence[str]) -> int:
    """Rewrite README.md in the package's folder."""
    (folder,) = map(Path, arguments)
    readme = folder / "README.md"
    readme.write_text(updated(readme.read_text(encoding="utf-8")), encoding="utf-8")
    return 0


def _table(config: Any, leave_out: set[str] | None = None) -> str:
    rows = [_row(["parameter", "default", "unit", "meaning"]), _row(["---"] * 4)]
    for name, about, value in fields_of(config):
        if name not in (leave_out or set()):
            rows.append(_row([f"`{name}`", _text(value), about.unit, _meaning(about)]))
    return "\n".join(rows)


def _meaning(about: Quantity) -> str:
    allowed = about.allowed()
    return about.description + (f" ({allowed})" if allowed else "")


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
