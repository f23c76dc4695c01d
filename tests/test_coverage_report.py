"""What `make coverage` reports, from data made up here."""

import yaml
from coverage_report import (
    REASONS,
    REFUSAL,
    count_branches,
    group_by_reason,
    reason_for,
)

FILES = {
    "barn_sim/barn_sim/a.py": {
        "summary": {"num_branches": 10, "covered_branches": 7},
        "missing_branches": [[3, 4], [5, -1], [-8, 9]],
    },
    "barn_sim/barn_sim/b.py": {
        "summary": {"num_branches": 2, "covered_branches": 2},
        "missing_branches": [],
    },
    "barn_eval/barn_eval/c.py": {
        "summary": {"num_branches": 4, "covered_branches": 3},
        "missing_branches": [[1, 2]],
    },
}


def test_branches_are_counted_by_package_and_all_come_last():
    branches = count_branches({"files": FILES})
    assert {
        name: (reached.branches, reached.reached) for name, reached in branches.items()
    } == {"barn_eval": (4, 3), "barn_sim": (12, 9), "all": (16, 12)}
    assert list(branches)[-1] == "all"
    assert branches["all"].percent == 75.0
    assert branches["barn_sim"].missing == {
        "barn_sim/barn_sim/a.py": [(3, 4), (5, 0), (8, 9)]
    }


def test_each_gap_counts_for_the_first_reason_that_fits(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for path in FILES:
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        lines = ["", "raise Mistake", *["pass"] * 8]
        (tmp_path / path).write_text("\n".join(lines))
    missing = count_branches({"files": FILES})["all"].missing
    assert group_by_reason(
        missing, {"barn_sim/*": "cannot be", "barn_sim/barn_sim/a.py": "later"}
    ) == {"cannot be": 3, REFUSAL: 1}
    assert (
        reason_for("barn_eval/barn_eval/c.py", "pass", {"barn_sim/*": "cannot be"})
        == ""
    )


def test_reasons_are_given_of_files_that_exist():
    root = REASONS.parents[2]
    reasons = yaml.safe_load(REASONS.read_text("utf-8"))
    assert reasons and all(reasons.values())
    missing = [pattern for pattern in reasons if not list(root.glob(pattern))]
    assert missing == []
