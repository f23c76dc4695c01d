"""The page: every number of it comes from the findings, so that it is made anew and never edited.

    python -m barn_eval.studies.reproduction.page docs

writes the page in a folder anew from the numbers there, after its wording or figures have changed.
"""

import sys
from pathlib import Path

from barn_eval.experiments.rows import write_whole
from barn_eval.pages.page import render
from barn_eval.studies.reproduction import paper, tables
from barn_eval.studies.reproduction.figures import write_figures
from barn_eval.studies.reproduction.findings import Findings, Origin, read_findings, to_json
from barn_eval.trials.outcome import Outcome
from barn_metrics.paper import TABLE_II
from barn_worlds.config import as_dict, from_dict
from barn_worlds.text_files import read_json

NAME = "results"


def write_results(findings: Findings, origin: Origin, folder: Path) -> Path:
    """Write results*.json, results.md and figures/results_*.png and return the page's path; StoreError if it fails."""
    write_figures(findings, folder / "figures")
    write_whole(folder / f"{NAME}.json", to_json(findings).encode())
    write_whole(folder / f"{NAME}_origin.json", to_json(origin).encode())
    path = folder / f"{NAME}.md"
    write_whole(path, page(findings, origin).encode())
    return path


def read_results(folder: Path) -> tuple[Findings, Origin]:
    """Return what `write_results` has written; ConfigError in one line if it cannot be read."""
    where = folder / f"{NAME}_origin.json"
    return read_findings(folder / f"{NAME}.json"), from_dict(Origin, read_json(where), str(where))


def page(findings: Findings, origin: Origin) -> str:
    """Return the page as Markdown."""
    return render(
        "results.md",
        findings=findings,
        scope=findings.scope,
        settings=as_dict(findings.scope.config),
        origin=origin,
        paper=paper,
        table_ii=TABLE_II,
        tables=tables,
        outcomes=[one.value for one in Outcome],
    )


if __name__ == "__main__":
    for name in sys.argv[1:]:
        write_results(*read_results(Path(name)), Path(name))
