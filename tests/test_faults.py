"""A few fault cases, the log that lists all of them, and mutated files of strangers.

`python qa/faults/faults.py` tries all cases; `python qa/fuzz/fuzz.py --reader NAME
--inputs N` goes on for longer.
"""

import json
import os
import re
import shutil

import pytest
from fuzz_readers import READERS
from repository import ROOT
from waiting import run_python

TOOL = ROOT / "qa" / "faults" / "faults.py"
PAGE = ROOT / "docs" / "reliability.md"
LOG = PAGE.with_suffix(".csv")
QUICK = (
    "inputs/campaign-aliases",
    "inputs/xml-laughs",
    "commands/typo-planner",
    "files/folder-of-something-else",
)


def faults(*arguments):
    return run_python(TOOL, *arguments, check=False)


def test_quick_cases_pass(tmp_path):
    out = tmp_path / "out"
    options = ("--json", "--out", out)
    ended = faults(*(f"--only={name}" for name in QUICK), *options)
    assert ended.returncode == 0, ended.stderr
    outcomes = json.loads(ended.stdout)
    statuses = {outcome["case"]: outcome["status"] for outcome in outcomes}
    assert statuses == dict.fromkeys(QUICK, "passed")
    assert json.loads((out / "faults.json").read_text()) == outcomes
    again = faults(f"--only={QUICK[0]}", "--resume", *options)
    assert again.stdout.strip() == "[]"


@pytest.fixture
def tool(monkeypatch):
    """The tool as a module: its folder need not be there."""
    monkeypatch.syspath_prepend(TOOL.parent)
    import faults as tool  # noqa: PLC0415

    return tool


def test_the_log_has_exactly_the_cases_of_the_tool(tool):
    rows = list(tool.read_log(LOG).values())
    cases = tool.cases_by_family()
    assert len(cases) >= 80
    assert [row["case"] for row in rows] == [case.key for case in cases]
    for row, case in zip(rows, cases, strict=True):
        assert tuple(row) == tool.COLUMNS
        again = f"run {TOOL} --only {case.key} --write {PAGE}"
        assert (row["done"], row["must"]) == (case.done, case.must), again
        assert case.done.endswith(".") and case.must.endswith(".")
        assert row["family"] == tool.FAMILIES[case.family]
        assert row["status"] in {tool.PASSED, tool.FAILED, tool.SKIPPED, tool.UNTRIED}
        assert (ROOT / row["held_by"]).is_file()
        assert row["held_by"] == tool.source(case)
        assert float(row["duration_s"] or 0.0) >= 0.0
        assert re.fullmatch("[0-9a-f]{7,12}", row["since"])


def test_the_page_sums_up_the_log(tool):
    text = PAGE.read_text("utf-8")
    shown = text.partition(tool.BEGIN)[2].partition(tool.END)[0].strip()
    assert shown == tool.summary(tool.read_log(LOG).values())


def test_new_measurements_replace_their_rows_alone(tool, tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"before\n{tool.BEGIN}\nold\n{tool.END}\nafter\n")
    shutil.copy(LOG, tmp_path / "page.csv")
    old_rows = tool.read_log(LOG)
    outcome = tool.Outcome(QUICK[0], tool.FAILED, "x" * 500, 61.6)
    tool.write(page, {QUICK[0]: outcome})
    new_rows = tool.read_log(tmp_path / "page.csv")
    changed = [key for key, row in new_rows.items() if row != old_rows[key]]
    assert changed == [QUICK[0]]
    row = new_rows[QUICK[0]]
    assert (row["status"], row["duration_s"]) == (tool.FAILED, "62")
    assert row["measured"].endswith("x ...")
    assert row["since"] == old_rows[QUICK[0]]["since"]
    text = page.read_text()
    assert text.startswith("before\n") and text.endswith("after\n")
    assert tool.summary(new_rows.values()) in text


def test_a_page_without_a_place_for_the_summary_is_refused(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# Page\n")
    ended = faults("--only", QUICK[2], "--write", page, "--out", tmp_path / "out")
    assert ended.returncode == 1
    assert f"{page}: must have the lines" in ended.stderr
    assert "no case matches x" in faults("--only", "x").stderr


def test_a_fault_that_is_not_met_fails(tool, tmp_path, monkeypatch):
    from fault_cases import kit  # noqa: PLC0415

    def act(lab):
        kit.hold(not lab.out.exists(), "the folder is there")
        lab.start_program(["sleep", "600"])
        raise kit.Wrong("it is not so")

    monkeypatch.setattr(kit, "_LEFT_S", 0.1)
    case = kit.Case("x", "y", "Done.", "Must.", act)
    outcome = tool.try_case(case, tmp_path, [])
    assert (outcome.status, outcome.measured) == ("failed", "it is not so")

    def sleep(lab):
        lab.start_program(["sleep", "600"])

    case = kit.Case("x", "z", "Done.", "Must.", sleep)
    left = tool.try_case(case, tmp_path, [])
    assert left.status == "failed"
    assert "processes are left: ['sleep 600 ']" in left.measured


INPUTS = 400  # the same in every run, which qa/fuzz/fuzz.py goes beyond


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    """What the tool says of each reader."""
    out = tmp_path_factory.mktemp("fuzz")
    options = f"--corpus --inputs {INPUTS} --seconds 3600 --json --out {out}"
    tool = ROOT / "qa" / "fuzz" / "fuzz.py"
    patient = {**os.environ, "FUZZ_LIMIT_S": "60"}
    ended = run_python(tool, *options.split(), check=False, env=patient)
    lines = map(json.loads, ended.stdout.splitlines())
    reports_by_reader = {report["reader"]: report for report in lines}
    assert reports_by_reader.keys() == READERS.keys(), ended.stderr
    return reports_by_reader


@pytest.mark.parametrize("reader", READERS)
def test_whatever_a_file_holds_it_is_read_or_refused_in_one_line(reports, reader):
    assert reports[reader]["findings"] == []
    assert reports[reader]["inputs"] == INPUTS
    assert 0 < reports[reader]["read"] < INPUTS
