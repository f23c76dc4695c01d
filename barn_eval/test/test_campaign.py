"""Campaigns run as a user runs them, undisturbed and under faults: the same table in the end."""

import csv
import json
import os
import signal
import subprocess
import sys

import campaign_runs as runs
import pyarrow.parquet
import pytest

from barn_eval.campaign.folder import read_results


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """An undisturbed campaign of one worker: its file, its folder and what was printed."""
    folder = tmp_path_factory.mktemp("whole")
    file = runs.write_campaign(folder)
    done = runs.run(file, "--out", folder / "out", "--workers", 1)
    assert done.returncode == 0, done.stderr
    return file, folder / "out", done


def same_table(whole, out):
    assert runs.tables(out) == runs.tables(whole[1])
    assert runs.rows(out) == 12


def test_one_row_per_trial_in_the_order_of_the_plan(whole):
    table = pyarrow.parquet.read_table(whole[1] / "results.parquet").to_pylist()
    assert [row["trial_id"] for row in table] == [
        f"{planner}_w{world:04d}_r{repetition:02d}"
        for world in (0, 100, 200)
        for repetition in (0, 1)
        for planner in ("gap", "eband")
    ]
    with (whole[1] / "results.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["trial_id"] for row in rows] == [row["trial_id"] for row in table]
    for text, row in zip(rows, table, strict=True):
        assert float(text["duration_s"]) == row["duration_s"]
    outcomes = {row["outcome"] for row in table}
    assert outcomes <= {"success", "collision", "timeout"}
    assert all(row["driven_m"] > 0.5 for row in table)


def test_planners_meet_the_same_noise(whole):
    table = read_results(whole[1])
    seeds = {}
    for row in table:
        seeds.setdefault((row.world, row.repetition), set()).add(row.simulator_seed)
    assert all(len(found) == 1 for found in seeds.values())
    assert len(set.union(*seeds.values())) == 6
    assert len({row.planner_seed for row in table}) == 12


def test_wall_clock_figures_are_kept_apart(whole):
    timing = pyarrow.parquet.read_table(whole[1] / "timing.parquet").to_pylist()
    results = pyarrow.parquet.read_table(whole[1] / "results.parquet").column_names
    assert len(timing) == 12
    for row in timing:
        assert row["worker"] == "local-0"
        assert row["attempts"] == 1
        assert row["started_at"].endswith("+00:00")
        assert 0.0 < row["compute_p50_ms"] <= row["compute_p95_ms"] <= row["compute_max_ms"]
    assert not {"started_at", "worker", "compute_p50_ms", "missed_cycles", "real_time_factor"} & set(results)


def test_configuration_versions_and_machine_are_beside_the_table(whole):
    content = json.loads((whole[1] / "run.json").read_text())
    assert content["campaign"]["seed"] == 5
    assert content["campaign"]["protocol"]["limit_s"] == 5.0
    assert content["campaign"]["simulator"]["control_period_s"] == 0.05
    assert [planner["name"] for planner in content["campaign"]["planners"]] == ["gap", "eband"]
    assert list(content["worlds"]) == ["0", "100", "200"]
    (session,) = content["sessions"]
    assert session["execution"]["workers"] == 1
    assert session["versions"]["numpy"]
    assert session["machine"]["cores"] == os.cpu_count()


def test_progress_is_lines_where_nobody_watches(whole):
    last = whole[2].stderr.splitlines()[-2]
    assert last.startswith("12/12 trials, ")
    assert " x real time, in 0:00:" in last
    assert "\x1b" not in whole[2].stderr


def test_more_workers_give_the_same_bytes(whole, tmp_path):
    done = runs.run(whole[0], "--out", tmp_path / "out", "--workers", 3)
    assert done.returncode == 0, done.stderr
    same_table(whole, tmp_path / "out")


def test_running_it_again_runs_nothing(whole):
    before = (whole[1] / "results.jsonl").read_bytes()
    done = runs.run(whole[0], "--out", whole[1], "--json")
    assert done.returncode == 0
    assert (whole[1] / "results.jsonl").read_bytes() == before
    summary = json.loads(done.stdout)
    assert [one["planner"] for one in summary["planners"]] == ["gap", "eband"]
    assert summary["comparisons"][0]["rows"][0]["paired"]["trials"] == 6


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_a_campaign_that_is_ended_goes_on_to_the_same_table(whole, tmp_path, number):
    out = tmp_path / "out"
    campaign = runs.start(whole[0], "--out", out, "--workers", 2)
    runs.until(lambda: runs.rows(out) >= 3 or campaign.poll() is not None)
    workers = runs.children(campaign.pid)
    campaign.send_signal(number) if number != signal.SIGINT else runs.kill_group(campaign)
    _, errors = campaign.communicate(timeout=60)
    kept = runs.rows(out)
    assert 3 <= kept < 12
    assert not (out / "results.parquet").exists()
    assert len(workers) == 2
    runs.until(lambda: not any(map(runs.alive, workers)))
    if number != signal.SIGKILL:
        assert campaign.returncode == 130
        assert f"finished trials are in {out}, the same command goes on" in " ".join(errors.split())
        assert "Traceback" not in errors
    done = runs.run(whole[0], "--out", out, "--workers", 2)
    assert f"{kept} of 12 trials are there already" in done.stderr
    same_table(whole, out)
    assert len(json.loads((out / "run.json").read_text())["sessions"]) == 2


def test_killed_workers_are_replaced(whole, tmp_path):
    out = tmp_path / "out"
    campaign = runs.start(whole[0], "--out", out, "--workers", 2)
    for count in (1, 4, 7):
        runs.until(lambda count=count: runs.rows(out) >= count)
        for pid in runs.children(campaign.pid):
            os.kill(pid, signal.SIGKILL)
    _, errors = campaign.communicate(timeout=120)
    assert campaign.returncode == 0, errors
    assert "lost, its worker process was killed by SIGKILL" in errors
    same_table(whole, out)
    assert max(row.wall_clock.attempts for row in read_results(out)) > 1
    assert any((out / "losses").iterdir())


LIMITED = """
import resource, signal, sys
from barn_eval.cli import main
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv.pop(1)), resource.RLIM_INFINITY))
    main()
"""


def test_a_file_that_cannot_grow_ends_the_campaign_in_one_line_and_nothing_is_lost(whole, tmp_path):
    script, out = tmp_path / "limited.py", tmp_path / "out"
    script.write_text(LIMITED)
    arguments = ["campaign", str(whole[0]), "--out", str(out), "--workers", "2"]
    # Room for run.json and for some rows.
    limit = (whole[1] / "run.json").stat().st_size + 1000
    limited = subprocess.run(
        [sys.executable, str(script), str(limit), *arguments], capture_output=True, text=True, timeout=120
    )
    assert limited.returncode == 1
    kept = runs.rows(out)
    assert 1 <= kept < 12
    assert (out / "results.jsonl").read_bytes().endswith(b"\n")
    (line,) = [line for line in limited.stderr.splitlines() if line.startswith("error:")]
    assert "results.jsonl: cannot be written: File too large" in line
    assert "Traceback" not in limited.stderr
    assert runs.run(whole[0], "--out", out, "--workers", 2).returncode == 0
    same_table(whole, out)


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 64 kB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "barn-test", str(folder)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("cannot mount a small file system here (needs root)")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def test_a_full_disk_ends_the_campaign_in_one_line_and_nothing_is_lost(whole, small_disk):
    out, filler = small_disk / "out", small_disk / "filler"
    filler.write_bytes(bytes(44 * 1024))
    full = runs.run(whole[0], "--out", out, "--workers", 2)
    assert full.returncode == 1
    assert "No space left on device" in full.stderr
    assert full.stderr.count("error:") == 1
    kept = runs.rows(out)
    assert kept >= 1
    filler.unlink()
    done = runs.run(whole[0], "--out", out, "--workers", 2)
    assert done.returncode == 0, done.stderr
    same_table(whole, out)


@pytest.mark.parametrize("where", ["file/out", "/proc/out"])
def test_a_folder_that_cannot_be_written_is_named(whole, tmp_path, where):
    (tmp_path / "file").touch()
    out = tmp_path / where
    done = runs.run(whole[0], "--out", out)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"error: {out}: ")
    assert "cannot be written" in line


def test_another_configuration_is_refused_by_the_key_that_differs(whole):
    before = {path.name: path.read_bytes() for path in whole[1].iterdir() if path.is_file()}
    for options, words in (
        (["--seed", 6], "seed is 5 there, 6 here"),
        (["--repetitions", 3], "repetitions is 2 there, 3 here"),
        (["--protocol", "challenge"], "protocol.name is 'short' there, 'challenge' here"),
        (["--planners", "gap"], "planners.1.name is 'eband' there, not set here"),
        (["--set", "eband.cycle_s=0.1"], "planners.1.overrides.cycle_s is not set there, 0.1 here"),
        (["--sim", "lidar.beams=360"], "simulator.lidar.beams is 720 there, 360 here"),
        (["--worlds", "0,100"], "worlds is '0,100,200' there, '0,100' here"),
    ):
        done = runs.run(whole[0], "--out", whole[1], *options)
        assert done.returncode == 1
        assert words in done.stderr or ("--set" in options and "unknown parameter" in done.stderr), done.stderr
    assert {path.name: path.read_bytes() for path in whole[1].iterdir() if path.is_file()} == before


def test_two_processes_do_not_share_a_folder(whole, tmp_path):
    out = tmp_path / "out"
    campaign = runs.start(whole[0], "--out", out, "--workers", 1)
    runs.until(lambda: runs.rows(out) >= 1)
    second = runs.run(whole[0], "--out", out)
    assert second.returncode == 1
    assert second.stderr == f"error: {out}: another process is working on this campaign\n"
    campaign.communicate(timeout=60)
    same_table(whole, out)


def test_a_folder_of_something_else_is_left_alone(whole, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("chapter")
    done = runs.run(whole[0], "--out", tmp_path / "out")
    assert done.returncode == 1
    assert "is not empty and holds no campaign" in done.stderr
    assert (tmp_path / "out" / "thesis.tex").read_text() == "chapter"


def test_bags_of_failures_only(whole, tmp_path):
    out = tmp_path / "out"
    options = ["--worlds", "0", "--planners", "gap", "--workers", 1]
    done = runs.run(whole[0], "--out", out, "--bags", "failed", *options)
    assert done.returncode == 0, done.stderr
    failed = {row.trial_id for row in read_results(out) if not row.scores.success}
    found = {path.name for path in (out / "bags").iterdir()} if (out / "bags").exists() else set()
    assert found == failed
    done = runs.run(whole[0], "--out", tmp_path / "all", "--bags", "all", *options)
    assert {path.name for path in (tmp_path / "all" / "bags").iterdir()} == {"gap_w0000_r00", "gap_w0000_r01"}
    assert runs.tables(out) == runs.tables(tmp_path / "all")
