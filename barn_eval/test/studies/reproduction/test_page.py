"""`barn reproduce` from trials to page."""

import json
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace

import pytest
import reproduce_work
from reproduce_work import write_invented
from reproduction_page import read_results
from waiting import ROOT

from barn_eval.results.folder import ResultsFolder
from barn_eval.results.store import TrialRecord
from barn_eval.running.reporting import Reporter
from barn_eval.studies.reproduction import findings
from barn_eval.studies.reproduction.findings import QUICK, paper_run
from barn_eval.studies.reproduction.findings import reproduce as findings_of
from barn_eval.studies.reproduction.page import page, write_results
from barn_eval.trials.run_config import ExecutionConfig

TINY = replace(QUICK, strata=10, repetitions=2)
DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """What ten worlds say, and the page."""
    return reproduce_invented(tmp_path_factory.mktemp("out"))


@contextmanager
def invent_run(request, _reporter):
    """A run whose trials are made up."""
    yield SimpleNamespace(drive=lambda: write_invented(request.out, request.config))


def reproduce_invented(out):
    """Reproduce without driving."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(findings, "open_run", invent_run)
        return reproduce(TINY, out)


def reproduce(config, out):
    findings, origin = findings_of(
        config, out, ExecutionConfig(engine="inline"), Reporter()
    )
    return findings, write_results(findings, origin, out)


def test_only_trials_that_are_missing_are_driven(tmp_path):
    experiment = paper_run(TINY)
    rows = tmp_path / "campaign" / "results.jsonl"
    with ResultsFolder.open(
        rows.parent, experiment, ExecutionConfig(), experiment.trials()
    ) as folder:
        for spec in folder.remaining[2:]:
            folder.append(TrialRecord(reproduce_work.invent_result(spec), None))
    before = rows.read_bytes()
    findings = reproduce(TINY, tmp_path)[0]
    after = rows.read_bytes()
    assert (
        after.startswith(before) and after.count(b"\n") == before.count(b"\n") + 2 == 40
    )
    assert (
        findings.trials.of("dwa").trials == 20
        and (rows.parent / "results.csv").is_file()
    )
    assert reproduce(TINY, tmp_path)[0] == findings
    assert rows.read_bytes() == after


def test_a_second_run_writes_the_same_bytes(tiny, tmp_path):
    findings, path = tiny
    again, elsewhere = reproduce_invented(tmp_path / "again")
    assert again == findings
    names = [
        "results.md",
        "results.json",
        *(f"figures/{file.name}" for file in (path.parent / "figures").iterdir()),
    ]
    assert len(names) == 4
    for name in names:
        assert (elsewhere.parent / name).read_bytes() == (
            path.parent / name
        ).read_bytes()


def test_the_page_shows_ours_beside_the_published_numbers(tiny):
    findings, path = tiny
    text = path.read_text("utf-8")
    dwa = findings.trials.of("dwa").normalised_s_per_m
    assert f"| time per meter as counted [s/m] | 3.30 | {dwa.estimate:.2f} [" in text
    assert "10 of 300 worlds, spread evenly from easy to difficult" in text
    assert (
        "| published: the paper's network | 0.10 | 0.31 | 0.42 | 0.29 | 0.60 |" in text
        and f"| {findings.model.r2.text()} | {findings.model.spearman.text()} |" in text
    )
    assert all((path.parent / name).is_file() for name in _figures(text))
    assert (
        read_results(path.parent)[0] == findings
        and page(*read_results(path.parent)) == text
    )
    content = json.loads(path.with_suffix(".json").read_text())
    assert len(content["trials"]["worlds"]) == 10
    assert not {"started_at", "wall_clock"} & set(json.dumps(content).split('"'))


def rows(text, first):
    """Return the rows of a page's tables that begin with a cell, each as a list of
    cells.
    """
    lines = [
        line.split("|")[1:-1] for line in text.splitlines() if line.startswith("| ")
    ]
    return [
        [cell.strip() for cell in cells] for cells in lines if cells[0].strip() == first
    ]


def test_verdicts_follow_the_numbers(tiny):
    findings, path = tiny
    origin = read_results(path.parent)[1]
    first, second = findings.trials.planners

    def row(planner, name):
        trials = replace(findings.trials, planners=(planner, second))
        return rows(page(replace(findings, trials=trials), origin), name)[0]

    mean = "time per meter as counted [s/m]"
    for low, high, within in ((3.0, 4.0, "yes"), (4.0, 5.0, "no")):
        time = replace(first.normalised_s_per_m, low=low, high=high)
        cells = ["3.30", time.text(), f"{time.estimate - 3.30:+.2f}", within]
        assert row(replace(first, normalised_s_per_m=time), mean)[1:] == cells
    timeouts = first.outcomes["timeout"]
    assert row(first, "failures by timeout")[1:] == [
        "29",
        f"{timeouts}",
        f"{timeouts - 29:+d}",
        "",
    ]
    assert row(first, "timeout")[1:] == [
        f"{planner.outcomes['timeout']}" for planner in (first, second)
    ]


def test_the_command_refuses_in_one_line(rejected):
    message = rejected("reproduce --quick --set dataset=barn301 --out here")
    assert message.startswith(
        "error: barn301: no such file, folder or data set; did you mean 'barn300'"
    )


def test_the_page_in_docs_is_what_its_numbers_give():
    if not (DOCS / "results.json").is_file():
        pytest.skip("the repository's docs are not beside this package")
    published = (DOCS / "results.md").read_text("utf-8")
    assert page(*read_results(DOCS)) == published, (
        "run python qa/studies/reproduction_page.py docs"
    )
    assert all((DOCS / name).is_file() for name in _figures(published))


def _figures(text):
    targets = [part.split(")")[0] for part in text.split("](")[1:]]
    assert len(targets) == 2
    return targets
