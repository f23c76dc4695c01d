"""The tables in the package's README, made from the code itself.

    python -m barn_eval.documentation README.md

writes the parts of the file between markers `<!-- NAME: begin -->` and `<!-- NAME: end -->` anew; a test holds them.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from barn_eval.commands.main import COMMANDS
from barn_eval.experiments.ros_config import RosSetup
from barn_eval.ros.evaluator_config import EvaluatorConfig
from barn_eval.trials.protocol import PROTOCOLS
from barn_worlds.config import fields_of


def commands_table() -> str:
    """Return the commands and what they do."""
    return _table(["command", ""], [[f"`barn {name}`", summary] for name, (_, summary) in COMMANDS.items()])


def protocols_table() -> str:
    """Return the fields of protocols with a column per built-in protocol."""
    values = [{name: value for name, _, value in fields_of(one)} for one in PROTOCOLS.values()]
    rows = []
    for name, about, _ in fields_of(next(iter(PROTOCOLS.values()))):
        rows.append([f"`{name}`", *(_text(one[name]) for one in values), about.unit, about.description])
    return _table(["field", *PROTOCOLS, "unit", "meaning"], rows)


def settings_table(config: Any) -> str:
    """Return the fields of a configuration with defaults, units and allowed values."""
    rows = []
    for name, about, value in fields_of(config):
        allowed = about.allowed()
        rows.append([f"`{name}`", _text(value), about.unit, about.description + (f" ({allowed})" if allowed else "")])
    return _table(["parameter", "default", "unit", "meaning"], rows)


SECTIONS: dict[str, Callable[[], str]] = {
    "commands": commands_table,
    "protocols": protocols_table,
    "ros settings": lambda: settings_table(RosSetup()),
    "evaluator parameters": lambda: settings_table(EvaluatorConfig()),
}


def updated(text: str) -> str:
    """Return a text with every section between markers made anew; ValueError if one is missing."""
    for name, make in SECTIONS.items():
        begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
        before, found, rest = text.partition(begin)
        _, closed, after = rest.partition(end)
        if not found or not closed:
            raise ValueError(f"no {begin} ... {end} in the text")
        text = f"{before}{begin}\n\n{make()}\n\n{end}{after}"
    return text


def main(arguments: Sequence[str]) -> int:
    """Rewrite the files named."""
    for name in arguments:
        path = Path(name)
        path.write_text(updated(path.read_text("utf-8")), "utf-8")
    return 0


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (list, tuple)):
        return ", ".join(map(_text, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
