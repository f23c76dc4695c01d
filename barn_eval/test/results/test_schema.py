"""The schema of results: its number rises with its keys, and older folders are read."""

import dataclasses
import hashlib
import json
import shutil
import typing
from pathlib import Path

import pytest
from forgery import replace_text
from planners import SHORT
from report_work import rewrite_rows

import barn_eval as barn
from barn_eval.results.folder import read_results
from barn_eval.results.run_file import RunFile
from barn_eval.trials.result import SCHEMA_VERSION, TrialResult
from barn_eval.trials.run_config import ExecutionConfig, RunConfig
from barn_worlds.base.errors import ConfigError

# Hash of all keys of rows and run.json by schema. Where the keys have changed, raise
# SCHEMA_VERSION in barn_eval.trials.result and add its hash; hashes never change.
KEYS = {3: "3aeb0a197f8b"}
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


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("schema") / "out"
    return barn.run(
        "0,120", "gap", SHORT, out=out, engine="inline", progress=False
    ).folder


@pytest.fixture
def folder(run, tmp_path):
    return Path(shutil.copytree(run, tmp_path / "out"))


def test_keys_that_change_raise_the_schema(run):
    content = json.loads((run / "run.json").read_text())
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
    content = json.loads((folder / "run.json").read_text())
    content["schema_version"] = 2
    del content["code_versions"]
    del content["experiment"]["ros"]["isolate"]
    for session in content["sessions"]:
        session["commit"] = OLD_COMMIT
    (folder / "run.json").write_text(json.dumps(content))
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


def test_an_older_folder_is_compared_and_reported(folder, command, tmp_path):
    make_old(folder)
    assert command("report", folder, "--out", tmp_path / "report.html")[0] == 0
    code, _, err = command("compare", folder, folder)
    assert (code, err) == (0, "")
    assert barn.load(folder).summary["trials"].tolist() == [2]


def test_the_check_of_an_honest_older_folder_finds_nothing_wrong(folder):
    report = barn.results.check(make_old(folder))
    assert report.problems == []
    assert report.unchecked[0].startswith("2 trials: not driven again, as their")


def test_what_another_version_computes_is_not_called_wrong(folder):
    def change(row):
        row["measures"]["rms_jerk_mps3"] = 5.0
        row["scores"]["challenge"] = 0.4

    make_old(folder, change)
    report = barn.results.check(folder)
    assert report.problems == []
    said = "2 trials: differ from what this version computes"
    (line,) = (line for line in report.unchecked if line.startswith(said))
    assert "(written at e6873c24, this is " in line


@pytest.mark.parametrize(
    ("change", "words"),
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
    with pytest.raises(ConfigError, match="missing key 'scores"):
        read_results(folder)


def test_run_json_cannot_pass_for_another_task(folder):
    content = json.loads((folder / "run.json").read_text())
    expected = RunFile.read(folder).task_fingerprint
    content["code_versions"]["protocol"] = {"name": "another"}
    (folder / "run.json").write_text(json.dumps(content))
    assert RunFile.read(folder).task_fingerprint == expected
    content["robot"] = "0" * 64
    (folder / "run.json").write_text(json.dumps(content))
    task = RunFile.read(folder).task_fingerprint
    rewrite_rows(folder, lambda rows: [row | {"task": task} for row in rows])
    report = barn.results.check(folder)
    assert f"run.json: describes task {task}, which is {expected} here" in (
        "\n".join(report.problems + report.unchecked)
    )


def test_the_commit_in_a_message_is_a_commit(folder, rejected):
    content = json.loads((folder / "run.json").read_text())
    content["sessions"][0]["commit"] = "0+\nerror: \x1b[2J"
    content["schema_version"] = 9
    (folder / "run.json").write_text(json.dumps(content))
    assert "(written at an unknown commit, this is " in rejected("check", folder)


def test_what_is_damaged_is_wrong_in_an_older_folder_as_well(folder):
    make_old(folder)
    replace_text(folder / "results.jsonl", "success", "Success")
    assert any(
        "damaged or edited" in line for line in barn.results.check(folder).problems
    )


def test_settings_of_ros_are_no_identity_in_mode_direct(folder):
    content = json.loads((folder / "run.json").read_text())
    content["schema_version"] = 2
    del content["experiment"]["ros"]["isolate"]
    (folder / "run.json").write_text(json.dumps(content))

    def write(rows):
        rows[0]["schema_version"] = 2
        return rows[:1]

    rewrite_rows(folder, write)
    results = barn.run(
        "0,120", "gap", SHORT, out=folder, engine="inline", progress=False
    )
    assert [row.schema_version for row in results.trials] == [2, 3]
    assert RunFile.read(folder).schema_version == SCHEMA_VERSION
    report = barn.results.check(folder)
    assert (report.problems, report.driven) == ([], 2)


def test_results_of_another_physics_are_not_mixed(folder, rejected):
    rewrite_rows(make_old(folder), lambda rows: rows[:1])
    with pytest.raises(ConfigError, match="physics is not set there, 1 here") as error:
        barn.run("0,120", "gap", SHORT, out=folder, engine="inline", progress=False)
    assert "(written at e6873c24, this is " in str(error.value)


def test_another_configuration_is_refused_with_the_commits(folder, rejected):
    make_old(folder)
    error = rejected(
        "run", "--planner", "gap", "--worlds", "0,120", "--seed", 8, "--out", folder
    )
    assert "protocol.name is 'short' there, 'challenge' here" in error
    assert "(written at e6873c24, this is " in error


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"schema_version": 2', '"schema_version": 9', "schema_version must be 2 or 3"),
        ('"isolate"', '"isolated"', "unknown key 'ros.isolated'"),
    ],
)
def test_a_folder_that_cannot_be_read_is_named_with_its_commit(
    folder, rejected, old, new, words
):
    content = json.loads((folder / "run.json").read_text())
    content["sessions"][0]["commit"] = OLD_COMMIT
    content["schema_version"] = 2
    (folder / "run.json").write_text(json.dumps(content))
    replace_text(folder / "run.json", old, new)
    error = rejected("check", folder)
    assert words in error
    assert "(written at e6873c24, this is " in error


def test_a_row_that_cannot_be_read_is_named_with_its_commit(folder, rejected):
    make_old(folder, lambda row: row.pop("outcome"))
    error = rejected("compare", folder, folder)
    assert "results.jsonl, line 1: missing key 'outcome' (written at e6873c24" in error
