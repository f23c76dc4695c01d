"""Rows that were made to hurt, with the right checksum."""

import json
import shutil
from collections.abc import Callable
from typing import Any

from barn_eval.results.rows import seal_line, unseal_line
from fault_cases.campaigns import run_undisturbed
from fault_cases.inputs import FAMILY, LONGEST
from fault_cases.kit import Lab, add_all, hold


def _bad_rows(lab: Lab, change: Callable[[dict[str, Any]], str]) -> str:
    """Change the first row of a campaign, with the right checksum.

    Every reader must refuse it.
    """
    shutil.copytree(run_undisturbed(), lab.out)
    path = lab.out / "results.jsonl"
    first, *rest = path.read_text().splitlines()
    row = json.loads(unseal_line(first, ""))
    lines = [seal_line(change(row)), *rest]
    path.write_text("\n".join(lines) + "\n")
    refusal = ""
    for words in (("report", lab.out), ("compare", lab.out, lab.out)):
        refusal = lab.expect_refusal(*words)
        hold("results.jsonl, line 1" in refusal and len(refusal) < LONGEST, refusal)
    return refusal.replace(str(lab.folder), "")[:200]


_MUST = "Report and comparison refuse it in one line with file and line."
_ROWS = (
    (
        "row-nan",
        "A row says that a trial took NaN s.",
        lambda row: json.dumps(
            row | {"scores": row["scores"] | {"duration_s": float("nan")}}
        ),
    ),
    (
        "row-type",
        "A row says that its world is a mapping.",
        lambda row: json.dumps(row | {"world": {"a": 0}}),
    ),
    (
        "row-deep",
        "A row is nested 5,000 deep.",
        lambda row: json.dumps(row)[:-1] + ',"a":' + "[" * 5000 + "]" * 5000 + "}",
    ),
    (
        "row-huge",
        "A row has a detail of 2 MB.",
        lambda row: json.dumps(row | {"detail": "x" * 2_000_000}),
    ),
    (
        "row-number",
        "A row has a world number of 400 digits.",
        lambda row: json.dumps(row | {"world": 10**400}),
    ),
    (
        "row-surrogate",
        "A row's detail is half a character of UTF-16.",
        lambda row: json.dumps(row | {"detail": "\ud800"}),
    ),
)
add_all(FAMILY, _MUST, _bad_rows, _ROWS)
