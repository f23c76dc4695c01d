"""Anybody's tables: read, refused in one line, compared and ranked with each other."""

import pytest
from refusals import refused
from text_tables import rows_of

from barn_eval.analysis.leaderboard import make_boards
from barn_eval.analysis.sources import read_source
from barn_eval.results.table_files import read_table_file

HEAD = "planner,world,repetition,outcome,time\n"


def line(planner, world, time_s):
    outcome = "success" if time_s else "collision"
    return f"{planner},{world},0,{outcome},{time_s or ''}\n"


@pytest.fixture
def table(tmp_path):
    """Two planners in twelve worlds; one is slower everywhere and fails twice."""
    lines = [line("mine", world, 20.0 + 0.1 * world) for world in range(12)]
    for world in range(12):
        lines.append(line("theirs", world, 0 if world in (3, 7) else 30.0 + world))
    path = tmp_path / "lab.csv"
    path.write_text(HEAD + "".join(lines))
    return path


@pytest.fixture
def outs(tmp_path):
    """The challenge's out.txt of two planners."""
    for name, time_s in (("mine", 18.0), ("theirs", 25.0)):
        lines = []
        for world in range(0, 300, 30):
            flags = "0 1 0" if world == 270 else "1 0 0"
            metric = 0.0 if world == 270 else 5.0 / time_s
            lines.append(f"{world} {flags} {time_s:.4f} {metric:.4f}\n")
        (tmp_path / f"{name}.txt").write_text("".join(lines))
    return tmp_path / "mine.txt", tmp_path / "theirs.txt"


def test_what_a_table_lacks_is_unknown(table):
    row = read_table_file(table)[-5]
    assert (row.planner, row.world, row.outcome.value) == ("theirs", 7, "collision")
    scores = row.scores
    assert scores.traversal_time_s is scores.challenge is scores.efficiency is None
    assert row.measures.contacts is row.measures.min_clearance_m is None
    assert row.observed.system == "a table"


def test_planners_of_a_table_are_compared(table, printed):
    (comparison,) = printed(f"compare {table}")
    rows = {row["key"]: row for row in comparison["rows"]}
    assert rows["success"]["paired"]["worlds"] == 12
    times = rows["traversal_time_s"]["paired"]
    assert (times["worlds"], times["p"] < 0.01) == (10, True)
    assert times["difference"]["high"] < 0.0
    assert rows["driven_m"]["paired"]["worlds"] == 0
    assert "contacts of 24 of 24 trials are unknown" in " ".join(comparison["notes"])


def test_the_challenges_files_are_compared_and_ranked(outs, printed):
    mine, theirs = outs
    (comparison,) = printed(f"compare {mine} {theirs}")
    assert comparison["metric"] == "challenge"
    assert comparison["verdict"].startswith("mine ranks first")
    (board,) = make_boards(list(outs))
    assert "a table, observed, not driven again" in board.title
    assert [place.entry.planner for place in board.places] == ["mine", "theirs"]
    assert board.places[0].summary["success"].estimate == 0.9


def test_a_table_is_not_compared_with_what_was_driven(table, two_trials, rejected):
    error = rejected(f"compare {table}:mine {two_trials}")
    assert "different systems cannot be compared: name is 'a table'" in error
    titles = [board.title for board in make_boards([table, two_trials])]
    assert len(titles) == 2


def test_repetitions_that_are_not_numbered_count_in_their_order(tmp_path):
    path = tmp_path / "plain.csv"
    path.write_text("world,outcome,planner,time\n" + 3 * "5,success,a b,9.5\n\n")
    names = [row.trial_id for row in read_table_file(path)]
    assert names == ["a b_w0005_r00", "a b_w0005_r01", "a b_w0005_r02"]
    assert read_source(path).planned is None


# Lines of a table end in a semicolon here; HEAD stands for its head.
BAD_TABLES = """
                        | once: planner, world, outcome and perhaps .*, got none
HEAD,time;              | each once: .*, time, time
planner,world,outcom;   | got planner, world, outcom.*did you mean 'outcome'
HEAD;                   | holds no trials
HEAD;a,0,0,won,1;       | line 2: unknown outcome 'won'
HEAD;a,0,0,sucess,1;    | did you mean 'success'
HEAD;a,-1,0,success,1;  | line 2: world '-1': must be a number of 0 or more
HEAD;a,1.5,0,timeout,;  | line 2: world '1.5': must be a whole number
HEAD;a,1,0,success,nan; | line 2: time 'nan': must be a number of 0
HEAD;a,1,0,success,1_0; | line 2: time '1_0': must be a number of 0
HEAD;a,1,0,success,;    | line 2: a success needs a time
HEAD;a,1,0,success;     | line 2: has 4 of 5 values
HEAD;a,1,0,timeout,;a,1,0,timeout,; | line 3: trial a_w0001_r00 is listed twice
HEAD;,1,0,timeout,;     | line 2: planner '': must be a name
"""


@pytest.mark.parametrize("text, words", rows_of(BAD_TABLES))
def test_a_bad_table_is_refused_in_one_line(tmp_path, text, words):
    path = tmp_path / "bad.csv"
    path.write_text(text.replace("HEAD", HEAD.strip()).replace(";", "\n"))
    with refused(words, longest=600):
        read_table_file(path)


def test_a_bad_out_file_is_refused_in_one_line(tmp_path):
    path = tmp_path / "out.txt"
    path.write_text("0 1 0 0 18.0 0.25\n0 1 1 0 18.0 0.25\n")
    with refused("line 2: must be world success collision timeout time metric"):
        read_table_file(path)
