"""Systems that the suite observes: their task, rows, contacts and boards."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from forgery import edit_run
from planners import spec_of
from refusals import refused
from report_work import rewrite_rows

from barn_eval.analysis.leaderboard import make_boards
from barn_eval.results.folder import read_results
from barn_eval.results.rows import results_table, write_tables
from barn_eval.results.run_file import RunFile
from barn_eval.trials.result import Outcome
from barn_eval.trials.run_config import PlannerChoice, RunConfig
from barn_eval.trials.system import ObservedTrial, System
from barn_eval.trials.trajectory import TrajectoryLog
from barn_eval.trials.trial import RunningTrial, finish_trial
from barn_eval.verification.check import check_folder
from barn_worlds.base.config import as_dict, from_dict
from barn_worlds.base.errors import ExitCode
from barn_worlds.base.types import Odometry, Pose2D, Velocity2D

ROBOT = System("jackal 42", "robot", "/odom", "odom", "stamps", "none")
CHANGES = [
    {"name": "jackal 43"},
    {"kind": "simulator"},
    {"pose": "/tf:odom.base_link"},
    {"frame": "world"},
    {"clock": "log"},
    {"contact": "operator"},
]


def as_observed(two_trials, folder, system=ROBOT):
    """Copy results and make of them some that were observed in a system."""
    shutil.copytree(two_trials, folder)
    with edit_run(folder) as content:
        content["experiment"] |= {"system": as_dict(system), "mode": "ros"}
    task = RunFile.read(folder).task_fingerprint
    observed = as_dict(ObservedTrial.of(system, "scans", 0.05))

    def write(rows):
        for row in rows:
            row |= {"task": task, "observed": observed, "mode": "ros"}
            row["measures"] |= {"contacts": None, "contact_s": None}
        return rows

    rewrite_rows(folder, write)
    (folder / "commands.jsonl").unlink()
    write_tables(folder, read_results(folder))
    return folder


@pytest.fixture
def folders(two_trials, tmp_path):
    """Results that were driven, and some that were observed by two clocks."""
    as_observed(two_trials, tmp_path / "seen")
    as_observed(two_trials, tmp_path / "log", replace(ROBOT, clock="log"))
    return [two_trials, tmp_path / "seen", tmp_path / "log"]


def test_the_suites_own_configuration_names_no_system():
    config = RunConfig()
    assert "system" not in as_dict(config)
    assert from_dict(RunConfig, as_dict(config), "") == config


@pytest.mark.parametrize("change", CHANGES)
def test_the_task_names_all_of_a_system(change):
    tasks = {
        spec_of(system=system).task
        for system in (System(), ROBOT, replace(ROBOT, **change))
    }
    assert len(tasks) == 3


def test_no_other_system_has_the_name_of_the_suites():
    with refused(
        "name must be|name must not be that of the suite's own simulator, whose kind is"
    ):
        System(kind="robot")


def test_a_speed_cap_that_nobody_states_is_unknown():
    seen = spec_of(system=ROBOT, planner_config="abc")
    assert (seen.speed_cap_mps, seen.least_time_s) == (None, None)
    assert spec_of(planner_config="").speed_cap_mps is None
    assert spec_of(planner_config="abc").speed_cap_mps == 2.0
    choice = PlannerChoice("mine", command="x", max_speed_mps=0.5)
    (declared,) = RunConfig(planners=(choice,), mode="ros", system=ROBOT).trials([0])
    assert declared.speed_cap_mps == 0.5


@pytest.mark.parametrize("contact", ["none", "/bumper"])
def test_contacts_that_nobody_reports_are_unknown_in_rows(contact):
    trial = RunningTrial(spec_of(system=replace(ROBOT, contact=contact)))
    for k in range(3):
        reading = Odometry(k * 10**8, Pose2D(-2.25, 3.0 + k, 1.57), Velocity2D(1.0))
        trial.read(reading, reading, collision=False)
    verdict = trial.referee.fail(Outcome.TIMEOUT, "too slow")
    observed = ObservedTrial.of(trial.spec.system, "world", 0.1)
    row = finish_trial(
        trial.spec, "ros", verdict, trial.log.trajectory(), observed=observed
    ).result
    contacts = (row.measures.contacts, row.measures.contact_s)
    assert contacts == ((None, None) if contact == "none" else (0, 0.0))
    table = results_table([row]).to_pylist()[0]
    assert table["contacts"] == contacts[0]
    assert (table["pose_source"], table["time_uncertainty_s"]) == ("/odom", 0.1)


def test_clearances_as_measured_are_those_of_the_row():
    spec = spec_of(system=ROBOT)
    log = TrajectoryLog()
    for k in range(4):
        log.reading(Odometry(k * 10**9, Pose2D(-2.25, 3.0, 1.57), Velocity2D()), False)
    measured = np.array([np.nan, 0.3, 0.05, np.nan])
    trajectory = replace(log.trajectory(), clearance_m=measured)
    verdict = RunningTrial(spec).referee.fail(Outcome.TIMEOUT, "")
    measures = finish_trial(spec, "ros", verdict, trajectory).result.measures
    assert (measures.min_clearance_m, measures.near_contact_s) == (0.05, 1.0)
    unknown = replace(trajectory, clearance_m=np.full(4, np.nan))
    measures = finish_trial(spec, "ros", verdict, unknown).result.measures
    assert (measures.min_clearance_m, measures.near_contact_s) == (None, None)


def test_systems_are_neither_compared_nor_ranked_together(folders, rejected, printed):
    driven, seen, log = folders
    for other in (driven, log):
        error = rejected(f"compare {seen} {other}")
        assert "different systems cannot be compared: " in error
    assert rejected(f"report {seen} {log} --out page.html") == error
    boards = make_boards(folders)
    assert len(boards) == 3
    titles = [board.title for board in boards if "observed, not driven" in board.title]
    assert ["clock log" in title for title in titles] == [True, False]
    (comparison,) = printed(f"compare {seen} {seen}")
    assert any("jackal 42 were observed" in note for note in comparison["notes"])


def test_check_says_that_observed_trials_are_not_driven_again(folders):
    check = check_folder(folders[1])
    assert "2 trials: observed, not driven again (jackal 42)" in check.unchecked
    assert check.driven == 0


def test_what_was_observed_is_not_submitted(folders, rejected):
    error = rejected(f"submit {folders[1]}", ends=ExitCode.FINDINGS)
    assert "observed, not driven again" in error


def test_an_observed_folder_is_read_as_it_was_written(folders):
    rows = read_results(Path(folders[1]))
    assert {row.observed for row in rows} == {ObservedTrial.of(ROBOT, "scans", 0.05)}
