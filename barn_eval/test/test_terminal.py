"""Tables on the terminal: at any width from 60 columns on, every word and number is whole."""

import io
import re
import shutil
from pathlib import Path

import pytest
from report_work import campaign
from rich.console import Console

import barn_eval
from barn_eval.analysis.summary import summarise_campaign
from barn_eval.analysis.tables import comparison_table, summary_table, trials_table
from barn_eval.commands import options
from barn_eval.commands.main import main
from barn_eval.commands.tables import FittedTable, rich_table, table
from barn_eval.experiments.folder import read_results

WIDTHS = (60, 80, 120)


@pytest.fixture(scope="module")
def folder(run, tmp_path_factory):
    made = campaign(tmp_path_factory.mktemp("campaigns") / "a_campaign", run, planners=("gap", "dwa", "eband"), bags=1)
    shutil.copytree(made, made.with_name("b"))
    return made


@pytest.fixture
def tables(monkeypatch):
    """The tables that commands print."""
    found = []
    printed = options.console.print

    def record(*content, **look):
        found.extend(one for one in content if isinstance(one, FittedTable))
        printed(*content, **look)

    monkeypatch.setattr(options.console, "print", record)
    return found


def drawn(made, width):
    file = io.StringIO()
    Console(file=file, width=width).print(made)
    return file.getvalue()


def check_whole(made):
    """Nothing is in the drawn table but the words of its cells and heads, and all of them are."""
    texts = [made.title, made.caption, *(text for column in made.columns for text in column)]
    words = set(" ".join(texts).split())
    for width in WIDTHS:
        shown = drawn(made, width)
        assert max(map(len, shown.splitlines())) <= width
        assert set(re.sub("─+", " ", shown).split()) == words, width


@pytest.mark.parametrize(
    "command",
    [
        ["compare", "a_campaign:dwa", "a_campaign:gap"],
        ["compare", "a_campaign", "b"],
        ["leaderboard", "a_campaign"],
        ["leaderboard", "a_campaign", "--by", "time"],
        ["precision", "a_campaign"],
        ["precision", "a_campaign:dwa,gap"],
        ["campaign", "--worlds", "0-40", "--planners", "dwa,eband", "--dry-run", "--out", "out"],
        ["metrics", "--worlds", "0-3"],
        ["worlds", "list"],
        ["difficulty", "predict", "barn300", "--worlds", "0-3"],
        ["info"],
    ],
    ids=lambda command: " ".join(command[:2]),
)
def test_tables_of_commands_are_whole(folder, tables, monkeypatch, command):
    monkeypatch.chdir(folder.parent)  # names of files are short: one that is wider than the terminal has to be broken
    with pytest.raises(SystemExit) as ended:
        main(command)
    assert ended.value.code == 0
    assert tables
    for made in tables:
        check_whole(made)


def test_tables_of_runs_and_campaigns_are_whole(folder):
    results = read_results(folder)
    found = summarise_campaign(results)
    made = [trials_table(results, "all"), summary_table(found.planners), *map(comparison_table, found.comparisons)]
    for one in made:
        check_whole(rich_table(one))


def test_columns_that_do_not_fit_go_below_and_repeat_the_first():
    columns = ("planner", *(f">measure{number} [m/s]" for number in range(12)))
    rows = [("dwa", *["-12.345 [-13.456, -11.234]"] * 12), ("eband", *["<0.001 *"] * 12)]
    made = table(columns, rows)
    check_whole(made)
    assert drawn(made, 60).count("eband") > drawn(made, 120).count("eband") > 1
    assert all("*" not in line.split("<0.001")[0] for line in drawn(made, 60).splitlines() if "*" in line)


def test_limits_stay_on_one_line():
    made = table(("measure", ">a"), [("a word " * 12, "1.234 [-1.000, 2.000]")])
    assert "[-1.000, 2.000]" in drawn(made, 60)


def test_a_word_that_is_wider_than_the_terminal_is_the_only_one_broken():
    made = table(("name", "path"), [("dwa", "/" + "a" * 100)])
    shown = drawn(made, 60)
    assert max(map(len, shown.splitlines())) <= 60
    assert shown.count("a") == 100 + sum(text.count("a") for text in ("dwa", "name", "path"))


def test_an_empty_table_has_its_head():
    assert "nothing there" in " ".join(drawn(table(("nothing there", ">b"), []), 60).split())


def test_there_is_no_other_way_to_a_table():
    package = Path(barn_eval.__file__).parent
    users = [path.name for path in package.rglob("*.py") if "rich.table import Table" in path.read_text("utf-8")]
    assert users == ["tables.py"]
