"""Leaderboards: the order of means, ties where the paired difference is not clear, each
row traceable.
"""

import html
import re

import pytest
import yaml
from campaign_runs import tables
from forgery import edit_run
from planners import run_inline
from refusals import refused
from report_work import EVIL, campaign, rewrite_rows
from text_tables import answers_of

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
from barn_eval.trials.protocol import CHALLENGE, PAPER_2020
from barn_planners.gap.planner import ENTRY
from barn_worlds.base.errors import BarnError


@pytest.fixture
def write_rows(run, tmp_path):
    """Makes a campaign of rows of some planners, by default gap and DWA, without bags."""

    def make(name, *planners, **options):
        options = {"bags": 0} | options
        return campaign(tmp_path / name, run, planners or ("gap", "dwa"), **options)

    return make


def test_a_clear_difference_ranks_and_equal_results_tie(write_rows):
    clear = write_rows("clear", worlds=60, faster=10.0, bags=1)
    board = board_of(clear)
    gap, dwa = board.places
    assert (gap.rank, gap.tied, gap.entry.planner) == (1, False, "gap")
    assert (dwa.rank, dwa.tied, dwa.entry.planner) == (2, False, "dwa")
    assert gap.better_than == ["DWA"]
    assert " | all below | " in markdown([board])
    same = write_rows("same", "gap", "twin", "dwa", faster=0.0)
    board = board_of(same)
    assert [(row.rank, row.tied) for row in board.places] == [(1, True)] * 3


def test_boards_use_common_worlds_or_stand_apart(write_rows):
    first = write_rows("one", "gap")
    two = write_rows("two", "twin")
    fewer = write_rows("fewer", "dwa")
    rewrite_rows(fewer, lambda rows: rows[:-1])
    (board,) = make_boards([first, fewer, two], "time")
    trials = {row.entry.planner: row.summary.trials for row in board.places}
    assert trials == dict.fromkeys(("gap", "twin", "dwa"), 15)
    note = "Ranked by the 8 worlds that all planners have; gap and twin have more."
    assert board.notes[0] == note
    change_rows(fewer, lambda row: {"campaign_seed": row["campaign_seed"] + 1})
    both, alone = make_boards([first, fewer, two], "time")
    assert planners_of(both) == ["gap", "twin"]
    assert planners_of(alone) == ["dwa"]


def test_a_small_run_shrinks_no_board_unless_asked(write_rows):
    large = write_rows("large", "gap", "dwa")
    small = write_rows("small", "twin", worlds=3)
    both, alone = make_boards([small, large])
    assert planners_of(both) == ["gap", "dwa"] and "8 worlds" in both.title
    assert both.notes[-1] == "On other boards: twin (other trials)."
    assert alone.notes[-1] == "On other boards: gap and DWA (other trials)."
    (board,) = make_boards([small, large], worlds="0-2")
    assert set(planners_of(board)) == {"gap", "dwa", "twin"}


def test_a_planner_without_declaration_is_classed_by_its_commands(tmp_path):
    def drive(name, planners):
        return run_inline("0", planners, CHALLENGE, out=tmp_path / name)

    plain = drive("plain", "gap")
    mine = drive("mine", {"mine": ENTRY.build(ENTRY.presets["default"])})
    # The row keeps what the suite knew as it drove.
    assert mine.trials[0].speed_cap_mps == 2.0
    board = board_of(plain.folder, mine.folder)
    first, other = (place.summary["efficiency"].estimate for place in board.places)
    assert first == other  # although rounding made some of its commands smaller
    assert "up to 0.5 m/s" in board.title
    (note,) = (note for note in board.notes if "mine declares" in note)
    assert note.endswith("counts, 0.5 m/s; --set mine.max_speed_mps=0.5 declares it.")
    assert note in mine.verdict()
    efficiency = mine.summary["efficiency"].iloc[0]
    assert efficiency == pytest.approx(plain.trials[0].scores.efficiency)


def test_another_speed_class_has_a_board_of_its_own(write_rows):
    planners = ("gap", "dwa", "creeper", "racer", "unknown")
    caps = {"gap": 0.5, "dwa": 0.26, "creeper": 0.25, "racer": 2.0, "unknown": None}
    folder = write_rows("one", *planners)
    change_rows(folder, lambda row: {"speed_cap_mps": caps[row["planner"]]})
    boards = make_boards([folder])
    expected = [{"unknown"}, {"creeper"}, {"gap", "dwa"}, {"racer"}]
    others = "unknown (unknown speed); gap and DWA (up to 0.5 m/s); racer (up to 2 m/s)"
    assert boards[1].notes[-1] == f"On other boards: {others}."
    assert [set(planners_of(board)) for board in boards] == expected
    assert ["m/s" in board.title for board in boards] == [False, True, True, True]
    assert "up to 0.25 m/s" in boards[1].title and "up to 2 m/s" in boards[3].title


def test_two_settings_of_a_planner_are_named_by_what_differs(write_rows):
    first = write_rows("one", "dwa")
    two = write_rows("two", "dwa", faster=0.5)
    with edit_run(two) as content:
        (planner,) = content["experiment"]["planners"]
        planner["overrides"] = {"dwa.obstacle_weight": 0.0, "dwa.path_weight": 3.0}
    board = board_of(first, two)
    assert labels_of(board) == {"DWA", "DWA (obstacle_weight=0.0, path_weight=3.0)"}
    three = write_rows("three", "dwa", faster=0.7)
    board = board_of(first, two, three)
    assert labels_of(board) == {"DWA (one)", "DWA (two)", "DWA (three)"}


def test_a_board_may_be_of_some_worlds_alone(write_rows, printed):
    folder = write_rows("one", faster=2.0)
    content = printed(f"leaderboard {folder} --worlds 0-3")
    places = content["places"]
    assert [place["planner"] for place in places] == ["gap", "DWA"]
    for place in places:
        assert (place["tied"], place["worlds"]) == (True, 4)
    assert "is not significant" in content["verdicts"][0]
    assert "4 worlds" in places[0]["board"]
    with refused("no world 900 among the 8", BarnError):
        make_boards([folder], worlds="900")


def test_planners_are_told_apart_within_a_board_alone(write_rows):
    first = write_rows("one")
    other = write_rows("other", "dwa")
    board = board_of(other, first)
    colors = {place.entry.label: place.entry.color for place in board.places}
    gap, dwa = assign_colors(["gap", "dwa"])
    assert colors["gap"] == gap
    assert dwa in colors.values()
    assert len(colors) == len(set(colors.values())) == len(board.places) == 3
    again = write_rows("again")
    board = board_of(first, again)
    names = ("gap (one)", "DWA (one)", "gap (again)", "DWA (again)")
    assert labels_of(board) == set(names)
    assert len({place.entry.color for place in board.places}) == 4


def test_rows_lead_to_their_configuration_and_bags(write_rows):
    folder = write_rows("one", "gap", bags=2)
    checksum = configuration_hash(read_source(folder), "gap")
    row = f"| {folder} | {checksum} | 2 in bags/ |"
    assert row.replace("_", "\\_") in markdown(make_boards([folder]))


def test_planners_of_a_campaign_have_checksums_of_their_own(write_rows):
    both = write_rows("both")
    alone = write_rows("alone", "gap")
    board = board_of(both)
    assert len({place.configuration for place in board.places}) == 2
    sources = map(read_source, (alone, both))
    assert len({configuration_hash(source, "gap") for source in sources}) == 1


def test_the_terminal_gets_a_conclusion_and_a_table(write_rows, succeed):
    folder = write_rows("one_two", faster=2.0)
    output = succeed(f"leaderboard {folder}")
    assert "Only 8 worlds" in output and "rank" in output
    sentence = "gap ranks first; its lead over DWA is not significant (p = 0."
    assert " ".join(output.split()).count(sentence) == 1
    assert not set("\\|#") & set(output)


def test_texts_are_escaped_in_both_forms(write_rows):
    folder = write_rows("a|b_<i>", "gap")
    boards = make_boards([folder])
    assert "<i>" not in markdown(boards)
    assert "a\\|b\\_&lt;i&gt;" in markdown(boards)
    assert "<i>" not in page(boards)
    assert EVIL not in page(boards)


def test_the_command_writes_both(write_rows, tmp_path, succeed, rejected):
    folder = write_rows("one")
    succeed(f"leaderboard {folder} --out board.md --out board.html")
    assert (tmp_path / "board.md").read_text().startswith("# Leaderboard")
    assert (tmp_path / "board.html").read_text().startswith("<!DOCTYPE html>")
    error = rejected(f"leaderboard {folder} --out board.doc")
    assert "must end in .md or .html" in error


def test_a_board_ranks_by_its_protocol_and_shows_contact(write_rows):
    folder = write_rows("one", protocol=PAPER_2020)
    board = board_of(folder)
    assert board.measure.key == "normalised_time_s_per_m"
    columns = ("time per meter as counted [s/m]", "time in contact [s]", "success [%]")
    assert " | ".join(columns) in markdown([board])
    (by_score,) = make_boards([folder], "challenge")
    assert "time in contact" not in markdown([by_score])
    board = board_of(write_rows("two"))
    assert board.measure.key == "challenge"


def test_a_board_begins_with_its_conclusion_and_cautions(write_rows):
    folder = write_rows("one_two", faster=2.0)
    board = board_of(folder)
    text = markdown([board])
    short, verdict, few, caption = text.split("\n\n")[2:6]
    assert re.fullmatch(r"gap ranks first; .* \(p = 0\.\d+, 8 worlds\)\.", short)
    failures = r"Failures in up to \d+\.\d% of gap's and \d+\.\d% of DWA's trials cannot be ruled out\."
    assert re.search(failures, verdict)
    assert few.startswith("Only 8 worlds: with fewer than 10")
    assert caption.startswith("Ranked by challenge metric")
    assert verdict in html.unescape(page([board]))
    assert few in page([board])
    assert board.places[0].better_than == []
    rewrite_rows(folder, lambda rows: [row for row in rows if row["world"] < 6])
    board = board_of(folder)
    assert board.notes[1:] == [f"{folder} is partial: 24 of 32 trials"]
    assert "one\\_two is partial: 24 of 32 trials" in markdown([board])


def board_of(*folders):
    """Return the only board of these folders."""
    (board,) = make_boards(folders)
    return board


def change_rows(folder, change):
    """Change the rows of a folder by what a function says of each."""
    rewrite_rows(folder, lambda rows: [row | change(row) for row in rows])


def planners_of(board):
    return [place.entry.planner for place in board.places]


def labels_of(board):
    return {place.entry.label for place in board.places}


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


SWEEPS = """
{sweep: {dwa.path_wieght: [1]}}
    did you mean 'dwa.path_weight'
{sweep: {max_speed_mps: [0.1]}, planners: 'gap,dwa'}
    a sweep needs exactly one planner, got gap, dwa
{sweep: {dwa.path_weight: []}}
    must be a list of values
{sweep: {dwa.path_weight: [[1]]}}
    a value must be a number, a string, true or false
{sweep: {dwa.path_weight: [0.5, 0.5]}}
    must not contain a value twice
"""


@pytest.mark.parametrize("options, words", answers_of(SWEEPS))
def test_what_is_no_sweep_is_refused_in_one_line(options, words, tmp_path):
    options = {"out": tmp_path} | yaml.safe_load(options)
    sweep = options.pop("sweep")
    with refused(words, BarnError):
        grid(read_request(None, options), sweep)


def test_a_sweep_of_too_many_settings_is_refused(tmp_path):
    sweep = {"dwa.path_weight": [0.1] * 21, "dwa.goal_weight": [0.1] * 20}
    with refused("may have at most 400 settings, got 420"):
        grid(read_request(None, {"out": tmp_path}), sweep)


@pytest.mark.parametrize("text", ["a", "=1", "a=[", "a=1,{"])
def test_texts_that_are_none_are_refused(text):
    with refused("--sweep", BarnError):
        parse_sweep([text])


def ros_request(out, command):
    """Return a request of a planner over ROS."""
    options = {"out": out, "mode": "ros", "planner_command": f"mine={command}"}
    return read_request(None, options)


def test_a_ros_parameter_goes_into_the_command(tmp_path):
    settings = grid(ros_request(tmp_path, "run me"), {"a.b": [1, 0.5]})
    for value, setting in zip(("1", "0.5"), settings, strict=True):
        (planner,) = setting.request.config.planners
        assert planner.command == f"run me --ros-args -p a.b:={value}"


def test_a_key_of_a_parameter_file_is_changed_in_a_copy(tmp_path):
    source = tmp_path / "given.yaml"
    source.write_text(yaml.safe_dump(FILE))
    request = ros_request(tmp_path / "out", f"run --ros-args --params-file {source}")
    sweep = {"FollowPath.speed": [0.3, 0.4], "planner.rate": [7]}
    settings = grid(request, sweep)
    again = grid(request, sweep)
    for speed, setting, same in zip((0.3, 0.4), settings, again, strict=True):
        assert setting.name == f"speed={speed},rate=7"
        assert setting.request == same.request  # so that it can be resumed
        setting.write_parameter_files()
        (path,) = setting.parameter_files
        (planner,) = setting.request.config.planners
        assert planner.command == f"run --ros-args --params-file {path}"
        changed = yaml.safe_load(path.read_text())
        controller = changed["controller"]["ros__parameters"]
        assert controller["FollowPath"] == {"speed": speed, "lookahead": 0.6}
        assert controller["rate"] == 20
        assert changed["planner"]["ros__parameters"]["rate"] == 7
    assert yaml.safe_load(source.read_text()) == FILE


@pytest.mark.parametrize(
    "key, words",
    [
        ("FollowPath.sped", "did you mean 'FollowPath.speed'"),
        ("rate", "has several parameters 'rate'; name the node"),
    ],
)
def test_a_key_that_a_parameter_file_has_not_is_refused(tmp_path, key, words):
    source = tmp_path / "given.yaml"
    source.write_text(yaml.safe_dump(FILE))
    with refused(words):
        grid(ros_request(tmp_path, f"run --params-file {source}"), {key: [1]})


def test_each_setting_is_a_run_and_the_best_comes_first(succeed, printed, tmp_path):
    out = tmp_path / "sweep"
    run = "run --worlds 0 --planner gap --execution engine=inline"
    settings = printed(f"{run} --sweep max_speed_mps=0.4,0.8 --out sweep")["settings"]
    assert [setting["max_speed_mps"] for setting in settings] == [0.8, 0.4]
    succeed(f"{run} --set max_speed_mps=0.4 --out alone")
    assert tables(out / "max_speed_mps=0.4") == tables(tmp_path / "alone")
    folders = map(parse_folder_name, find_setting_folders(out))
    assert list(folders) == [{"max_speed_mps": 0.4}, {"max_speed_mps": 0.8}]
    board = make_sweep_board(out)
    assert "up to 0.5 m/s, up to 1 m/s" in board.title
    assert board.notes[1].startswith("Compared across classes")
    rows = [row[:2] for row in sweep_table(board).rows]
    assert rows == [("gap", "0.8"), ("gap", "0.4")]


def test_python_has_a_column_per_parameter_and_a_figure(tmp_path):
    parameters = {"max_speed_mps": [0.5, 1.0], "k_prop_per_s": [1.0, 2.0]}
    options = {"engine": "inline", "out": tmp_path, "progress": False}
    frame = barn.sweep(parameters, worlds=0, planners="gap", **options)
    assert list(frame["max_speed_mps"][:2]) == [1.0, 1.0]
    assert set(frame["k_prop_per_s"]) == {1.0, 2.0}
    assert frame["level_with_best"].all()
