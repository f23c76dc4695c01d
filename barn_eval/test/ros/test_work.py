"""Campaigns over ROS.

The rows of a direct campaign, and no process that outlives them.
"""

import csv
import os
import signal
from dataclasses import replace
from itertools import product

import campaign_runs as runs
from ros_runs import EXAMPLE, MARK, foreign, marked, node_process, nothing_left  # noqa: F401 (a fixture)
from waiting import until

from barn_eval.results.folder import (
    order_trials_fairly,
    order_worlds_fairly,
    read_results,
)
from barn_eval.results.store import BagStore
from barn_eval.ros.work import RosWork
from barn_eval.running.command_files import read_node_parameters
from barn_eval.trials.run_config import PlannerChoice, RunConfig


def comparable(out):
    """Return the rows of a table without what says how the trials were run."""
    with (out / "results.csv").open() as file:
        return [
            {key: row[key] for key in row if key not in ("mode", "recoveries")}
            for row in csv.DictReader(file)
        ]


def test_a_killed_worker_gives_the_rows_of_a_direct_run(tmp_path):
    first, second, _ = runs.KINDS["moving"]["worlds"]
    choice = {"worlds": f'"{first},{second}"', "planners": "[gap]"}
    file = runs.write_campaign(tmp_path, "moving", **choice)
    assert runs.run(file, f"--out {tmp_path}/direct")[0] == 0
    out = tmp_path / "ros"
    campaign = runs.start(file, f"--mode ros --out {out} --workers 2 --bags all")
    until(lambda: runs.rows(out) >= 1)
    until(lambda: len(node_process(os.environ[MARK], "barn_sim.ros.simulator")) == 2)
    os.kill(runs.children(campaign.pid)[0], signal.SIGKILL)
    _, errors = campaign.communicate(timeout=600)
    assert campaign.returncode == 0, errors
    assert "lost: its worker process was killed by SIGKILL" in errors
    assert comparable(out) == comparable(tmp_path / "direct")
    tracks, expected = (tmp_path / mode / "tracks.jsonl" for mode in ("ros", "direct"))
    assert tracks.read_bytes() == expected.read_bytes()
    names = {path.name for path in (out / "bags").iterdir()}
    assert names == {row.trial_id for row in read_results(out)}
    assert not (out / "shards").exists()


def test_a_campaign_that_is_ended_leaves_no_process_and_goes_on(tmp_path):
    file = runs.write_campaign(tmp_path, worlds='"0"', planners="[gap]", repetitions=3)
    out = tmp_path / "out"
    for number in (signal.SIGKILL, signal.SIGINT):
        rows = runs.rows(out)
        campaign = runs.start(file, f"--mode ros --out {out} --workers 1")
        until(lambda rows=rows: runs.rows(out) > rows)
        runs.stop(campaign, number)
        _, errors = campaign.communicate(timeout=600)
        until(lambda: not marked(os.environ[MARK]))
    assert campaign.returncode == 130
    assert "Traceback" not in errors
    assert runs.rows(out) >= 2
    code, errors = runs.run(file, f"--mode ros --out {out} --workers 1")
    assert code == 0, errors
    assert [row.repetition for row in read_results(out)] == [0, 1, 2]


def test_each_trial_may_have_its_own_planner(tmp_path):
    file = runs.write_campaign(tmp_path, worlds='"0"', planners="[simple]")
    planner = tmp_path / "planner.sh"
    starts = tmp_path / "starts"
    out = tmp_path / "out"
    planner.write_text(f"echo >> {starts}\nexec {foreign(EXAMPLE)}\n")
    options = f"--planner-command 'sh {planner}' --ros restart_planner=each_trial"
    code, errors = runs.run(file, f"--mode ros {options} --workers 1 --out {out}")
    assert code == 0 and "SIGTERM" not in errors, errors  # its restarts are no news
    assert [row.planner for row in read_results(out)] == ["simple"] * 2
    # one more may be starting as the campaign ends
    assert starts.read_text().count("\n") >= 2
    parameters = read_node_parameters(out, "simple")
    assert parameters["/simple_planner use_sim_time"] == "False"


def test_all_planners_share_worlds_before_the_next_ones(tmp_path):
    planners = tuple(map(PlannerChoice, ("gap", "dwa")))
    experiment = RunConfig(worlds="0-24", planners=planners, repetitions=2, mode="ros")
    trials = order_trials_fairly(experiment.trials())
    jobs = RosWork(experiment, BagStore(tmp_path), 1).jobs(trials)
    names = product(range(3), ("gap", "dwa"))
    assert [job.key for job in jobs] == [f"{name}/{part}" for part, name in names]
    worlds = [{spec.world_number for spec in job.trials} for job in jobs]
    assert [len(part) for part in worlds] == [10, 10, 10, 10, 5, 5]
    assert worlds[0] == worlds[1] == set(order_worlds_fairly(range(25))[:10])
    names = sorted(spec.trial_id for job in jobs for spec in job.trials)
    assert names == sorted(spec.trial_id for spec in trials)
    alone = replace(experiment, planners=planners[:1])
    trials = order_trials_fairly(alone.trials())
    jobs = RosWork(alone, BagStore(tmp_path), 2).jobs(trials)
    assert [job.key for job in jobs] == ["gap_0", "gap_1"]
