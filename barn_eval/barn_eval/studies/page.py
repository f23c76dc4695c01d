"""The page: every number of it comes from the findings, so that it is made anew and never edited.

    python -m barn_eval.studies.page docs

writes the page in a folder anew from the numbers there, after its wording or figures have changed.
"""

from __future__ import annotations

import sys
from pathlib import Path

from barn_eval.experiments.rows import write_whole
from barn_eval.studies.claims import claims
from barn_eval.studies.figures import write_figures
from barn_eval.studies.findings import Findings, read_findings, to_json
from barn_eval.studies.markdown import table
from barn_eval.studies.origin import Origin
from barn_eval.studies.sections import metrics_section, models_section, transfer_section, trials_section
from barn_worlds.config import from_dict
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
    parts = [
        *_head(findings),
        *_claims(findings),
        *metrics_section(findings),
        *trials_section(findings),
        *models_section(findings),
        *transfer_section(findings),
        *_origin(findings, origin),
    ]
    return "\n".join(parts) + "\n"


def _head(findings: Findings) -> list[str]:
    scope = findings.scope
    command = "barn reproduce --quick" if scope.config.strata else "barn reproduce"
    trials = sum(one.trials for one in findings.trials.planners)
    lines = [
        "# The paper's results, reproduced",
        "",
        f"Written by `{command}`; every number comes from `{NAME}.json` beside it. {trials} trials in {scope.worlds}"
        f" worlds of the data set `{scope.dataset}`, {scope.repetitions} per world and planner, under the protocol"
        f" `{scope.protocol['name']}`, seed {scope.campaign_seed}. Brackets are 95 % intervals from drawing whole"
        " worlds with replacement. Published numbers are those of Perille et al., Benchmarking Metric Ground"
        " Navigation (2020), and of the tables published with it.",
        "",
    ]
    if not scope.whole:
        how = ", one from each of as many parts of their order from easy to difficult" if scope.config.strata else ""
        lines += [
            f"**This is a part of the reproduction: {scope.worlds} of {scope.dataset_worlds} worlds{how}. Intervals are"
            " wider than those of all worlds, and models trained on so few worlds predict worse.**",
            "",
        ]
    return lines


def _claims(findings: Findings) -> list[str]:
    rows = [(one.text, one.published, one.ours, one.verdict) for one in claims(findings)]
    return [
        "## What the paper concludes, and whether it holds here",
        "",
        *table(("the paper", "published", "ours", "verdict"), rows),
        "",
        "A conclusion holds if the whole interval is on its side, does not hold if it is on the other, and is not"
        " decided otherwise.",
        "",
    ]


def _origin(findings: Findings, origin: Origin) -> list[str]:
    config = findings.scope.config
    settings = ", ".join(f"{name} {getattr(config, name)}" for name in config.__dataclass_fields__)
    versions = [", ".join(f"{name} {value}" for name, value in one.items()) for one in origin.versions]
    machines = [f"{one['processor']}, {one['cores']} cores, {one['system']}" for one in origin.machines]
    return [
        "## How this was made",
        "",
        f"- Configuration: {settings}",
        f"- Data set: `{findings.scope.dataset}`, SHA-256 {findings.scope.dataset_checksum}",
        *(f"- Commit: {one}" for one in origin.commits),
        *(f"- Versions: {one}" for one in versions),
        *(f"- Machine: {one}" for one in machines),
    ]


if __name__ == "__main__":
    for name in sys.argv[1:]:
        write_results(*read_results(Path(name)), Path(name))
