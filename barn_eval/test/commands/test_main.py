"""The command line: every command runs, and every mistake is one line, exit code 1 and nothing half-written."""

import json
import os
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import Reader

from barn_eval import __version__
from barn_eval.commands.main import COMMANDS
from barn_eval.results.folder import read_results
from barn_eval.results.provenance import commit
from barn_eval.results.run_file import RunFile
from barn_eval.trials.ros_config import RosConfig
from barn_eval.trials.run_config import ExecutionConfig
from barn_sim.config import SimulatorConfig
from barn_worlds.base.config import fields_of
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.formats.dataset_file import write_dataset_file

INLINE = ("--execution", "engine=inline")  # which starts no worker


@pytest.fixture(scope="module")
def tiny(tmp_path_factory, open_world) -> Path:
    """A data set of two worlds."""
    grid = open_world.grid.copy()
    grid[20:25, 10:15] = True
    blocked = replace(open_world, name="blocked", grid=grid)
    path = tmp_path_factory.mktemp("data") / "tiny.npz"
    write_dataset_file(path, "tiny", {0: open_world, 3: blocked})
    return path


def output_and_modules(arguments, **environment):
    """Return what `barn` prints in a process of its own, and the names of the modules that it has loaded."""
    script = (
        "import sys\nfrom barn_eval.commands.main import main\n"
        f"try: main({arguments})\nfinally: print(*sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | environment,
    )
    *lines, loaded = done.stdout.splitlines()
    return lines, set(loaded.split())


def test_help_lists_the_commands_and_imports_none():
    lines, loaded = output_and_modules(["--help"])
    assert all(any(f"  {name} " in line for line in lines) for name in COMMANDS)
    assert (
        not {
            "numpy",
            "numba",
            "matplotlib",
            "rclpy",
            "pybullet",
            "barn_eval.results.run_file",
        }
        & loaded
    )


def test_shell_completion_imports_no_command():
    shell = {"_BARN_COMPLETE": "bash_complete"}
    lines, loaded = output_and_modules(
        [], **shell, COMP_WORDS="barn re", COMP_CWORD="1"
    )
    assert lines == ["plain,report", "plain,replay", "plain,reproduce"]
    assert not {"numpy", "barn_eval.commands.report"} & loaded
    assert output_and_modules(
        [], **shell, COMP_WORDS="barn run --repe", COMP_CWORD="2"
    )[0] == ["plain,--repetitions"]


@pytest.mark.parametrize("name", list(COMMANDS))
def test_every_command_explains_itself(command, name):
    code, out, _ = command(name, "--help")
    assert code == 0
    assert out.startswith(f"Usage: barn {name}")


def test_campaign_is_another_name_of_run(command):
    assert (
        command("campaign", "--help")[1].replace("barn campaign", "barn run")
        == command("run", "--help")[1]
    )
    assert "campaign" not in command("--help")[1]


def test_the_help_lists_the_keys_of_each_group(command):
    help_text = command("run", "--help")[1]
    for config in (SimulatorConfig(), RosConfig(), ExecutionConfig()):
        assert [key for key, _, _ in fields_of(config) if key not in help_text] == []


def test_another_package_adds_a_command(tmp_path):
    metadata = tmp_path / "stranger-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n"
    )
    (metadata / "entry_points.txt").write_text(
        "[barn_eval.commands]\nhello = stranger:hello\n"
    )
    code = (
        "import click\nhello = click.Command('hello', callback=lambda: print('hi'))\n"
    )
    (tmp_path / "stranger.py").write_text(code)
    for arguments, output in ((["hello"], "hi"), (["--help"], "  hello ")):
        lines, loaded = output_and_modules(arguments, PYTHONPATH=str(tmp_path))
        assert any(output in line for line in lines)
        assert ("stranger" in loaded) == (arguments == ["hello"])


def test_version_names_the_commit_that_the_records_name(command, monkeypatch):
    current = commit()
    assert (
        command("--version")[1]
        == f"barn {__version__}" + (f" (commit {current})" if current else "") + "\n"
    )
    monkeypatch.setenv("PATH", "")  # no git
    assert command("--version")[1] == f"barn {__version__}\n"


def test_run(command, tiny, tmp_path):
    run = (
        "run",
        "--dataset",
        tiny,
        "--worlds",
        "0",
        "--protocol",
        "challenge",
        "--repetitions",
        2,
        "--out",
        "run",
    )
    code, out, err = command(*run, "--bags", "all", *INLINE)
    assert code == 0
    assert (
        "[2/2] dwa_w0000_r0" in err and "] dwa_w0000_r01: success" in err
    )  # in either order
    assert "success [%]" in out
    results = read_results(tmp_path / "run")
    assert sorted(result.trial_id for result in results) == [
        "dwa_w0000_r00",
        "dwa_w0000_r01",
    ]
    assert all(
        result.scores.success and result.preset == "challenge" for result in results
    )
    for result in results:
        with Reader(tmp_path / "run" / "bags" / result.trial_id) as reader:
            assert {"/scan", "/cmd_vel", "/plan"} <= set(reader.topics)
    content = json.loads((tmp_path / "run" / "run.json").read_text())
    assert content["experiment"]["protocol"]["limit_s"] == 100.0
    assert {"versions", "commit", "machine"} <= content["sessions"][0].keys()
    assert (tmp_path / "run" / "results.csv").read_text().count("\n") == 3


def test_run_is_completed_and_not_mixed_with_another(command, tiny, tmp_path):
    run = (
        "run",
        "--dataset",
        tiny,
        "--worlds",
        "0",
        "--planner",
        "gap",
        "--out",
        "run",
        *INLINE,
    )
    assert command(*run)[0] == 0
    lines = (tmp_path / "run" / "results.jsonl").read_text()
    code, out, err = command(*run, "--json")
    assert code == 0
    assert "1 of 1 trials are there already" in err
    summary = json.loads(out)
    row = json.loads(lines)
    assert row.pop("crc32")
    assert (
        summary["results"],
        [planner["scores"]["trials"] for planner in summary["planners"]],
    ) == ([row], [1])
    assert command(*run, "--seed", 1, "--overwrite")[0] == 0
    assert [result.campaign_seed for result in read_results(tmp_path / "run")] == [1]


def test_parameters_reach_planner_and_simulator(command, tiny, tmp_path):
    run = (
        "run",
        "--dataset",
        tiny,
        "--worlds",
        "0",
        "--protocol",
        "challenge",
        "--out",
        "run",
        *INLINE,
    )
    assert (
        command(*run, "--set", "dwa.max_speed_mps=0.2", "--sim", "lidar.noise_m=0.0")[0]
        == 0
    )
    experiment = RunFile.read(tmp_path / "run").run_config()
    assert experiment.planners[0].overrides == {"dwa.max_speed_mps": 0.2}
    assert experiment.simulator.lidar.noise_m == 0.0
    assert read_results(tmp_path / "run")[0].measures.mean_speed_mps < 0.21


def test_demo_in_one_process(command, tiny):
    code, out, _ = command(
        "demo", "--dataset", tiny, "--mode", "direct", "--out", "demo", "--json"
    )
    assert code == 0
    assert {result["world"] for result in json.loads(out)["results"]} == {0, 3}


def test_worlds_are_generated_listed_shown_exported_and_imported(command, tmp_path):
    assert command("worlds", "generate", "own.npz", "--per-set", 1, "--seed", 5)[0] == 0
    assert open_dataset(tmp_path / "own.npz").world_numbers == tuple(range(12))
    listed = json.loads(
        command("worlds", "list", "own.npz", "--worlds", "2-3", "--json")[1]
    )
    assert [entry["world"] for entry in listed] == [2, 3]
    assert command("worlds", "list")[0] == command("worlds", "list", "own.npz")[0] == 0
    assert command("show", "own.npz", "--out", "sheet.png")[0] == 0
    assert command("show", 4, "--dataset", "own.npz", "--out", "world.png")[0] == 0
    assert command("show", 4, "--dataset", "own.npz")[0] == 0
    for picture in ("sheet.png", "world.png", "world_4.png"):
        assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")
    original = open_dataset(tmp_path / "own.npz")
    for form in ("sdf", "sdf_classic", "map", "original"):
        assert (
            command(
                "worlds",
                "convert",
                "own.npz",
                form,
                "--format",
                form,
                "--worlds",
                "2,5",
            )[0]
            == 0
        )
        assert command("worlds", "convert", form, f"{form}.npz")[0] == 0
        back = open_dataset(tmp_path / f"{form}.npz")
        assert back.world_numbers == (2, 5)
        np.testing.assert_array_equal(back.load(5).grid, original.load(5).grid)
    assert (
        command(
            "worlds", "convert", "own.npz", "png", "--format", "png", "--worlds", "2"
        )[0]
        == 0
    )
    assert (
        command(
            "worlds", "convert", "own.npz", "some", "--format", "npz", "--worlds", "2"
        )[0]
        == 0
    )
    assert (
        open_dataset(tmp_path / "some.npz").load(2).checksum
        == original.load(2).checksum
    )


def test_one_parameter_set_of_ones_own(command, tmp_path):
    words = (
        "worlds",
        "generate",
        "layout",
        "--per-set",
        2,
        "--robot",
        "turtlebot3_burger",
    )
    assert command(*words, "--set", "initial_fill=0.35", "--set", "cols=20")[0] == 0
    dataset = open_dataset(tmp_path / "layout")
    assert len(dataset.world_numbers) == 2
    world = dataset.load(0)
    assert (world.cols, world.footprint_cells, world.resolution_m) == (20, 5, 0.06)
    assert np.load(tmp_path / "layout" / "metrics_files" / "metrics_0.npy").shape == (
        5,
    )


def test_metrics(command, tiny):
    code, out, _ = command("metrics", tiny)
    assert (code, "Tortuosity" in out) == (0, True)
    code, out, _ = command(
        "metrics", tiny, "--worlds", "3", "--formula", "published", "--json"
    )
    assert (code, len(json.loads(out)["worlds"])) == (0, 1)


def test_info(command):
    code, out, _ = command("info", "--json")
    content = json.loads(out)
    assert code == 0 and "dwa" in content["planners"]
    assert content["versions"]["barn_eval"] != "not installed"
    for state in content["optional"].values():
        assert state == "on" or state.startswith("off: ")
    films = (
        "on"
        if shutil.which("ffmpeg")
        else "off: ffmpeg is not installed; films are off, .gif works"
    )
    assert content["optional"]["ffmpeg"].startswith(films)
    assert {"foxglove", "gymnasium", "stable_baselines3", "ray", "optuna"} <= content[
        "optional"
    ].keys()
    assert "installed" in command("info")[1]


def test_bench(command, tiny, tmp_path):
    settings = ("--set", f"dataset={tiny}", "--set", "repeats=1", "--set", "ros=false")
    words = ("bench", "--planners", "gap", *settings, "--json")
    code, out, _ = command(*words)
    assert code == 0
    (tmp_path / "before.json").write_text(out)
    code, later, _ = command(*words, "--against", tmp_path / "before.json")
    names = [
        figure["name"]
        for figure in json.loads(out)["figures"]
        if figure["better"] != "neither"
    ]
    assert (
        code == 0
        and [change["name"] for change in json.loads(later)["changes"]] == names
    )
    figures = {figure["name"]: figure for figure in json.loads(out)["figures"]}
    assert all(figure["value"] > 0.0 for figure in figures.values())
    assert json.loads(out)["machine"]["cores"] >= 1


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("rnu", "unknown command 'rnu'; did you mean 'run'?"),
        ("replay", "Missing argument 'BAGS...'"),
        ("run --dataset nowhere --out x", "nowhere: no such file, folder or data set"),
        ("demo --dataset nowhere", "nowhere: no such file"),
        ("show 4 --dataset TINY", "no world 4"),
        ("show nothing.world", "nothing.world: no such file"),
        ("show 0 --by speed", "--by needs --trials"),
        ("metrics TINY --formula publishd", "did you mean 'published'?"),
        ("worlds generate TINY", "exists already"),
        ("worlds generate x.npz --set initial_fil=0.1", "did you mean 'initial_fill'?"),
        (
            "worlds generate x.npz --set initial_fill=2.0",
            "initial_fill must be from 0 to 1",
        ),
        ("worlds generate x.npz --robot jakal", "did you mean 'jackal'?"),
        ("worlds list TINY --worlds 7-9", "no world 7-9"),
        ("worlds lst", "No such command 'lst'. Did you mean"),
        ("robots --out x.png", "--out needs ROBOT"),
        ("bench --planners daw", "unknown planner 'daw'"),
        ("bench --planners=", "unknown planner ''"),
        ("tune dwa --run ros=5 --run ros.lockstep=0", "ros is given as a whole"),
        ("bench --set world=999", "no world 999"),
        (
            "bench --against nowhere.json",
            "--against nowhere.json: not a result of barn bench --json",
        ),
        ("run --dataset TINY --out x --worlds 9", "no world 9"),
        (
            "run --dataset TINY --out x --planner daw",
            "unknown planner 'daw'; did you mean 'dwa'?",
        ),
        (
            "run --dataset TINY --out x --set dwa.max_sped_mps=1",
            "did you mean 'dwa.max_speed_mps'?",
        ),
        (
            "run --dataset TINY --out x --set dwa.max_speed_mps=fast",
            "must be a number, got 'fast'",
        ),
        ("run --dataset TINY --out x --set dwa.max_speed_mps", "must be key=value"),
        ("run --dataset TINY --out x --set a=1 --set a=2", "each key given once"),
        ("run --dataset TINY --out x --set 'a=['", "--set 'a=[': not YAML: "),
        (
            "run --dataset TINY --out x --mode ros --planner a/b --planner-command x",
            "'a/b'",
        ),
    ],
)
def test_mistakes_are_told_in_one_line(rejected, tiny, words, complaint):
    assert complaint in rejected(
        *(tiny if word == "TINY" else word for word in shlex.split(words))
    )


def test_a_folder_of_something_else_is_left_alone(rejected, tiny, tmp_path):
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "thesis.tex").write_text("x")
    for extra in ([], ["--overwrite"]):
        assert "holds no run" in rejected(
            "run", "--dataset", tiny, "--out", "home", *extra
        )
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.json").write_text("{")
    assert "not JSON" in rejected("run", "--dataset", tiny, "--out", "run")
    (tmp_path / "file").write_text("")
    for out in ("file/run", "/proc/run"):
        assert rejected("run", "--dataset", tiny, "--out", out).startswith(
            f"error: {out}: cannot be written: "
        )


def test_a_reader_that_leaves_early_is_no_error(tmp_path):
    listing = [sys.executable, "-m", "barn_eval", "worlds", "list", "barn300", "--json"]
    with subprocess.Popen(
        listing, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as child:
        child.stdout.read(10)
        child.stdout.close()
        assert child.stderr.read() == b""
        child.wait(timeout=600)
