"""The tools that measure endurance.

A few kill points as they are, and that what they measure can come out badly.

`python qa/faults/kill_points.py` and `python qa/faults/long_run.py` go on for longer.
"""

import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys

import kill_points
import long_run
import numpy as np
import processes
import pytest
from repository import ROOT
from text_tables import answers_of
from waiting import run_python


def test_campaigns_resume_after_a_kill_to_the_same_tables():
    # mode direct is killed by test_run.py as well
    mode = "ros" if importlib.util.find_spec("rclpy") else "direct"
    tool = ROOT / "qa" / "faults" / "kill_points.py"
    options = ("--json", "--points=1", "--seed=4", f"--mode={mode}")
    ended = run_python(tool, *options, check=False)
    assert ended.returncode == 0, ended.stderr + ended.stdout
    points = json.loads(ended.stdout)["points"]
    assert [point["mode"] for point in points] == [mode]
    assert all(point["equal"] and not point["problems"] for point in points)


def test_the_same_seed_gives_the_same_points():
    durations_s = {"direct": 10.0, "ros": 20.0}

    def draw(seed):
        return kill_points.draw_points(20, seed, ["direct", "ros"], durations_s)

    points = draw(1)
    assert points == draw(1) != draw(2)
    for point in points:
        assert point.role in kill_points.ROLES["ros"]
        assert 0.0 <= point.at_s <= durations_s[point.mode]


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    """A complete campaign in mode direct, with its bags."""
    folder = tmp_path_factory.mktemp("complete")
    (folder / "near.yaml").write_text(
        "schema_version: 1\nbase: challenge\nname: near\ngoal: {y_m: 2.0}\n"
    )
    options = "--worlds=0 --planners=gap --repetitions=2 --bags=all --workers=1"
    paths = f"--protocol={folder}/near.yaml --out={folder}/out"
    run_python("-m", "barn_eval", "campaign", *options.split(), *paths.split())
    return folder / "out"


@pytest.mark.parametrize(
    "name, change, complaint",
    [
        (
            "results.csv",
            lambda content: content.replace(b"success", b"timeout", 1),
            "results.csv is not that",
        ),
        ("results.parquet", lambda content: content[:-1], "results.parquet"),
        ("tracks.jsonl", lambda content: content + content, "tracks.jsonl is not that"),
        (
            "commands.jsonl",
            lambda content: content[: content.index(b"\n") + 1],
            "commands.jsonl is not that",
        ),
        (
            "bags/gap_w0000_r00/metadata.yaml",
            lambda content: content + b"\n",
            "metadata.yaml is not that",
        ),
        (
            "results.jsonl",
            lambda content: content.replace(b'"success"', b'"timeout"', 1),
            "crc32",
        ),
    ],
)
def test_a_campaign_that_differs_is_not_equal(
    complete, tmp_path, name, change, complaint
):
    out = shutil.copytree(complete, tmp_path / "out")
    point = kill_points.Point("direct", "worker", 1.0)
    assert kill_points.compare_folders(point, out, complete).equal
    (out / name).write_bytes(change((out / name).read_bytes()))
    problems = kill_points.compare_folders(point, out, complete).problems
    assert complaint in " ".join(problems)


def test_what_grows_is_not_flat():
    trials = np.arange(1, 2001)
    noise = np.random.default_rng(1).normal(0.0, 1.0, len(trials))

    def growth(name, values):
        return long_run.growth(f"all.{name}", trials, values)

    steady = growth("anonymous_mb", 200.0 + noise)
    assert steady.flat
    assert abs(steady.per_1000) < steady.uncertainty * 2
    leaking = growth("anonymous_mb", 200.0 + noise + 0.02 * trials)
    assert not leaking.flat
    assert leaking.per_1000 == pytest.approx(20.0, abs=3 * leaking.uncertainty)
    assert not growth("handles", 20.0 + np.floor(trials / 500)).flat
    assert growth("handles", np.full(len(trials), 20.0)).flat
    # nothing can be told
    assert not growth("anonymous_mb", 200.0 + 100.0 * noise).flat
    with pytest.raises(ValueError, match="at least 20"):
        long_run.growth("all.handles", trials[:10], trials[:10])


def test_processes_are_found_by_their_mark_and_measured(tmp_path):
    code = f"import threading, time; f = open({str(tmp_path / 'x')!r}, 'w')\n"
    code += "threading.Thread(target=time.sleep, args=(600,), daemon=True).start()\nprint('up', flush=True)\n"
    code += "time.sleep(600)"
    environment = processes.environment(tmp_path.name, tmp_path / "tmp")
    with subprocess.Popen(
        [sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE
    ) as process:
        try:
            assert process.stdout.readline() == b"up\n"
            (marked_process,) = processes.list_marked(tmp_path.name)
            assert (marked_process.pid, marked_process.role) == (process.pid, "other")
            used = processes.usage(marked_process)
            assert used.threads == 2
            assert used.handles == len(os.listdir(f"/proc/{process.pid}/fd"))  # noqa: PTH208
            assert 0 < used.anonymous_bytes <= used.rss_bytes
            (tmp_path / "tmp" / "left").touch()
            taken = long_run.sample(7, tmp_path.name, set(), tmp_path / "tmp")
            assert (taken["trials"], taken["temporary_files"]) == (7, 1)
            assert taken["all.threads"] == 2
            assert processes.wait_for_end(tmp_path.name, 0.0) == [marked_process]
        finally:
            process.send_signal(signal.SIGKILL)
    assert processes.wait_for_end(tmp_path.name, 10.0) == []
    assert processes.usage(marked_process) == processes.Usage()


ROLES = """
python -m barn_eval campaign --worlds=0
    campaign
python -P -m barn_eval.running.worker 5 local-0
    worker
python -I -S /a/supervision/launcher.py 7 -- python start.py barn_sim.ros.simulator:main
    guard
python /a/supervision/start.py barn_sim.ros.simulator:main --ros-args
    simulator
python /a/supervision/start.py barn_planners.ros.planner:main
    planner
python /a/supervision/start.py barn_eval.ros.evaluator:main
    evaluator
sleep 600
    other
"""


@pytest.mark.parametrize("line, role", answers_of(ROLES))
def test_roles_are_told_by_the_command_line(line, role):
    assert processes.role(line.split()) == role
