"""The command line.

Every command runs, and every mistake is one line, exit code 2 and nothing half-written.
"""

import json
import os
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from campaign_runs import install_stranger
from click.shell_completion import BashComplete
from rosbags.rosbag2 import Reader
from text_tables import answers_of, rows_of
from waiting import ROOT, barn_words, run_python, with_search_path

from barn_eval import __version__
from barn_eval.api import suite
from barn_eval.commands.main import COMMANDS, cli
from barn_eval.results.folder import read_results
from barn_eval.results.provenance import commit
from barn_eval.results.run_file import RunFile
from barn_eval.running import direct
from barn_eval.trials.protocol import PROTOCOLS
from barn_eval.trials.ros_config import RosConfig
from barn_eval.trials.run_config import ExecutionConfig
from barn_planners.registry import planner_names
from barn_sim.config import SimulatorConfig
from barn_worlds.base.config import fields_of
from barn_worlds.base.errors import ExitCode
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.formats.dataset_file import write_dataset_file
from barn_worlds.formats.map_server import write_map

INLINE = "--execution engine=inline"  # which starts no worker


@pytest.fixture(scope="module")
def tiny(tmp_path_factory, open_world):
    """A data set of two worlds."""
    grid = open_world.grid.copy()
    grid[20:25, 10:15] = True
    blocked = replace(open_world, name="blocked", grid=grid)
    path = tmp_path_factory.mktemp("data") / "tiny.npz"
    write_dataset_file(path, "tiny", {0: open_world, 3: blocked})
    return path


def output_and_modules(arguments, **environment):
    """Return what `barn` prints in a process of its own, and the names of the modules
    that it has loaded.
    """
    script = (
        "import sys\nfrom barn_eval.commands.main import main\n"
        f"try: main({arguments})\nfinally: print(*sys.modules)"
    )
    done = run_python("-c", script, env=os.environ | environment)
    *lines, loaded = done.stdout.splitlines()
    return lines, set(loaded.split())


def test_help_lists_the_commands_and_imports_none():
    lines, loaded = output_and_modules(["--help"])
    assert all(any(f"  {name} " in line for line in lines) for name in COMMANDS)
    libraries = {"numpy", "numba", "matplotlib", "rclpy", "pybullet"}
    assert not {*libraries, "barn_eval.results.run_file"} & loaded


def test_shell_completion_imports_no_command():
    shell = {"_BARN_COMPLETE": "bash_complete", "COMP_WORDS": "barn re"}
    lines, loaded = output_and_modules([], COMP_CWORD="1", **shell)
    assert lines == ["plain,report", "plain,replay", "plain,reproduce"]
    assert not {"numpy", "barn_eval.commands.report"} & loaded


def complete(line, monkeypatch):
    """Return what bash is offered for the last word of a line, as type,value."""
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(line.count(" ")))
    return BashComplete(cli, {}, "barn", "_BARN_COMPLETE").complete().splitlines()


COMPLETIONS = """
run --repe             | --repetitions
run --planners eb      | eband
run --planners dwa,f=e | dwa,f=eband
run --protocol pap     | paper2020
run --robot hus        | husky
run --dataset barn3    | barn300
planners eb            | eband
protocols know         | known_map
robots hus             | husky
worlds list barn3      | barn300
tune eb                | eband
"""


@pytest.mark.parametrize("line, value", rows_of(COMPLETIONS))
def test_the_shell_completes_names(line, value, monkeypatch):
    assert complete(f"barn {line}", monkeypatch) == [f"plain,{value}"]


def test_the_shell_completes_all_names_and_files_and_folders(monkeypatch):
    planners = [f"plain,{name}" for name in planner_names()]
    assert complete("barn run --planners ", monkeypatch) == planners
    protocols = [f"plain,{name}" for name in PROTOCOLS]
    assert complete("barn run --protocol ", monkeypatch) == protocols
    # A protocol or robot of one's own is a file; bash lists its folder's.
    assert complete("barn run --robot my_", monkeypatch) == ["file,my_"]
    assert complete("barn run --out o", monkeypatch) == ["dir,o"]
    assert complete("barn report o", monkeypatch) == ["file,o"]


@pytest.mark.parametrize("name", list(COMMANDS))
def test_every_command_explains_itself(succeed, name):
    assert succeed(f"{name} --help").startswith(f"Usage: barn {name}")


def test_campaign_is_another_name_of_run(succeed):
    help_text = succeed("campaign --help").replace("barn campaign", "barn run")
    assert help_text == succeed("run --help")
    assert "campaign" not in succeed("--help")


def test_keys_are_listed_with_their_meanings(succeed):
    keys = succeed("run --help-keys")
    for config in (SimulatorConfig(), RosConfig(), ExecutionConfig()):
        assert [key for key, _, _ in fields_of(config) if key not in keys] == []
    assert "lidar.noise_share" not in succeed("run --help")


def test_another_package_adds_a_command(tmp_path):
    install_stranger(tmp_path, "[barn_eval.commands]\nhello = stranger:hello\n")
    code = (
        "import click\nhello = click.Command('hello', callback=lambda: print('hi'))\n"
    )
    (tmp_path / "stranger.py").write_text(code)
    for arguments, output in ((["hello"], "hi"), (["--help"], "  hello ")):
        lines, loaded = output_and_modules(arguments, **with_search_path(tmp_path))
        assert any(output in line for line in lines)
        assert ("stranger" in loaded) == (arguments == ["hello"])


def test_version_names_the_commit_that_the_records_name(succeed, monkeypatch):
    current = commit()
    addition = f" (commit {current})" if current else ""
    assert succeed("--version") == f"barn {__version__}{addition}\n"
    monkeypatch.setenv("PATH", "")  # no git
    if not (Path(direct.__file__).parents[1] / "data/commit").exists():  # of a wheel
        addition = ""
    assert succeed("--version") == f"barn {__version__}{addition}\n"


def test_run(command, tiny, tmp_path):
    options = "--worlds 0 --protocol challenge --repetitions 2 --bags all --out run"
    code, out, err = command(f"run --dataset {tiny} {options} {INLINE}")
    assert code == 0
    # in either order
    assert "[2/2] dwa_w0000_r0" in err and "] dwa_w0000_r01: success" in err
    assert "2 trials in 1 world" in out and "compare" not in out
    folder = tmp_path / "run"
    results = read_results(folder)
    names = {result.trial_id for result in results}
    assert names == {"dwa_w0000_r00", "dwa_w0000_r01"}
    for result in results:
        assert result.scores.success and result.preset == "challenge"
        with Reader(folder / "bags" / result.trial_id) as reader:
            assert {"/scan", "/cmd_vel", "/plan"} <= set(reader.topics)
    content = json.loads((folder / "run.json").read_text())
    assert content["experiment"]["protocol"]["limit_s"] == 100.0
    assert {"versions", "commit", "machine"} <= content["sessions"][0].keys()
    assert (folder / "results.csv").read_text().count("\n") == 3


def test_run_is_completed_and_not_mixed_with_another(command, tiny, tmp_path):
    run = f"run --dataset {tiny} --worlds 0 --planner gap --out run {INLINE}"
    folder = tmp_path / "run"
    assert command(run)[0] == 0
    row = json.loads((folder / "results.jsonl").read_text())
    code, out, err = command(run, "--json")
    assert code == 0
    assert "1 of 1 trials are already there" in err
    summary = json.loads(out)
    assert row.pop("crc32")
    assert summary["results"] == [row]
    (planner,) = summary["planners"]
    assert planner["scores"]["trials"] == 1
    assert command(run, "--seed", 1, "--overwrite")[0] == 0
    assert [result.campaign_seed for result in read_results(folder)] == [1]


def test_parameters_reach_planner_and_simulator(succeed, tiny, tmp_path):
    settings = "--set dwa.max_speed_mps=0.2 --sim lidar.noise_m=0.0"
    options = f"--worlds 0 --protocol challenge --out run {INLINE}"
    succeed(f"run --dataset {tiny} {options} {settings}")
    experiment = RunFile.read(tmp_path / "run").run_config()
    assert experiment.planners[0].overrides == {"dwa.max_speed_mps": 0.2}
    assert experiment.simulator.lidar.noise_m == 0.0
    assert read_results(tmp_path / "run")[0].measures.mean_speed_mps < 0.21


def test_demo_in_one_process(printed, tiny):
    results = printed(f"demo --dataset {tiny} --mode direct --out demo")["results"]
    assert {result["world"] for result in results} == {0, 3}


def test_worlds_are_generated_listed_shown_exported_and_imported(
    succeed, printed, tmp_path
):
    succeed("worlds generate own.npz --per-set 1 --seed 5")
    assert open_dataset(tmp_path / "own.npz").world_numbers == tuple(range(12))
    listed = printed("worlds list own.npz --worlds 2-3")
    assert [entry["world"] for entry in listed] == [2, 3]
    succeed("worlds list")
    succeed("worlds list own.npz")
    succeed("show own.npz --out sheet.png")
    succeed("show 4 --dataset own.npz --out world.png")
    succeed("show 4 --dataset own.npz")
    for picture in ("sheet.png", "world.png", "world_4.png"):
        assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")
    original = open_dataset(tmp_path / "own.npz")
    for form in ("sdf", "sdf_classic", "map", "original"):
        succeed(f"worlds convert own.npz {form} --format {form} --worlds 2,5")
        succeed(f"worlds convert {form} {form}.npz")
        back = open_dataset(tmp_path / f"{form}.npz")
        assert back.world_numbers == (2, 5)
        np.testing.assert_array_equal(back.load(5).grid, original.load(5).grid)
    succeed("worlds convert own.npz png --format png --worlds 2")
    succeed("worlds convert own.npz some --format npz --worlds 2")
    copied = open_dataset(tmp_path / "some.npz").load(2)
    assert copied.checksum == original.load(2).checksum


def test_one_parameter_set_of_ones_own(succeed, tmp_path):
    settings = "--set initial_fill=0.35 --set cols=20"
    robot = "--robot turtlebot3_burger"
    succeed(f"worlds generate layout --per-set 2 {robot} {settings}")
    layout = tmp_path / "layout"
    dataset = open_dataset(layout)
    assert len(dataset.world_numbers) == 2
    world = dataset.load(0)
    assert (world.cols, world.footprint_cells, world.resolution_m) == (20, 5, 0.06)
    metrics = np.load(layout / "metrics_files" / "metrics_0.npy")
    assert metrics.shape == (5,)


def test_metrics(succeed, printed, tiny):
    assert "Tortuosity" in succeed(f"metrics {tiny}")
    content = printed(f"metrics {tiny} --worlds 3 --formula published")
    assert len(content["worlds"]) == 1


def test_info(succeed, printed):
    content = printed("info")
    assert "dwa" in content["planners"]
    assert content["versions"]["barn_eval"] != "not installed"
    for state in content["optional"].values():
        assert state == "on" or state.startswith("off: ")
    optional = content["optional"]
    missing = "off: ffmpeg is not installed; films are off, but .gif works"
    films = "on" if shutil.which("ffmpeg") else missing
    assert optional["ffmpeg"].startswith(films)
    extras = {"foxglove", "gymnasium", "stable_baselines3", "ray", "optuna"}
    assert extras <= optional.keys()
    assert "installed" in succeed("info")


def test_bench(printed, tiny, tmp_path):
    settings = f"--set dataset={tiny} --set repeats=1 --set ros=false"
    content = printed(f"bench --planners gap {settings}")
    (tmp_path / "before.json").write_text(json.dumps(content))
    later = printed(f"bench --planners gap {settings} --against before.json")
    figures = content["figures"]
    names = [figure["name"] for figure in figures if figure["better"] != "neither"]
    assert [change["name"] for change in later["changes"]] == names
    assert all(figure["value"] > 0.0 for figure in figures)
    assert content["machine"]["cores"] >= 1


MISTAKES = """
rnu
    unknown command 'rnu'; did you mean 'run'?
replay
    Missing argument 'BAGS...'
run --dataset nowhere --out x
    nowhere: no such file, folder or data set
demo --dataset nowhere
    nowhere: no such file
show 4 --dataset TINY
    no world 4
show nothing.world
    nothing.world: no such file
show 0 --by speed
    --by needs --trials
metrics TINY --formula publishd
    did you mean 'published'?
worlds generate TINY
    exists already
worlds generate x.npz --set initial_fil=0.1
    did you mean 'initial_fill'?
worlds generate x.npz --set initial_fill=2.0
    initial_fill must be from 0 to 1
worlds generate x.npz --robot jakal
    did you mean 'jackal'?
worlds list TINY --worlds 7-9
    no world 7-9
worlds lst
    No such command 'lst'. Did you mean
robots --out x.png
    --out needs ROBOT
planners dwaa
    unknown planner 'dwaa'; did you mean 'dwa'?
planners dwa:fast_dw
    planner dwa has no preset 'fast_dw'; did you mean 'fast_dwa'?
protocols chalenge
    unknown protocol 'chalenge'; did you mean 'challenge'?
bench --planners daw
    unknown planner 'daw'
bench --planners=
    unknown planner ''
tune dwa --run ros=5 --run ros.lockstep=0
    --run ros.lockstep: cannot be combined with --run ros=...
bench --set world=999
    no world 999
bench --against nowhere.json
    --against nowhere.json: not a result of barn bench --json
run --dataset TINY --out x --worlds 9
    no world 9
run --dataset TINY --out x --planner daw
    unknown planner 'daw'; did you mean 'dwa'?
run --dataset TINY --out x --set dwa.max_sped_mps=1
    did you mean 'dwa.max_speed_mps'?
run --dataset TINY --out x --set dwa.max_speed_mps=fast
    must be a number, got 'fast'
run --dataset TINY --out x --set dwa.max_speed_mps
    must be key=value
run --dataset TINY --out x --set a=1 --set a=2
    each key given once
run --dataset TINY --out x --set 'a=['
    --set 'a=[': not YAML:
run --dataset TINY --out x --mode ros --planner a/b --planner-command x
    'a/b'
"""


@pytest.mark.parametrize("words, complaint", answers_of(MISTAKES))
def test_mistakes_are_told_in_one_line(rejected, tiny, words, complaint):
    assert complaint in rejected(words.replace("TINY", str(tiny)))


def test_a_folder_of_something_else_is_left_alone(rejected, tiny, tmp_path):
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "thesis.tex").write_text("x")
    for out in ("home", "home --overwrite"):
        assert "holds no run" in rejected(f"run --dataset {tiny} --out {out}")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.json").write_text("{")
    assert "not JSON" in rejected(f"run --dataset {tiny} --out run")
    (tmp_path / "file").write_text("")
    for out in ("file/run", "/proc/run"):
        error = rejected(f"run --dataset {tiny} --out {out}")
        assert error.startswith(f"error: {out}: cannot be written: ")


def test_a_reader_that_leaves_early_is_no_error(tmp_path):
    listing = barn_words("worlds list barn300 --json")
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(listing, cwd=tmp_path, **pipes) as child:
        child.stdout.close()
        assert child.stderr.read() == b""
        assert child.wait(timeout=600) == ExitCode.READER_GONE


def test_files_are_named_in_utf8_whatever_the_locale(tmp_path, open_world):
    write_map(open_world.occupancy_map(), tmp_path / "hölle", "büro.pgm")
    names = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    show = barn_words("show hölle.yaml")
    subprocess.run(show, cwd=tmp_path, env=os.environ | names, check=True)
    assert list(tmp_path.glob("*.png"))


def test_exit_codes_are_those_of_the_table():
    page = (ROOT / "docs" / "troubleshooting.md").read_text("utf-8")
    _, _, section = page.partition("## Exit codes")
    codes = re.findall(r"^\| (\d+) \|", section.partition("\n## ")[0], re.MULTILINE)
    assert list(map(int, codes)) == sorted(ExitCode)


def test_a_fault_of_the_suite_is_no_finding(command, monkeypatch):
    monkeypatch.setattr(suite, "info", lambda: 1 / 0)
    code, _, err = command("info")
    assert code == ExitCode.REFUSED and "ZeroDivisionError" in err


@pytest.mark.parametrize(
    "reason, code",
    [("raises", ExitCode.NOT_SCORED), ("interrupts", ExitCode.INTERRUPTED)],
)
def test_a_run_in_which_nothing_drove_ends_with_a_code_of_its_own(
    command, tiny, monkeypatch, reason, code
):
    def make(*_):
        raise KeyboardInterrupt if reason == "interrupts" else RuntimeError

    monkeypatch.setattr(direct, "make_planner", make)
    run = f"run --dataset {tiny} --worlds 0 --planner gap --protocol challenge"
    assert command(f"{run} --out out {INLINE}")[0] == code
    sweep = "--sweep gap.max_speed_mps=0.3,0.5 --out sweep"
    assert command(f"{run} {sweep} {INLINE}")[0] == code


def test_every_planner_and_protocol_is_listed_and_shown(succeed):
    planners = json.loads(succeed("planners --json"))
    assert [entry["planner"] for entry in planners] == planner_names()
    for entry in planners:
        preset = entry["presets"][-1]
        shown = json.loads(succeed(f"planners {entry['planner']}:{preset} --json"))
        assert shown["preset"] == preset and shown["parameters"]

    protocols = json.loads(succeed("protocols --json"))
    assert [entry["protocol"] for entry in protocols] == list(PROTOCOLS)
    text = succeed("protocols known_map")
    assert "map_given" in text and "the planner gets a map" in text
