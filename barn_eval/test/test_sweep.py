"""Sweeps: which settings there are, what commands they become, and that each is the same as a run of its own."""

import json

import pytest
import yaml

import barn_eval as barn
from barn_eval.analysis.leaderboard import sweep_board, sweep_table
from barn_eval.experiments.sweep import grid, parse_sweep, swept_folders, values_of
from barn_worlds.base.errors import BarnError

FILE = {
    "controller": {"ros__parameters": {"FollowPath": {"speed": 0.5, "lookahead": 0.6}, "rate": 20.0}},
    "planner": {"ros__parameters": {"rate": 5.0}},
}


def test_values_are_read_as_yaml():
    assert parse_sweep(["a.b=1,2.5", "c=x,true"]) == {"a.b": [1, 2.5], "c": ["x", True]}


@pytest.mark.parametrize(
    ("sweep", "options", "words"),
    [
        ({"dwa.path_wieght": [1]}, {}, "did you mean 'dwa.path_weight'"),
        ({"max_speed_mps": [0.1]}, {"planners": "gap,dwa"}, "a sweep is of one planner, got gap, dwa"),
        ({"dwa.path_weight": []}, {}, "must be a list of values"),
        ({"dwa.path_weight": [[1]]}, {}, "a value must be a number, a text, true or false"),
        ({"dwa.path_weight": [0.5, 0.5]}, {}, "names one value twice"),
        ({"dwa.path_weight": [0.1] * 21, "dwa.goal_weight": [0.1] * 20}, {}, "may have 400 settings, these are 420"),
    ],
)
def test_what_is_no_sweep_is_refused_in_one_line(sweep, options, words, tmp_path):
    with pytest.raises(BarnError, match=words):
        grid(sweep, None, {"out": tmp_path, **options})


@pytest.mark.parametrize("text", ["a", "=1", "a=[", "a=1,{"])
def test_texts_that_are_none_are_refused(text):
    with pytest.raises(BarnError, match="--sweep"):
        parse_sweep([text])


def test_a_ros_parameter_goes_into_the_command(tmp_path):
    asked = {"out": tmp_path, "mode": "ros", "planner_command": "mine=run me"}
    commands = [one.request.experiment.planners[0].command for one in grid({"a.b": [1, 0.5]}, None, asked)]
    assert commands == ["run me --ros-args -p a.b:=1", "run me --ros-args -p a.b:=0.5"]


def test_a_key_of_a_parameter_file_is_changed_in_a_copy(tmp_path):
    source = tmp_path / "given.yaml"
    source.write_text(yaml.safe_dump(FILE))
    asked = {"out": tmp_path / "out", "mode": "ros", "planner_command": f"mine=run --ros-args --params-file {source}"}
    made = grid({"FollowPath.speed": [0.3, 0.4], "planner.rate": [7]}, None, asked)
    assert [one.name for one in made] == ["speed=0.3,rate=7", "speed=0.4,rate=7"]
    for speed, one in zip((0.3, 0.4), made, strict=True):
        one.write_files()
        (path,) = one.files
        assert one.request.experiment.planners[0].command == f"run --ros-args --params-file {path}"
        changed = yaml.safe_load(path.read_text())
        assert changed["controller"]["ros__parameters"]["FollowPath"] == {"speed": speed, "lookahead": 0.6}
        assert (changed["planner"]["ros__parameters"]["rate"], changed["controller"]["ros__parameters"]["rate"]) == (
            7,
            20,
        )
    assert yaml.safe_load(source.read_text()) == FILE


@pytest.mark.parametrize(
    ("key", "words"),
    [("FollowPath.sped", "did you mean 'FollowPath.speed'"), ("rate", "has several parameters 'rate'; name the node")],
)
def test_a_key_that_a_parameter_file_has_not_is_refused(tmp_path, key, words):
    source = tmp_path / "given.yaml"
    source.write_text(yaml.safe_dump(FILE))
    with pytest.raises(BarnError, match=words):
        grid({key: [1]}, None, {"out": tmp_path, "mode": "ros", "planner_command": f"m=r --params-file {source}"})


def test_each_setting_is_what_a_run_of_its_own_is_and_the_best_comes_first(command, tmp_path):
    out, words = tmp_path / "sweep", ("--worlds", "0", "--planner", "gap", "--workers", "1")
    code, printed, _ = command("run", *words, "--sweep", "max_speed_mps=0.4,0.8", "--out", str(out), "--json")
    assert code == 0
    settings = json.loads(printed)["settings"]
    assert [one["max_speed_mps"] for one in settings] == [0.8, 0.4]
    command("run", *words, "--set", "max_speed_mps=0.4", "--out", str(tmp_path / "alone"))
    for name in ("results.csv", "tracks.jsonl"):
        assert (out / "max_speed_mps=0.4" / name).read_bytes() == (tmp_path / "alone" / name).read_bytes()
    assert [values_of(one) for one in swept_folders(out)] == [{"max_speed_mps": 0.4}, {"max_speed_mps": 0.8}]
    assert [row[1] for row in sweep_table(sweep_board(out)).rows] == ["0.8", "0.4"]


def test_python_has_a_column_per_parameter_and_a_figure(tmp_path):
    frame = barn.sweep(
        {"max_speed_mps": [0.5, 1.0], "k_prop_per_s": [1.0, 2.0]},
        worlds=0,
        planners="gap",
        workers=1,
        out=tmp_path,
        progress=False,
    )
    assert list(frame["max_speed_mps"][:2]) == [1.0, 1.0]
    assert set(frame["k_prop_per_s"]) == {1.0, 2.0}
    assert frame["level_with_best"].all()
