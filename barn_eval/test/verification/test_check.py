"""`barn check`: a good folder has nothing wrong with it, and whatever is changed in it
is named.
"""

import json
import shutil
from dataclasses import replace

import numpy as np
import pyarrow.parquet
import pytest
import yaml
from forgery import (
    edit_run,
    forge,
    replace_text,
    require_problems,
    rewrite_bag,
    without_bags,
    won,
)
from planners import run_inline
from refusals import refused
from report_work import change_row
from results.test_commands import packed

import barn_eval as barn
from barn_eval.results.bags.recorder import Recorder
from barn_eval.results.commands import parse_commands_line
from barn_eval.results.rows import COMMANDS_FILE, append_line, unseal_line
from barn_eval.trials import spec
from barn_eval.trials.protocol import CHALLENGE
from barn_eval.trials.result import Outcome
from barn_eval.verification.check import check_folder
from barn_eval.verification.plausibility import find_difference
from barn_worlds.messages import decode
from barn_worlds.messages.encode import OdometryEncoder
from barn_worlds.messages.topics import GROUND_TRUTH

SAID = "2 of 2 rows, 2 tracks, 2 bags, 2 driven again\n"


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    out = tmp_path_factory.mktemp("check") / "out"
    return run_inline("0,120", out=out, bags="all").folder


@pytest.fixture
def folder(driven, tmp_path):
    shutil.copytree(driven, tmp_path / "out")
    return tmp_path / "out"


def test_a_good_folder_has_nothing_wrong_with_it(driven, command, printed):
    report = barn.results.check(driven)
    kinds = ("trials", "rows", "tracks", "bags", "driven")
    assert {getattr(report, kind) for kind in kinds} == {2}
    assert (report.problems, report.unchecked) == ([], [])
    assert command(f"check {driven}") == (0, SAID, "")
    assert printed(f"check {driven}")["problems"] == []


def write_long_table(path):
    """Write a table of which run lengths let some kilobytes stand for any number of
    rows.
    """
    table = pyarrow.table({"world": np.zeros(2_000_000, np.int64)})
    pyarrow.parquet.write_table(table, path, compression="zstd")


def test_an_unfinished_folder_is_good_as_far_as_it_goes(folder):
    rows = (folder / "results.jsonl").read_text().splitlines(keepends=True)
    (folder / "results.jsonl").write_text(rows[0] + rows[1][:40])
    assert check_folder(folder).problems == []


# Of a row: its position, what is changed in it, and what is said.
CHANGES = """
- [1, {trial_id: gap_w0009_r00}, gap_w0009_r00 is not a trial of this run]
- [1, {world_checksum: '0'}, world 120 has changed since gap_w0120_r00 ran in it]
- [0, {scores__challenge: 0.5}, challenge of gap_w0000_r00 differs from its row]
- [0, {detail: won}, "detail is 'won' in the row, "]
- [0, {measures__min_clearance_m: 9.0}, 'm in the track, 9.000 m in the row']
- [0, {measures__driven_m: 0.1}, 'm in the track, 0.10 m in the row']
- [0, {measures__contacts: 3}, has 3 contacts in the row; the track disagrees]
"""


@pytest.mark.parametrize("place, change, words", yaml.safe_load(CHANGES))
def test_a_row_that_was_changed_is_named(folder, command, place, change, words):
    change_row(folder, place, **change)
    require_finding(folder, command, words)


@pytest.mark.parametrize(
    "change, words",
    [
        (
            lambda out: replace_text(out / "results.jsonl", "success", "Success"),
            "results.jsonl, line 1: damaged or ed",
        ),
        (
            lambda out: replace_text(out / "tracks.jsonl", "zlib", "Zlib"),
            "tracks.jsonl, line 1: damaged",
        ),
        (
            lambda out: (out / "tracks.jsonl").unlink(),
            "gap_w0000_r00: has no track, though the robot drove",
        ),
        (
            lambda out: shutil.rmtree(out / "bags" / "gap_w0000_r00"),
            "gap_w0000_r00: is missing, though the run keeps bags of all trials",
        ),
        (
            lambda out: (out / "results.parquet").unlink(),
            "results.parquet: is missing, though all trials have rows",
        ),
        (
            lambda out: (out / "results.parquet").write_bytes(b"PAR1"),
            "results.parquet: ",
        ),
        (
            lambda out: write_long_table(out / "results.parquet"),
            "results.parquet: has 2000000 rows, and rows or columns differ from",
        ),
        (
            lambda out: (out / "bags" / "linked").symlink_to(out / "run.json"),
            "bags/linked: is a link",
        ),
        (
            lambda out: (out / "results.csv").unlink(),
            "results.csv: is missing, though all trials have rows",
        ),
        (
            lambda out: replace_text(out / "results.csv", "planner", "success"),
            "results.csv: differs from results.jsonl",
        ),
    ],
)
def test_what_does_not_belong_together_is_named(folder, command, change, words):
    change(folder)
    require_finding(folder, command, words)


def require_finding(folder, command, words):
    """See that `barn check` names a problem, in short lines that begin with the path."""
    code, _, err = command(f"check {folder}")
    lines = err.splitlines()
    assert code == 1 and any(words in line for line in lines)
    assert all(line.startswith(str(folder)) and len(line) < 500 for line in lines)


def test_a_folder_without_any_bags_is_honest(folder):
    shutil.rmtree(folder / "bags")
    check = check_folder(folder)
    assert (check.problems, check.driven) == ([], 2)
    assert check.unchecked == ["2 trials: have no bag"]


def test_a_bag_that_was_cut_off_is_named(folder, command):
    (file,) = (folder / "bags" / "gap_w0000_r00").glob("*.mcap")
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    code, _, err = command(f"check {folder}")
    assert (code, err.count("\n")) == (1, 1)
    assert err.startswith(f"{file.parent}: the bag is cut off after ")


def test_only_the_bag_of_a_trial_that_never_began_may_be_empty(folder):
    path = folder / "bags" / "gap_w0000_r00"
    shutil.rmtree(path)
    with Recorder(path) as recorder:
        recorder.finish()
    assert check_folder(folder).problems == [f"{path}: the bag is empty"]
    change_row(folder, 0, measures__driven_m=0.0)
    problems = check_folder(folder).problems
    assert not any("empty" in problem for problem in problems)


@pytest.mark.parametrize("trial", ["gap_w0120_r00", "2"])
def test_a_trial_that_is_run_again_is_reproduced(driven, command, trial):
    before = sorted(driven.rglob("*"))
    code, out, _ = command(f"check {driven} --rerun {trial}")
    assert (code, out) == (0, f"{SAID}{trial} is reproduced\n")
    assert sorted(driven.rglob("*")) == before


@pytest.mark.parametrize("trial", ["0", "3", "gap_w0001_r00"])
def test_a_trial_that_there_is_not_is_named_as_it_was_typed(driven, rejected, trial):
    error = rejected(f"check {driven} --rerun {trial}")
    assert error.startswith(f"error: {driven}: no trial {trial!r}")


def test_reproducibility_is_unknown_before_a_rerun(folder, command):
    (folder / "results.parquet").unlink()
    code, out, _ = command(f"check {folder} --rerun 1 --json")
    assert (code, json.loads(out)["reproduced"]) == (1, None)


def test_a_differing_trial_is_reported_by_its_first_change(folder):
    change_row(folder, 0, measures__rms_jerk_mps3=7.0)
    for file in ("results.parquet", "results.csv"):
        (folder / file).unlink()
    with refused("no trial 'dwa_w0000_r00'"):
        barn.load(folder).rerun("dwa_w0000_r00")
    results = barn.load(folder)
    assert results.rerun(0).startswith("measures.rms_jerk_mps3 is 7.0 in the row, ")
    assert results.rerun(1) == ""


def test_a_bound_by_averages_warns_and_accuses_nobody(driven, monkeypatch):
    """Tires may slide further than the bound assumes, and the row is honest then."""
    monkeypatch.setitem(spec.WHEEL_SLIP, "skid_steer", -0.2)
    folder = run_inline("0", out=driven.parent / "slid", protocol=CHALLENGE).folder
    report = check_folder(folder)
    assert (report.problems, report.unchecked) == ([], [])
    (note,) = report.notes
    assert note.endswith("was faster than the bound")


def test_a_folder_without_sessions_is_no_run(folder):
    with edit_run(folder) as content:
        content["sessions"] = []
    assert "lists no session" in " ".join(check_folder(folder).problems)


def test_a_command_where_none_was_due_is_a_finding(tmp_path):
    """Who declares computing and commands meanwhile would not pay for it."""
    settings = {"gap.compute.delay_s": 0.3}
    folder = run_inline("0", out=tmp_path / "late", settings=settings).folder
    path = folder / COMMANDS_FILE
    line = unseal_line(path.read_text().rstrip("\n"), "")
    trial_id, commands = parse_commands_line(line, "")
    commands = commands.copy()
    assert np.isnan(commands[1, 0])
    commands[1] = 0.1
    path.unlink()
    append_line(path, packed(commands, trial_id))
    require_problems(folder, "0.05 s, when none was due")


# What somebody does to a collision who would rather have won.
FORGERIES = """
a challenge score of 7:
- {scores__challenge: 7.0}
- scores.challenge is 7.0 in the row, 0.0 comp
a time below zero:
- {scores__traversal_time_s: -5.0}
- scores.traversal_time_s is -5, must be 0
another time on the clock:
- {scores__traversal_time_s: 0.5}
- traversal_time_s is 0.50 in the row
more room:
- {measures__min_clearance_m: 0.3}
- in the track, 0.300 m in the row
a shorter way:
- {measures__driven_m: 0.2}
- m in the track, 0.20 m in the row
no contact:
- {measures__contacts: 0}
- has 0 contacts in the row
another speed cap:
- {speed_cap_mps: 0.5}
- speed_cap_mps is 0.5 in the row
more recoveries:
- {recoveries: 99999}
- recoveries is 99999, must
a remark:
- {remarks: fast}
- remarks is 'fast' in the row
no turns:
- {measures__rotation_rad: 0.0}
- rotation_rad is 0.0
steady commands:
- {measures__turn_variation_radps: 0.0}
- turn_variation_radps is 0.0
less room on average:
- {measures__mean_clearance_m: 0.125}
- mean_clearance_m is 0.125
nobody's fault:
- {fault: environment}
- fault is 'environment' in the row
"""
FORGERIES = yaml.safe_load(FORGERIES) | {
    "a success": (won, "outcome is success in the row, but the track"),
    "a success too fast for the robot": (
        lambda row: won(row, 3.0),
        "outcome is success in the row, but the track",
    ),
    "long near obstacles": (
        lambda row: {"measures__near_contact_s": row.scores.duration_s},
        "near_contact_s is ",
    ),
}


@pytest.mark.parametrize("records", ["bags and commands", "commands", "tracks"])
@pytest.mark.parametrize("name", FORGERIES)
def test_consistent_forgeries_are_still_detected(collided_copy, name, records):
    changes, words = FORGERIES[name]
    if records != "bags and commands":
        without_bags(collided_copy)
    if records == "tracks":
        (collided_copy / "commands.jsonl").unlink()
        report = check_folder(collided_copy)
        missing = f"{collided_copy}: straight_w0120_r00: its commands are missing"
        reason = "1 trials: not driven again, because their commands are missing"
        assert (report.driven, report.problems) == (0, [missing])
        assert report.unchecked[0].startswith(reason)
    else:
        report = check_folder(collided_copy)
        assert (report.driven, report.problems, report.unchecked) == (1, [], [])
    if callable(changes):
        changes = changes(barn.load(collided_copy).trials[0])
    forge(collided_copy, **changes)
    require_problems(collided_copy, words)


def test_a_failure_does_not_become_the_environments(collided_copy):
    """Such a trial would not be scored, and be driven again."""
    folder = without_bags(collided_copy)
    forge(folder, outcome="environment_failed", fault="environment")
    require_problems(folder, "outcome is 'environment_failed' in the row")


def test_a_bag_that_its_commands_do_not_give_is_rejected(collided_copy):
    row = barn.load(collided_copy).trials[0]
    (bag,) = (collided_copy / "bags").iterdir()

    def shifted(message):
        if message.topic != GROUND_TRUTH.path:
            return message.data
        true = decode.odometry(message.data)
        moved = replace(true, pose=replace(true.pose, x=true.pose.x + 0.002))
        return OdometryEncoder("map", "base_link").encode(moved, true.stamp_ns)

    rewrite_bag(bag, shifted, row.repeatable())
    problems = check_folder(collided_copy).problems
    (problem,) = (line for line in problems if "give a different trajectory" in line)
    assert problem.endswith(
        "its commands, driven again, give a different trajectory from 0.00 s on, up to 0.002 m away"
    )


def test_an_outcome_that_differs_is_named_by_its_value(collided):
    row = barn.load(collided).trials[0]
    content = row.repeatable() | {"outcome": Outcome.TIMEOUT}
    assert list(find_difference(row, content, "now")) == [
        "outcome is 'collision' in the row, 'timeout' now"
    ]


def test_so_many_trials_are_driven_again_as_are_asked_for(driven, command):
    code, out, _ = command(f"check {driven} --sample 1")
    assert (code, out) == (0, SAID.replace("2 driven", "1 driven"))
