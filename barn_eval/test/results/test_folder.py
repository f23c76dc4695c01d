"""The folder of an experiment: whose it is, and who may work in it."""

import errno
import json
import os
from collections import Counter
from dataclasses import replace
from functools import cache
from itertools import count as numbers

import pytest
import yaml
from campaign_runs import tables
from refusals import refused
from report_work import change_row
from running.test_runner import record
from text_tables import answers_of

from barn_eval.results.folder import ResultsFolder, read_results
from barn_eval.results.rows import append_line
from barn_eval.results.run_file import RunFile
from barn_eval.trials.result import SCHEMA_VERSION
from barn_eval.trials.run_config import (
    UNKNOWN_SOURCE,
    ExecutionConfig,
    PlannerChoice,
    RunConfig,
)
from barn_worlds.base.errors import BarnError, StoreError
from barn_worlds.base.files import open_regular

GAP = RunConfig(
    worlds="0,50", planners=(PlannerChoice("gap"),), repetitions=2, seed=3, bags="all"
)
EXECUTION = ExecutionConfig(workers=1)


def keep(path, experiment, count=None, **options):
    """Begin or resume an experiment, give it results without driving, and return all
    there are.
    """
    with ResultsFolder.open(
        path, experiment, EXECUTION, experiment.trials(), **options
    ) as folder:
        for spec in folder.remaining[:count]:
            folder.append(record(spec))
        return folder.results()


def content(path):
    return json.loads((path / "run.json").read_text())


def test_a_folder_without_a_result_is_taken_over(tmp_path):
    typo = replace(
        GAP, mode="ros", planners=(PlannerChoice("mine", command="python3 mien.py"),)
    )
    keep(tmp_path, typo, 0)
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "planner.log").write_text("No such file")
    mended = replace(typo, planners=(PlannerChoice("mine", command="python3 mine.py"),))
    keep(tmp_path, mended, 1)
    assert RunFile.read(tmp_path).run_config() == mended
    assert not (tmp_path / "logs").exists()
    with refused(
        r"planners\.0\.command is 'python3 mine\.py' there, 'python3 mien\.py' here"
    ):
        keep(tmp_path, typo)


def test_a_folder_that_was_moved_away_takes_no_result(tmp_path):
    """Nor does what has taken its place, where its trials would be driven anew."""
    out = tmp_path / "out"
    with ResultsFolder.open(out, GAP, EXECUTION, GAP.trials()) as folder:
        first, second, *_ = folder.remaining
        folder.append(record(first))
        out.rename(tmp_path / "away")
        with refused("out: cannot be written: No such file", StoreError):
            folder.append(record(second))
        out.mkdir()
        with refused("out: is not the folder of this run", StoreError):
            folder.append(record(second))


def test_results_are_replaced_only_when_told_to(tmp_path):
    keep(tmp_path, GAP)
    other = replace(GAP, seed=4)
    with refused("seed is 3 there, 4 here; use a different folder, or --overwrite"):
        keep(tmp_path, other, 0)
    assert len(read_results(tmp_path)) == 4
    (result,) = keep(tmp_path, other, 1, overwrite=True)
    assert result.campaign_seed == 4
    assert len(content(tmp_path)["sessions"]) == 1


def test_what_is_replaced_is_the_experiments_own(tmp_path):
    keep(tmp_path, GAP)
    (bag := tmp_path / "bags" / "gap_w0000_r00").mkdir(parents=True)
    (tmp_path / "bags" / "notes.txt").write_text("mine")
    keep(tmp_path, replace(GAP, seed=4), 1, overwrite=True)
    assert (tmp_path / "bags" / "notes.txt").read_text() == "mine"
    assert not bag.exists()


def test_sessions_are_kept_one_after_the_other(tmp_path):
    for count in (1, 1, None):
        keep(tmp_path, GAP, count)
    run_file = content(tmp_path)
    assert (run_file["schema_version"], len(run_file["sessions"])) == (
        SCHEMA_VERSION,
        3,
    )
    keys = {"started_at", "execution", "versions", "commit", "machine"}
    assert all(keys <= session.keys() for session in run_file["sessions"])


def test_a_planner_whose_source_is_not_known_is_not_resumed(tmp_path):
    live = replace(GAP, planners=(PlannerChoice("mine", source=UNKNOWN_SOURCE),))
    keep(tmp_path, live, 1)
    with refused("'mine': its source is unknown, so the run cannot be resumed"):
        keep(tmp_path, live)
    with_source = replace(GAP, planners=(PlannerChoice("mine", source="0" * 64),))
    keep(tmp_path / "known", with_source, 1)
    assert len(keep(tmp_path / "known", with_source)) == 4


def test_another_robot_is_not_mixed_in(tmp_path):
    keep(tmp_path, GAP, 1)
    run = RunFile.read(tmp_path)
    replace(run, robot="0" * 64).write()
    with refused("holds results of a different robot: robot is '0000"):
        keep(tmp_path, GAP)


NO_RUNS = """
{}
    schema_version must be 2 or 3 or 4 or 5 or 6 or 7, got None
{"schema_version": 8, "experiment": {}}
    or 5 or 6 or 7, got 8
{"schema_version": 2, "experiment": 3}
    describes no run
{"schema_version": 2, "experiment": {"planners": 3}}
    run.json: planners
"""


@pytest.mark.parametrize("text, message", answers_of(NO_RUNS))
def test_what_is_no_experiment_is_refused_in_one_line(tmp_path, text, message):
    (tmp_path / "run.json").write_text(text)
    with refused(message):
        RunFile.read(tmp_path).run_config()


CHANGES = r"""
- [campaign_seed, 10, 'gap_w0000_r00 has campaign_seed 10, must have 3']
- [simulator_seed, 7, 'gap_w0000_r00 has simulator_seed 7, must have ']
- [planner_seed, 7, 'gap_w0000_r00 has planner_seed 7, must have ']
- [repetition, 7, 'gap_w0000_r00 has repetition 7, must have 0']
- - observed
  - {system: lab, pose_source: /odom, clock: stamps, contact_source: none,
     clearance_by: '', time_uncertainty_s: null}
  - has observed ObservedTrial.*, must have None
- [task, '000000000000', 'was run as task 000000000000, but run\.json describes']
- - trial_id
  - dwa_w0999_r00
  - holds a result of dwa_w0999_r00, which is not a trial of this run
"""


@pytest.mark.parametrize("name, value, message", yaml.safe_load(CHANGES))
def test_a_row_of_another_trial_is_refused(tmp_path, name, value, message):
    keep(tmp_path, GAP, 1)
    change_row(tmp_path, **{name: value})
    with refused(message):
        keep(tmp_path, GAP)


def test_an_early_kill_leaves_a_usable_folder(tmp_path):
    (tmp_path / ".run.json.x1y2.partial").write_text("{")
    (tmp_path / ".lock").touch()
    assert len(keep(tmp_path, GAP)) == 4
    assert not (tmp_path / ".run.json.x1y2.partial").exists()


@pytest.mark.parametrize(
    "name, code", [("fsync", errno.ENOSPC), ("replace", errno.EROFS)]
)
def test_a_failing_disk_stops_the_run_and_loses_nothing(
    tmp_path, monkeypatch, name, code
):
    keep_whole(tmp_path / "whole")
    function = getattr(os, name)
    for number in range(1, 50):
        calls = numbers(1)

        def failing(*arguments, number=number, calls=calls):
            if next(calls) >= number:
                raise OSError(code, os.strerror(code))
            return function(*arguments)

        out = tmp_path / f"out{number}"
        monkeypatch.setattr(os, name, failing)
        try:
            keep_whole(out)
        except BarnError as error:
            assert os.strerror(code) in str(error)
            assert "\n" not in str(error)
        else:
            break
        finally:
            monkeypatch.setattr(os, name, function)
        keep_whole(out)
        assert tables(out) == tables(tmp_path / "whole")
        names = {result.trial_id for result in read_results(out)}
        assert names == {spec.trial_id for spec in trials()}
        assert not list(out.glob(".*.partial"))
    else:
        pytest.fail("it never came to its end")
    assert number > 5


@cache
def trials():
    return GAP.trials()


def fill(folder):
    for spec in folder.remaining:
        folder.append(record(spec))


def keep_whole(path):
    with ResultsFolder.open(path, GAP, EXECUTION, trials()) as folder:
        fill(folder)
        folder.complete()


def test_two_writers_do_not_touch_each_others_files(tmp_path):
    """The second comes while the first is recording a bag."""
    with ResultsFolder.open(tmp_path, GAP, EXECUTION, trials()) as folder:
        partial = tmp_path / "bags" / f"{folder.remaining[0].trial_id}.partial"
        partial.mkdir(parents=True)
        with refused("another process is working in this folder"):
            keep_whole(tmp_path)
        assert partial.is_dir()
        fill(folder)
    assert len(read_results(tmp_path)) == 4


def test_a_resumed_run_reads_each_file_once_at_its_start_and_end(tmp_path, monkeypatch):
    opened = Counter()

    def counting(path):
        if path.suffix == ".jsonl":
            opened[path.name] += 1
        return open_regular(path)

    for module in ("barn_worlds.base.files", "barn_eval.results.rows"):
        monkeypatch.setattr(f"{module}.open_regular", counting)
    keep(tmp_path, GAP, 2)
    # A kill left a track and commands without a row.
    append_line(tmp_path / "tracks.jsonl", record(trials()[-1]).track)
    append_line(tmp_path / "commands.jsonl", '{"trial_id":"gap_w0000_r09"}')
    opened.clear()
    with ResultsFolder.open(tmp_path, GAP, EXECUTION, trials()) as folder:
        assert len(folder.completed) == len(folder.results()) == 2
        assert opened == {"results.jsonl": 1, "tracks.jsonl": 1, "commands.jsonl": 1}
        opened.clear()
        fill(folder)
        # The time per trial does not grow with the folder.
        assert not opened
        folder.complete()
    assert opened == {"results.jsonl": 1, "tracks.jsonl": 1}
