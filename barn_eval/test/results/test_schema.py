"""The schema of results: its number rises with its keys, and older folders are read."""

import dataclasses
import hashlib
import json
import typing

import pytest
import yaml
from forgery import edit_run, forge, replace_text
from planners import run_inline
from refusals import refused
from report_work import rewrite_rows

import barn_eval as barn
from barn_eval.results.folder import read_results
from barn_eval.results.run_file import RunFile
from barn_eval.trials.result import SCHEMA_VERSION, TrialResult
from barn_eval.trials.run_config import ExecutionConfig, RunConfig
from barn_worlds.base.errors import ExitCode

# Hash of all keys of rows and run.json by schema. Where the keys have changed, raise
# SCHEMA_VERSION in barn_eval.trials.result and add its hash; hashes never change.
KEYS = {
    3: "3aeb0a197f8b",
    4: "c37d5a1dc0b1",
    5: "fc37fd429791",
    6: "c49247c345d4",
    7: "1c40f2d7cfdc",
}
OLD_COMMIT = "e6873c242548648c72791920b5b6a5142efb4960"


def keys_of(record, prefix=""):
    """Yield the dotted names of a dataclass's fields, nested ones included."""
    hints = typing.get_type_hints(record)
    for field in dataclasses.fields(record):
        name = f"{prefix}{field.name}"
        yield name
        for kind in (hints[field.name], *typing.get_args(hints[field.name])):
            if dataclasses.is_dataclass(kind):
                yield from keys_of(kind, f"{name}.")


def test_keys_that_change_raise_the_schema(two_trials):
    content = json.loads((two_trials / "run.json").read_text())
    (session,) = content["sessions"]
    keys = [
        *(f"row.{key}" for key in keys_of(TrialResult)),
        *(f"run.{key}" for key in content),
        *(f"experiment.{key}" for key in keys_of(RunConfig)),
        *(f"session.{key}" for key in (*session, "isolation")),
        *(f"execution.{key}" for key in keys_of(ExecutionConfig)),
    ]
    digest = hashlib.sha256("\n".join(sorted(keys)).encode()).hexdigest()[:12]
    assert content["schema_version"] == SCHEMA_VERSION
    assert KEYS[SCHEMA_VERSION] == digest


def make_old(folder, change=lambda row: None):
    """Make of a folder one that an earlier commit wrote: without newer keys."""
    with edit_run(folder) as content:
        content["schema_version"] = 2
        del content["code_versions"]
        del content["experiment"]["ros"]["isolate"]
        for session in content["sessions"]:
            session["commit"] = OLD_COMMIT
    task = RunFile.read(folder).task_fingerprint

    def write(rows):
        for row in rows:
            row["schema_version"] = 2
            row["task"] = task
            del row["scores"]["failure_time_s"]
            change(row)
        return rows

    rewrite_rows(folder, write)
    (folder / "commands.jsonl").unlink()
    return folder


def test_rows_of_an_older_folder_have_what_they_lack(folder):
    rows = read_results(make_old(folder))
    assert [row.schema_version for row in rows] == [2, 2]
    assert [row.scores.failure_time_s for row in rows] == [100.0, 100.0]


def test_an_older_folder_is_compared_and_reported(folder, command, succeed):
    make_old(folder)
    succeed(f"report {folder} --out report.html")
    code, _, err = command(f"compare {folder} {folder}")
    assert (code, err) == (0, "")
    assert barn.load(folder).summary["trials"].tolist() == [2]


def test_the_check_of_an_honest_older_folder_finds_nothing_wrong(folder):
    report = barn.results.check(make_old(folder))
    assert report.problems == []
    assert report.unchecked[0].startswith("2 trials: not driven again, because their")


def test_what_another_version_computes_is_not_called_wrong(folder):
    def change(row):
        row["measures"]["rms_jerk_mps3"] = 5.0
        row["scores"]["challenge"] = 0.4

    make_old(folder, change)
    report = barn.results.check(folder)
    assert report.problems == []
    said = "2 trials: differ from what this version computes"
    (line,) = (line for line in report.unchecked if line.startswith(said))
    assert "the first is gap_w0000_r00: scores.challenge is 0.4 in the row, " in line
    assert "(written at e6873c24, this is " in line


def test_what_another_version_drove_is_not_submitted(folder, rejected):
    make_old(folder)
    (folder / "commands.jsonl").touch()
    error = rejected(f"submit {folder}", ends=ExitCode.FINDINGS)
    assert "cannot be submitted" in error and "run.json: states task" in error


@pytest.mark.parametrize(
    "change, words",
    [
        ({"task": ""}, "task is '' in the row"),
        ({"schema_version": 2}, "measures.rms_jerk_mps3 is 5.0 in the row"),
        ({"mode": "ros"}, "has mode 'ros', must have 'direct'"),
    ],
)
def test_no_row_excuses_itself_as_an_older_one(folder, change, words):
    def write(rows):
        rows[0]["measures"]["rms_jerk_mps3"] = 5.0
        rows[0] |= change
        return rows

    rewrite_rows(folder, write)
    assert any(words in line for line in barn.results.check(folder).problems)


def test_only_an_older_row_may_lack_a_score(folder):
    def write(rows):
        del rows[0]["scores"]["failure_time_s"]
        return rows

    rewrite_rows(folder, write)
    with refused("missing key 'scores"):
        read_results(folder)


def test_run_json_cannot_pass_for_another_task(folder):
    expected = RunFile.read(folder).task_fingerprint
    with edit_run(folder) as content:
        content["code_versions"]["protocol"] = {"name": "another"}
    assert RunFile.read(folder).task_fingerprint == expected
    with edit_run(folder) as content:
        content["robot"] = "0" * 64
    task = RunFile.read(folder).task_fingerprint
    rewrite_rows(folder, lambda rows: [row | {"task": task} for row in rows])
    report = barn.results.check(folder)
    lines = "\n".join(report.problems + report.unchecked)
    computed = f"but this version computes {expected}"
    assert f"run.json: states task {task}, {computed}" in lines


def set_versions(folder, versions):
    """State code versions in run.json, and in rows the task that it then describes."""
    with edit_run(folder) as content:
        content["code_versions"] = versions
    task = RunFile.read(folder).task_fingerprint
    rewrite_rows(folder, lambda rows: [row | {"task": task} for row in rows])


@pytest.mark.parametrize(
    "versions",
    [{}, {"physics": 0}, {"physics": True}, {"physics": 99}, {"physics": 1, "x": 1}],
)
def test_a_version_that_never_was_excuses_nothing(folder, versions):
    forge(folder, scores__challenge=0.45)
    set_versions(folder, versions)
    problems = barn.results.check(folder).problems
    for words in (
        "belong to no version up to this one",
        "challenge is 0.45 in the row",
    ):
        assert any(words in line for line in problems)


IMPOSSIBLE = """
- [measures, min_clearance_m, 9.0, "m in the track, 9.000 m in the row"]
- [measures, contact_s, 1.0e+6, "measures.contact_s is 1e+06, must"]
- [measures, rms_jerk_mps3, -1.0, "rms_jerk_mps3 is -1, must be 0"]
- [scores, traversal_time_s, 0.5, traversal_time_s is 0.50 in the row]
- [null, planner_seed, 3, "has planner_seed 3, must have"]
"""


@pytest.mark.parametrize("part, key, value, words", yaml.safe_load(IMPOSSIBLE))
def test_no_version_excuses_what_never_can_be(folder, part, key, value, words):
    def change(row):
        (row[part] if part else row)[key] = value

    make_old(folder, change)
    assert any(words in line for line in barn.results.check(folder).problems)


def test_an_older_row_of_another_task_than_run_json_is_named(folder):
    make_old(folder, lambda row: row.update(task="0" * 12))
    words = "was run as task 000000000000, but run.json describes"
    assert any(words in line for line in barn.results.check(folder).problems)


def test_only_another_world_may_be_the_doing_of_a_version(folder):
    make_old(folder, lambda row: row.update(world_checksum="0" * 64))
    report = barn.results.check(folder)
    assert report.problems == []
    assert any("has changed since gap" in line for line in report.unchecked)


def test_tracks_and_commands_are_missing_in_any_version(folder):
    with edit_run(folder) as content:
        content["schema_version"] = 2
    set_versions(folder, {})
    (folder / "commands.jsonl").unlink()
    (folder / "tracks.jsonl").unlink()
    problems = barn.results.check(folder).problems
    for words in ("its commands are missing", "has no track, though the robot drove"):
        assert any(words in line for line in problems)


def test_the_commit_in_a_message_is_a_commit(folder, rejected):
    with edit_run(folder) as content:
        content["sessions"][0]["commit"] = "0+\nerror: \x1b[2J"
        content["schema_version"] = 9
    assert "(written at an unknown commit, this is " in rejected(
        f"check {folder}", ends=ExitCode.FINDINGS
    )


def test_what_is_damaged_is_wrong_in_an_older_folder_as_well(folder):
    make_old(folder)
    replace_text(folder / "results.jsonl", "success", "Success")
    problems = barn.results.check(folder).problems
    assert any("damaged or edited" in line for line in problems)


def test_settings_of_ros_are_no_identity_in_mode_direct(folder):
    with edit_run(folder) as content:
        content["schema_version"] = 2
        del content["experiment"]["ros"]["isolate"]

    def write(rows):
        rows[0]["schema_version"] = 2
        return rows[:1]

    rewrite_rows(folder, write)
    results = run_inline("0,120", out=folder)
    assert [row.schema_version for row in results.trials] == [2, SCHEMA_VERSION]
    assert RunFile.read(folder).schema_version == SCHEMA_VERSION
    report = barn.results.check(folder)
    assert (report.problems, report.driven) == ([], 2)


def test_results_of_another_physics_are_not_mixed(folder):
    rewrite_rows(make_old(folder), lambda rows: rows[:1])
    with refused("physics is not set there, 1 here") as error:
        run_inline("0,120", out=folder)
    assert "(written at e6873c24, this is " in str(error.value)


def test_another_configuration_is_refused_with_the_commits(folder, rejected):
    make_old(folder)
    error = rejected(f"run --planner gap --worlds 0,120 --seed 8 --out {folder}")
    assert "protocol.name is 'short' there, 'challenge' here" in error
    assert "(written at e6873c24, this is " in error


@pytest.mark.parametrize(
    "old, new, words",
    [
        ('"schema_version": 2', '"schema_version": 9', "schema_version must be 2 or 3"),
        ('"isolate"', '"isolated"', "unknown key 'ros.isolated'"),
    ],
)
def test_a_folder_that_cannot_be_read_is_named_with_its_commit(
    folder, rejected, old, new, words
):
    with edit_run(folder) as content:
        content["sessions"][0]["commit"] = OLD_COMMIT
        content["schema_version"] = 2
    replace_text(folder / "run.json", old, new)
    error = rejected(f"check {folder}", ends=ExitCode.FINDINGS)
    assert words in error
    assert "(written at e6873c24, this is " in error


def test_a_row_that_cannot_be_read_is_named_with_its_commit(folder, rejected):
    make_old(folder, lambda row: row.pop("outcome"))
    error = rejected(f"compare {folder} {folder}")
    assert "results.jsonl, line 1: missing key 'outcome' (written at e6873c24" in error
