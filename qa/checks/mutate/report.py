"""What became of mutants.

Totals, survivors with the reason of each, and docs/mutation.md.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from changes import Mutant

REASONS = Path(__file__).with_name("survivors.yaml")
BEGIN = "<!-- results: begin -->"
END = "<!-- results: end -->"
NO_REASON = "NO REASON KNOWN"

Change = tuple[str, str, str, str]  # module, function, the line before, the line after


@dataclass(frozen=True)
class Tried:
    """A mutant of a module and what became of it."""

    module: str
    mutant: Mutant
    killed: bool

    @property
    def change(self) -> Change:
        """What identifies the mutant, wherever in its file it stands."""
        return self.module, self.mutant.where, self.mutant.was, self.mutant.now


def load_reasons() -> dict[Change, str]:
    """Return why the mutants listed in survivors.yaml survive."""
    listed = yaml.safe_load(REASONS.read_text("utf-8"))
    return {
        (module, where, was, now): group["reason"]
        for module, functions in listed.items()
        for where, groups in functions.items()
        for group in groups
        for was, now in group["lines"]
    }


def totals(tried: Sequence[Tried]) -> tuple[int, int, int, float]:
    """Return how many mutants there are, were killed and survived, and the % killed."""
    killed = sum(outcome.killed for outcome in tried)
    return (
        len(tried),
        killed,
        len(tried) - killed,
        100.0 * killed / len(tried) if tried else 0.0,
    )


def summary(tried: Sequence[Tried]) -> str:
    """Return the totals as a line."""
    return "{} mutants, {} killed, {} survived ({:.1f}%)".format(*totals(tried))


def records(tried: Iterable[Tried]) -> list[dict[str, Any]]:
    """Return the survivors as plain data."""
    reasons = load_reasons()
    return [
        {"line": outcome.mutant.line, "reason": reasons.get(outcome.change)}
        | dict(zip(("module", "where", "was", "now"), outcome.change, strict=True))
        for outcome in tried
        if not outcome.killed
    ]


def survivors(tried: Iterable[Tried]) -> str:
    """Return the survivors with place, reason and difference."""
    reasons = load_reasons()
    text = ""
    for outcome in tried:
        if not outcome.killed:
            mutant = outcome.mutant
            reason = reasons.get(outcome.change, NO_REASON)
            place = f"{outcome.module}:{mutant.line} {mutant.where}".rstrip()
            text += f"{place}: {reason}\n"
            text += f"- {mutant.was}\n+ {mutant.now}\n\n"
    return text


def write_page(path: Path, tried: Sequence[Tried]) -> None:
    """Write the table of modules into the page, below what it says by itself."""
    head, _, _ = path.read_text("utf-8").partition(BEGIN)
    modules: dict[str, list[Tried]] = {}
    for outcome in tried:
        modules.setdefault(outcome.module, []).append(outcome)
    rows = [(f"`{module}`", *totals(outcomes)) for module, outcomes in modules.items()]
    rows.append(("all", *totals(tried)))
    table = [
        "| module | mutants | killed | survived | killed, % |",
        "| --- | ---: | ---: | ---: | ---: |",
    ]
    table += ["| {} | {} | {} | {} | {:.1f} |".format(*row) for row in rows]
    parts = [head + BEGIN, "\n".join(table), END]
    path.write_text("\n\n".join(parts) + "\n", "utf-8")
