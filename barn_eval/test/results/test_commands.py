"""Commands of trials: always kept, whole after a kill, and enough to drive again."""

import json

import numpy as np
import pytest
from forgery import require_problems, without_bags
from planners import run_inline
from refusals import refused
from report_work import rewrite_rows
from results.test_schema import make_old
from text_tables import rows_of

import barn_eval as barn
from barn_eval.results.bags.bagfile import BagFile
from barn_eval.results.commands import MAX_COMMANDS, commands_line, parse_commands_line
from barn_eval.results.folder import ResultsFolder
from barn_eval.results.rows import (
    TRACKS_FILE,
    TrialLines,
    append_line,
    seal_line,
    unseal_line,
)
from barn_eval.results.run_file import RunFile
from barn_eval.results.store import BagStore
from barn_eval.results.tracks import pack_arrays
from barn_eval.running.direct import run_direct_trial
from barn_eval.trials.run_config import ExecutionConfig, RunConfig
from barn_eval.trials.trajectory import TrajectoryLog
from barn_eval.trials.trial import FinishedTrial
from barn_eval.verification.check import check_folder
from barn_eval.verification.rerun import read_bag
from barn_worlds.base.types import ORIGIN, Odometry, Velocity2D

PERIOD_NS = 50_000_000


def lines_of(folder):
    lines = (folder / "commands.jsonl").read_text().splitlines()
    return {json.loads(line)["trial_id"]: unseal_line(line, "line") for line in lines}


def packed(commands, trial_id="a"):
    """Return the line of a trial with these numbers as its commands."""
    arrays = pack_arrays({"commands": commands.ravel()})
    return json.dumps({"trial_id": trial_id} | arrays)


def test_a_run_without_bags_is_driven_again(two_trials, command):
    said = "2 of 2 rows, 2 tracks, 0 bags, 2 driven again\n"
    assert command(f"check {two_trials}") == (0, said, "")


def test_a_run_without_bags_is_submitted_and_verified(
    two_trials, command, succeed, tmp_path
):
    path = tmp_path / "gap.barn.zip"
    succeed(f"submit {two_trials} --out {path}")
    code, out, _ = command(f"verify {path} --out {tmp_path}/kept")
    assert (code, out.splitlines()[-1]) == (0, "holds")
    assert check_folder(tmp_path / "kept").driven == 2


def test_commands_are_small_and_those_of_the_bag(tmp_path):
    (spec,) = RunConfig(worlds="120").trials()
    store = BagStore(tmp_path, "all")
    with store.recorder(spec.trial_id) as recorder:
        record = store.make_record(run_direct_trial(spec, recorder))
    trial_id, commands = parse_commands_line(record.commands, "line")
    readings = read_bag(BagFile(tmp_path / "bags" / spec.trial_id))
    assert trial_id == spec.trial_id
    np.testing.assert_array_equal(commands, readings.trajectory.command)
    assert len(record.commands) < 15 * len(commands) + 300


def test_other_commands_than_those_of_a_bag_are_named(collided_copy):
    ((trial_id, line),) = lines_of(collided_copy).items()
    _, commands = parse_commands_line(line, "line")
    commands = commands.copy()
    commands[3, 0] += 0.01
    (collided_copy / "commands.jsonl").unlink()
    append_line(collided_copy / "commands.jsonl", packed(commands, trial_id))
    require_problems(collided_copy, "its commands differ from those in its bag")


def test_commands_that_no_planner_sent_are_found(trials_copy):
    lines = lines_of(trials_copy)
    first, second = lines
    _, commands = parse_commands_line(lines[second], "line")
    append_line(trials_copy / "commands.jsonl", packed(commands, first))
    assert check_folder(trials_copy).problems


def test_missing_commands_are_named(trials_copy):
    (trials_copy / "commands.jsonl").unlink()
    report = check_folder(trials_copy)
    assert report.problems == [
        f"{trials_copy}: gap_w{world}_r00: its commands are missing"
        for world in ("0000", "0120")
    ]


@pytest.mark.parametrize("cut", [1, 40, 300])
def test_a_kill_while_commands_are_written_loses_one_trial_only(trials_copy, cut):
    """The kill comes before the row, so the trial is run again."""
    expected = lines_of(trials_copy)
    content = (trials_copy / "commands.jsonl").read_bytes()
    (trials_copy / "commands.jsonl").write_bytes(content[:-cut])
    rewrite_rows(trials_copy, lambda rows: rows[:1])
    for name in ("parquet", "csv"):
        (trials_copy / f"results.{name}").unlink()
    run_inline("0,120", out=trials_copy)
    assert lines_of(trials_copy) == expected
    report = check_folder(trials_copy)
    assert (report.problems, report.driven) == ([], 2)


def test_a_trial_that_runs_again_counts_with_its_last_commands(trials_copy):
    """A kill between commands and row leaves commands without a row."""
    expected = lines_of(trials_copy)
    rewrite_rows(trials_copy, lambda rows: rows[:1])
    run_inline("0,120", out=trials_copy)
    assert len((trials_copy / "commands.jsonl").read_text().splitlines()) == 2
    assert lines_of(trials_copy) == expected
    assert check_folder(trials_copy).problems == []


@pytest.mark.parametrize("left", ["row", "lines"])
def test_a_second_attempt_has_no_lines_of_the_first(trials_copy, left):
    """The first one was the environment's failure, or killed before its row."""
    expected = lines_of(trials_copy)
    first, second = expected
    config = RunFile.read(trials_copy).run_config()

    def change(rows):
        rows[1] |= {"outcome": "environment_failed", "fault": "environment"}
        return rows if left == "row" else rows[:1]

    rewrite_rows(trials_copy, change)
    execution = ExecutionConfig(workers=1)
    with ResultsFolder.open(trials_copy, config, execution, config.trials()) as opened:
        assert [spec.trial_id for spec in opened.remaining] == [second]
        assert lines_of(trials_copy) == {first: expected[first]}
        assert TrialLines(trials_copy / TRACKS_FILE).keys() == {first}
    before = (trials_copy / "commands.jsonl").stat()
    with ResultsFolder.open(trials_copy, config, execution, config.trials()):
        assert (trials_copy / "commands.jsonl").stat() == before


def test_results_are_compared_and_shown_without_commands(trials_copy, succeed):
    (trials_copy / "commands.jsonl").write_bytes(b"\0nothing")
    succeed(f"compare {trials_copy} {trials_copy}")
    succeed(f"report {trials_copy} --out report.html")
    assert barn.load(trials_copy).summary["trials"].tolist() == [2]


def test_overwriting_removes_commands(trials_copy):
    run_inline("0", out=trials_copy, overwrite=True, seed=3)
    assert list(lines_of(trials_copy)) == ["gap_w0000_r00"]


def finished(counts, mode="ros", compute="free"):
    """A trial over ROS with so many commands after each reading."""
    (spec,) = RunConfig(worlds="0").trials()
    result = run_direct_trial(spec).result
    log = TrajectoryLog()
    for number, count in enumerate(counts):
        stamp_ns = number * PERIOD_NS
        log.reading(Odometry(stamp_ns, ORIGIN, Velocity2D()), False)
        for _ in range(count):
            log.command(Velocity2D(0.1, 0.0))
    result = type(result)(**vars(result) | {"mode": mode, "compute": compute})
    return FinishedTrial(spec, result, log.trajectory())


# Commands after each reading, how the trial was run and computed, and whether its
# commands are kept.
TRIALS = """
1 1 1 0 | ros | free | kept
1 1 1 1 | ros | free | kept
1 0 1 0 | ros | free | dropped
1 2 1 0 | ros | free | dropped
1 1 1 0 | ros | real_time | dropped
1 0 1 0 | direct | free | kept
 | direct | free | dropped
"""


@pytest.mark.parametrize("counts, mode, compute, kept", rows_of(TRIALS))
def test_commands_are_kept_that_say_when_they_took_effect(counts, mode, compute, kept):
    trial = finished(map(int, counts.split()), mode, compute)
    assert (commands_line(trial) is not None) == (kept == "kept")


def test_the_commands_of_an_endless_trial_are_not_kept(monkeypatch):
    trial = finished([1] * 4, "direct")
    monkeypatch.setattr("barn_eval.results.commands.MAX_COMMANDS", 3)
    assert commands_line(trial) is None
    noise = np.random.default_rng(1).normal(size=2 * MAX_COMMANDS)
    assert len(json.dumps(pack_arrays({"commands": noise}))) < 1_000_000


@pytest.mark.parametrize(
    "line, words",
    [
        ("{}", "line 1: no commands: trial_id is missing"),
        ('{"trial_id": 3}', "no commands: trial_id is missing"),
        ('{"trial_id": "a"}', "no commands: holds no packed arrays"),
        (packed(np.zeros(3)), "no commands: cannot reshape"),
        (packed(np.zeros(4, "f4")), "commands are not 64-bit numbers"),
        (packed(np.zeros(3_000_000)), "cut off, or have more than"),
    ],
)
def test_what_holds_no_commands_is_refused_in_one_line(line, words):
    with refused(words):
        parse_commands_line(line, "commands.jsonl, line 1")


def test_a_file_is_whole_after_a_failed_write(tmp_path):
    path = tmp_path / "commands.jsonl"
    append_line(path, '{"trial_id":"a"}')
    with path.open("a") as torn:
        torn.write('{"trial_id":"b"')
    append_line(path, '{"trial_id":"c"}')
    text = path.read_text()
    assert text.splitlines() == [
        seal_line('{"trial_id":"a"}'),
        seal_line('{"trial_id":"c"}'),
    ]


def test_an_older_folder_is_driven_again_by_its_bags(collided_copy):
    """Folders of schema 2 have no commands but those in bags."""
    make_old(collided_copy)
    report = check_folder(collided_copy)
    assert (report.driven, report.problems) == (1, [])
    without_bags(collided_copy)
    assert check_folder(collided_copy).driven == 0
