"""Leaderboards: the order of means, ties where the paired difference is not clear, each row traceable."""

import html
import json
import re

import pytest
import yaml
from report_work import EVIL, campaign, rewrite_rows

import barn_eval as barn
from barn_eval.analysis.leaderboard import (
    configuration_hash,
    make_boards,
    make_sweep_board,
    sweep_table,
)
from barn_eval.analysis.planners import assign_colors
from barn_eval.analysis.sources import read_source
from barn_eval.pages.report.leaderboard import markdown, page
from barn_eval.running.request import read_request
from barn_eval.running.setting_folders import find_setting_folders, parse_folder_name
from barn_eval.running.settings import grid, parse_sweep
from barn_eval.trials.protocol import PAPER_2020
from barn_worlds.base.errors import BarnError


def test_a_clear_difference_ranks_and_equal_results_tie(run, tmp_path):
    clear = campaign(tmp_path / "clear", run, worlds=60, faster=10.0, bags=1)
    (board,) = make_boards([clear])
    assert [(row.rank, row.tied, row.entry.planner) for row in board.places] == [
        (1, False, "gap"),
        (2, False, "dwa"),
    ]
    assert board.places[0].better_than == ("DWA",)
    assert " | all below | " in markdown([board])
    same = campaign(
        tmp_path / "same", run, planners=("gap", "twin", "dwa"), faster=0.0, bags=0
    )
    (board,) = make_boards([same])
    assert [(row.rank, row.tied) for row in board.places] == [(1, True)] * 3


def test_boards_use_common_worlds_or_stand_apart(run, tmp_path):
    first = campaign(tmp_path / "one", run, planners=("gap",), bags=0)
    two = campaign(tmp_path / "two", run, planners=("twin",), bags=0)
    fewer = campaign(tmp_path / "fewer", run, planners=("dwa",), worlds=4, bags=0)
    (board,) = make_boards([first, fewer, two], "time")
    assert {row.entry.planner: row.summary.worlds for row in board.places} == {
        "gap": 4,
        "twin": 4,
        "dwa": 4,
    }
    assert "4 worlds" in board.title
    assert (
        board.notes[0]
        == "Ranked on the 4 worlds that all have; gap and twin have more."
    )
    rewrite_rows(
        fewer,
        lambda rows: [
            row | {"campaign_seed": row["campaign_seed"] + 1} for row in rows
        ],
    )
    boards = make_boards([first, fewer, two], "time")
    assert [[row.entry.planner for row in board.places] for board in boards] == [
        ["gap", "twin"],
        ["dwa"],
    ]


def test_another_speed_class_has_a_board_of_its_own(run, tmp_path):
    planners = ("gap", "dwa", "creeper", "racer", "unknown")
    caps = {"gap": 0.5, "dwa": 0.26, "creeper": 0.25, "racer": 2.0, "unknown": None}
    folder = campaign(tmp_path / "one", run, planners=planners, bags=0)
    rewrite_rows(
        folder,
        lambda rows: [row | {"speed_cap_mps": caps[row["planner"]]} for row in rows],
    )
    boards = make_boards([folder])
    expected = [{"unknown"}, {"creeper"}, {"gap", "dwa"}, {"racer"}]
    assert [
        {place.entry.planner for place in board.places} for board in boards
    ] == expected
    assert ["m/s" in board.title for board in boards] == [False, True, True, True]
    assert "up to 0.25 m/s" in boards[1].title and "up to 2 m/s" in boards[3].title


def test_two_settings_of_a_planner_are_named_by_what_differs(run, tmp_path):
    first = campaign(tmp_path / "one", run, planners=("dwa",), bags=0)
    two = campaign(tmp_path / "two", run, planners=("dwa",), faster=0.5, bags=0)
    file = two / "run.json"
    content = json.loads(file.read_text())
    content["experiment"]["planners"][0]["overrides"] = {
        "dwa.obstacle_weight": 0.0,
        "dwa.path_weight": 3.0,
    }
    file.write_text(json.dumps(content))
    (board,) = make_boards([first, two])
    assert {place.entry.label for place in board.places} == {
        "DWA",
        "DWA (obstacle_weight=0.0, path_weight=3.0)",
    }
    three = campaign(tmp_path / "three", run, planners=("dwa",), faster=0.7, bags=0)
    (board,) = make_boards([first, two, three])
    assert {place.entry.label for place in board.places} == {
        "DWA (one)",
        "DWA (two)",
        "DWA (three)",
    }


def test_a_board_may_be_of_some_worlds_alone(run, tmp_path, command):
    folder = campaign(tmp_path / "one", run, faster=2.0, bags=0)
    content = json.loads(command("leaderboard", folder, "--worlds", "0-3", "--json")[1])
    rows = [(row["tied"], row["planner"], row["worlds"]) for row in content["places"]]
    assert rows == [(True, "gap", 4), (True, "DWA", 4)]
    assert (
        "cannot be told apart" in content["verdicts"][0]
        and "4 worlds" in content["places"][0]["board"]
    )
    with pytest.raises(BarnError, match="no world 900 among the 8"):
        make_boards([folder], worlds="900")


def test_planners_are_told_apart_within_a_board_alone(run, tmp_path):
    first = campaign(tmp_path / "one", run, bags=0)
    fewer = campaign(tmp_path / "fewer", run, planners=("dwa",), worlds=4, bags=0)
    boards = make_boards([fewer, first])
    marks = [
        {(place.entry.label, place.entry.color) for place in board.places}
        for board in boards
    ]
    gap, dwa = assign_colors(["gap", "dwa"])
    assert len(marks) == 1 and {
        color for label, color in marks[0] if label == "gap"
    } == {gap}
    assert len(marks[0]) == len({color for _, color in marks[0]}) == 3
    assert dwa in {color for _, color in marks[0]}
    again = campaign(tmp_path / "again", run, bags=0)
    (board,) = make_boards([first, again])
    assert {place.entry.label for place in board.places} == {
        "gap (one)",
        "DWA (one)",
        "gap (again)",
        "DWA (again)",
    }
    assert len({place.entry.color for place in board.places}) == 4


def test_rows_lead_to_their_configuration_and_bags(run, tmp_path):
    folder = campaign(tmp_path / "one", run, planners=("gap",), bags=2)
    row = (
        f"| {folder} | {configuration_hash(read_source(folder), 'gap')} | 2 in bags/ |"
    )
    assert row.replace("_", "\\_") in markdown(make_boards([folder]))


def test_planners_of_a_campaign_have_checksums_of_their_own(run, tmp_path):
    both = campaign(tmp_path / "both", run, bags=0)
    alone = campaign(tmp_path / "alone", run, planners=("gap",), bags=0)
    (board,) = make_boards([both])
    assert len({place.configuration for place in board.places}) == 2
    assert configuration_hash(read_source(alone), "gap") == configuration_hash(
        read_source(both), "gap"
    )


def test_the_terminal_gets_a_conclusion_and_a_table(run, tmp_path, command):
    folder = campaign(tmp_path / "one_two", run, faster=2.0, bags=0)
    code, output, _ = command("leaderboard", folder)
    assert code == 0 and "Only 8 worlds" in output and "rank" in output
    assert (
        " ".join(output.split()).count(
            "gap and DWA cannot be told apart: challenge metric 0."
        )
        == 1
    )
    assert not set("\\|#") & set(output)


def test_texts_are_escaped_in_both_forms(run, tmp_path):
    folder = campaign(tmp_path / "a|b_<i>", run, planners=("gap",), bags=0)
    boards = make_boards([folder])
    assert "<i>" not in markdown(boards)
    assert "a\\|b\\_&lt;i&gt;" in markdown(boards)
    assert "<i>" not in page(boards)
    assert EVIL not in page(boards)


def test_the_command_writes_both(run, tmp_path, command, rejected):
    folder = campaign(tmp_path / "one", run, bags=0)
    assert (
        command("leaderboard", folder, "--out", "board.md", "--out", "board.html")[0]
        == 0
    )
    assert (tmp_path / "board.md").read_text().startswith("# Leaderboard")
    assert (tmp_path / "board.html").read_text().startswith("<!DOCTYPE html>")
    assert "must end in .md or .html" in rejected(
        "leaderboard", folder, "--out", "board.doc"
    )


def test_a_board_ranks_by_its_protocol_and_shows_contact(run, tmp_path):
    folder = campaign(tmp_path / "one", run, bags=0, protocol=PAPER_2020)
    (board,) = make_boards([folder])
    assert board.measure.key == "normalised_time_s_per_m"
    text = markdown([board])
    assert (
        "| time per meter as counted [s/m] | time in contact [s] | success [%] |"
        in text
    )
    (by_score,) = make_boards([folder], "challenge")
    assert "time in contact" not in markdown([by_score])
    (board,) = make_boards([campaign(tmp_path / "two", run, bags=0)])
    assert board.measure.key == "challenge"


def test_a_board_begins_with_its_conclusion_and_cautions(run, tmp_path):
    folder = campaign(tmp_path / "one_two", run, faster=2.0, bags=0)
    (board,) = make_boards([folder])
    text = markdown([board])
    short, verdict, few, caption = text.split("\n\n")[2:6]
    assert short.startswith("gap and DWA cannot be told apart: challenge metric 0.")
    failures = r"Failures in up to \d+\.\d % of gap's and \d+\.\d % of DWA's trials cannot be ruled out\."
    assert re.search(failures, verdict)
    assert few.startswith("Only 8 worlds: with fewer than 10")
    assert caption.startswith("Ranked by challenge metric")
    assert verdict in html.unescape(page([board]))
    assert few in page([board])
    assert board.places[0].better_than == ()
    rewrite_rows(folder, lambda rows: [row for row in rows if row["world"] < 6])
    (board,) = make_boards([folder])
    assert board.notes[1:] == (f"{folder} is partial: 24 of 32 trials",)
    assert "one\\_two is partial: 24 of 32 trials" in markdown([board])


FILE = {
    "controller": {
        "ros__parameters": {
            "FollowPath": {"speed": 0.5, "lookahead": 0.6},
            "rate": 20.0,
        }
    },
    "planner": {"ros__parameters": {"rate": 5.0}},
}


def test_values_are_read_as_yaml():
    assert parse_sweep(["a.b=1,2.5", "c=x,true"]) == {"a.b": [1, 2.5], "c": ["x", True]}


@pytest.mark.parametrize(
    ("sweep", "options", "words"),
    [
        ({"dwa.path_wieght": [1]}, {}, "did you mean 'dwa.path_weight'"),
        (
            {"max_speed_mps": [0.1]},
            {"planners": "gap,dwa"},
            "a sweep is of one planner, got gap, dwa",
        ),
        ({"dwa.path_weight": []}, {}, "must be a list of values"),
        (
            {"dwa.path_weight": [[1]]},
            {},
            "a value must be a number, a text, true or false",
        ),
        ({"dwa.path_weight": [0.5, 0.5]}, {}, "names one value twice"),
        (
            {"dwa.path_weight": [0.1] * 21, "dwa.goal_weight": [0.1] * 20},
            {},
            "may have 400 settings, these are 420",
        ),
    ],
)
def test_what_is_no_sweep_is_refused_in_one_line(sweep, options, words, tmp_path):
    with pytest.raises(BarnError, match=words):
        grid(read_request(None, {"out": tmp_path, **options}), sweep)


@pytest.mark.parametrize("text", ["a", "=1", "a=[", "a=1,{"])
def test_texts_that_are_none_are_refused(text):
    with pytest.raises(BarnError, match="--sweep"):
        parse_sweep([text])


def test_a_ros_parameter_goes_into_the_command(tmp_path):
    options = {"out": tmp_path, "mode": "ros", "planner_command": "mine=run me"}
    commands = [
        setting.request.config.planners[0].command
        for setting in grid(read_request(None, options), {"a.b": [1, 0.5]})
    ]
    assert commands == ["run me --ros-args -p a.b:=1", "run me --ros-args -p a.b:=0.5"]


def test_a_key_of_a_parameter_file_is_changed_in_a_copy(tmp_path):
    source = tmp_path / "given.yaml"
    source.write_text(yaml.safe_dump(FILE))
    options = {
        "out": tmp_path / "out",
        "mode": "ros",
        "planner_command": f"mine=run --ros-args --params-file {source}",
    }
    sweep = {"FollowPath.speed": [0.3, 0.4], "planner.rate": [7]}
    settings = grid(read_request(None, options), sweep)
    assert [setting.name for setting in settings] == [
        "speed=0.3,rate=7",
        "speed=0.4,rate=7",
    ]
    for speed, setting in zip((0.3, 0.4), settings, strict=True):
        setting.write_parameter_files()
        (path,) = setting.parameter_files
        assert (
            setting.request.config.planners[0].command
            == f"run --ros-args --params-file {path}"
        )
        changed = yaml.safe_load(path.read_text())
        assert changed["controller"]["ros__parameters"]["FollowPath"] == {
            "speed": speed,
            "lookahead": 0.6,
        }
        assert [
            changed[node]["ros__parameters"]["rate"]
            for node in ("planner", "controller")
        ] == [7, 20]
    again = grid(read_request(None, options), sweep)
    assert [setting.request for setting in again] == [
        setting.request for setting in settings
    ]  # so that it can be resumed
    assert yaml.safe_load(source.read_text()) == FILE


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("FollowPath.sped", "did you mean 'FollowPath.speed'"),
        ("rate", "has several parameters 'rate'; name the node"),
    ],
)
def test_a_key_that_a_parameter_file_has_not_is_refused(tmp_path, key, words):
    source = tmp_path / "given.yaml"
    source.write_text(yaml.safe_dump(FILE))
    with pytest.raises(BarnError, match=words):
        options = {
            "out": tmp_path,
            "mode": "ros",
            "planner_command": f"m=r --params-file {source}",
        }
        grid(read_request(None, options), {key: [1]})


def test_each_setting_is_a_run_and_the_best_comes_first(command, tmp_path):
    out = tmp_path / "sweep"
    words = ("--worlds", "0", "--planner", "gap", "--execution", "engine=inline")
    code, printed, _ = command(
        "run", *words, "--sweep", "max_speed_mps=0.4,0.8", "--out", str(out), "--json"
    )
    assert code == 0
    settings = json.loads(printed)["settings"]
    assert [setting["max_speed_mps"] for setting in settings] == [0.8, 0.4]
    command(
        "run", *words, "--set", "max_speed_mps=0.4", "--out", str(tmp_path / "alone")
    )
    for name in ("results.csv", "tracks.jsonl"):
        assert (out / "max_speed_mps=0.4" / name).read_bytes() == (
            tmp_path / "alone" / name
        ).read_bytes()
    assert [parse_folder_name(setting) for setting in find_setting_folders(out)] == [
        {"max_speed_mps": 0.4},
        {"max_speed_mps": 0.8},
    ]
    assert [row[:2] for row in sweep_table(make_sweep_board(out)).rows] == [
        ("gap", "0.8"),
        ("gap", "0.4"),
    ]


def test_python_has_a_column_per_parameter_and_a_figure(tmp_path):
    parameters = {"max_speed_mps": [0.5, 1.0], "k_prop_per_s": [1.0, 2.0]}
    frame = barn.sweep(
        parameters,
        worlds=0,
        planners="gap",
        engine="inline",
        out=tmp_path,
        progress=False,
    )
    assert list(frame["max_speed_mps"][:2]) == [1.0, 1.0]
    assert set(frame["k_prop_per_s"]) == {1.0, 2.0}
    assert frame["level_with_best"].all()
