"""Campaigns run as a user runs them, undisturbed and under faults.

The same table in the end.
"""

import json
import os
import re
import shutil
import signal
import subprocess
from itertools import product

import campaign_runs as runs
import pyarrow.parquet
import pytest
import yaml
from forgery import edit_run
from refusals import refused
from text_tables import answers_of
from waiting import alive, until

from barn_eval.results.folder import read_results
from barn_eval.ros.work import run_request
from barn_eval.running.reporting import Reporter
from barn_eval.running.request import read_request
from barn_worlds.base.errors import ExitCode


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A campaign of one worker: its file and its folder."""
    folder = tmp_path_factory.mktemp("whole")
    file = runs.write_campaign(folder)
    code, errors = runs.run(file, f"--out {folder}/out --workers 1")
    assert code == 0, errors
    return file, folder / "out"


def same_table(whole, out):
    assert runs.tables(out) == runs.tables(whole[1])
    assert runs.rows(out) == 12


def test_one_row_per_trial_in_the_order_of_the_plan(whole):
    table = pyarrow.parquet.read_table(whole[1] / "results.parquet").to_pylist()
    planned = product(runs.STATIC["worlds"], (0, 1), ("gap", "stranger"))
    names = [
        f"{planner}_w{world:04d}_r{repetition:02d}"
        for world, repetition, planner in planned
    ]
    assert [row["trial_id"] for row in table] == names
    assert {row["outcome"] for row in table} <= {"success", "collision", "timeout"}
    assert all(row["driven_m"] > 0.5 for row in table)


@pytest.mark.parametrize(
    "number",
    [signal.SIGHUP, signal.SIGQUIT, signal.SIGTERM],
    ids=lambda signal_number: signal_number.name,
)
def test_a_signal_ends_a_campaign_with_a_word(whole, tmp_path, number):
    out = tmp_path / "out"
    # tests that are run in the background may have it ignored
    before = signal.signal(number, signal.SIG_DFL)
    campaign = runs.start(whole[0], f"--out {out} --workers 2")
    signal.signal(number, before)
    until(lambda: runs.rows(out) >= 1)
    os.killpg(campaign.pid, number)  # as a terminal does
    _, errors = campaign.communicate(timeout=600)
    assert campaign.returncode == 130
    assert f"finished trials are in {out}, and the same command resumes" in " ".join(
        errors.split()
    )
    assert "Traceback" not in errors
    assert "lost" not in errors


def test_an_interrupted_run_resumes_to_the_same_table(whole, tmp_path):
    out = tmp_path / "out"
    rows_before = 0
    for number in (signal.SIGKILL, signal.SIGINT):
        campaign = runs.start(whole[0], f"--out {out} --workers 2")
        until(lambda rows_before=rows_before: runs.rows(out) >= rows_before + 2)
        workers = runs.children(campaign.pid)
        runs.stop(campaign, number)
        _, errors = campaign.communicate(timeout=600)
        assert len(workers) == 2
        until(lambda workers=workers: not any(map(alive, workers)))
        assert runs.rows(out) >= rows_before + 2
        assert not (out / "results.parquet").exists()
        if rows_before:
            assert f"{rows_before} of 12 trials are already there" in errors
        if number != signal.SIGKILL:
            assert campaign.returncode == 130
            assert (
                f"finished trials are in {out}, and the same command resumes"
                in " ".join(errors.split())
            )
            assert (
                errors.splitlines()[-1] == "interrupted" and "Traceback" not in errors
            )
        rows_before = runs.rows(out)
    assert rows_before < 12, "the campaign was complete before it could be disturbed"
    assert runs.run(whole[0], f"--out {out} --workers 2")[0] == 0
    same_table(whole, out)
    assert len(json.loads((out / "run.json").read_text())["sessions"]) == 3


def test_killed_workers_do_not_change_the_bytes(whole, tmp_path):
    out = tmp_path / "out"
    # chance may kill the workers at the same trial each time
    options = "--workers 2 --execution attempts=9"
    campaign = runs.start(whole[0], f"--out {out} {options}")
    for count in (1, 4, 7):
        until(lambda count=count: runs.rows(out) >= count)
        for pid in runs.children(campaign.pid):
            os.kill(pid, signal.SIGKILL)
    _, errors = campaign.communicate(timeout=600)
    assert campaign.returncode == 0, errors
    assert "lost: its worker process was killed by SIGKILL" in errors
    same_table(whole, out)
    assert max(row.wall_clock.attempts for row in read_results(out)) > 1
    assert any((out / "losses").iterdir())


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 256 kB, twice what the folder of the whole campaign takes."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=256k", "barn-test", str(folder)]
    if (
        os.geteuid() != 0
        or subprocess.run(mount, check=False, capture_output=True).returncode != 0
    ):
        pytest.skip("cannot mount a small file system here (needs root)")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def test_a_full_disk_is_one_line_and_loses_nothing(whole, small_disk):
    out = small_disk / "out"
    filler = small_disk / "filler"
    filler.write_bytes(bytes(216 * 1024))
    code, errors = runs.run(whole[0], f"--out {out} --workers 2")
    assert code == ExitCode.REFUSED
    assert "No space left on device" in errors
    assert errors.count("error:") == 1
    rows = runs.rows(out)
    assert rows >= 1
    filler.unlink()
    code, errors = runs.run(whole[0], f"--out {out} --workers 2")
    assert code == 0, errors
    same_table(whole, out)


@pytest.fixture
def run_here(whole, monkeypatch):
    """Run the campaign in this process, with options."""
    monkeypatch.syspath_prepend(whole[0].parent)

    def run(settings=None, **options):
        if settings:
            options["settings"] = settings
        return run_request(read_request(whole[0], options), Reporter())

    return run


CHANGES = """
{seed: 6}
    seed is 5 there, 6 here
{repetitions: 3}
    repetitions is 2 there, 3 here
{protocol: challenge}
    protocol.name is 'short' there, 'challenge' here
{planners: gap}
    planners.1.name is 'stranger' there, not set here
{settings: {gap: {max_speed_mps: 0.3}}}
    planners.0.overrides.max_speed_mps is not set there
{simulator: {lidar.beams: 360}}
    simulator.lidar.beams is 720 there, 360 here
{worlds: '0,100'}
    worlds is '0,100,200' there, '0,100' here
{bags: all}
    bags is 'none' there, 'all' here
"""


@pytest.mark.parametrize("options, words", answers_of(CHANGES))
def test_another_configuration_is_refused_by_its_key(whole, run_here, options, words):
    before = {path.name: path.read_bytes() for path in whole[1].iterdir()}
    with refused(
        rf"{whole[1]}: holds results of a different configuration: {re.escape(words)}"
    ):
        run_here(out=whole[1], **yaml.safe_load(options))
    assert {path.name: path.read_bytes() for path in whole[1].iterdir()} == before


def test_worlds_that_have_changed_are_refused(whole, run_here, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(whole[1], out)
    with edit_run(out) as content:
        content["worlds"]["100"] = "0" * 64
    with refused("a different checksum of world: 100 is '0000"):
        run_here(out=out)


def test_bags_are_kept_of_what_was_asked_for(run_here, tmp_path):
    options = {"worlds": "0", "planners": "gap", "engine": "inline"}
    results = run_here(out=tmp_path / "failed", bags="failed", **options)
    failed = {row.trial_id for row in results if not row.scores.success}
    assert {path.name for path in tmp_path.glob("failed/bags/*")} == failed
    run_here(out=tmp_path / "all", bags="all", **options)
    names = {path.name for path in tmp_path.glob("all/bags/*")}
    assert names == {"gap_w0000_r00", "gap_w0000_r01"}
    assert runs.tables(tmp_path / "failed") == runs.tables(tmp_path / "all")
