"""`barn reproduce` with trials that are driven, few of them."""

from dataclasses import replace

from rich.console import Console

from barn_eval.experiments.experiment import Execution
from barn_eval.studies.reproduction.findings import QUICK, reproduce
from barn_eval.studies.reproduction.page import write_results


def test_the_whole_runs_from_nothing_and_drives_no_trial_twice(tmp_path):
    tiny = replace(QUICK, strata=10, repetitions=2, folds=2)
    out = tmp_path / "out"
    findings, origin = reproduce(tiny, out, Execution(workers=1), Console(quiet=True))
    assert findings.trials.of("dwa").trials == 20
    assert write_results(findings, origin, out).is_file() and (out / "campaign" / "results.csv").is_file()
    before = (out / "campaign" / "results.jsonl").read_bytes()
    assert reproduce(tiny, out, Execution(workers=2), Console(quiet=True))[0] == findings
    assert (out / "campaign" / "results.jsonl").read_bytes() == before
