"""What the terminal shows.

Tables whole at any width from 60 columns on, and a campaign that runs.
"""

import io
import re
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest
from report_work import campaign
from results.test_rows import result
from rich.console import Console

import barn_eval
from barn_eval.analysis.summary import summarize_run
from barn_eval.analysis.tables import (
    MAX_RANKED,
    comparison_table,
    describe_failures,
    ranked_table,
    summary_table,
    trials_table,
)
from barn_eval.commands import options, run
from barn_eval.commands.main import main
from barn_eval.commands.run import print_results
from barn_eval.commands.tables import FittedTable, rich_table, table
from barn_eval.results.folder import read_results
from barn_eval.running import reporting
from barn_eval.running.pool import Notice
from barn_eval.running.reporting import (
    ConsoleReporter,
    Reporter,
    RunProgress,
    Verbosity,
    format_duration,
)
from barn_eval.running.runner import TrialLoss
from barn_eval.trials.result import Outcome

WIDTHS = (60, 80, 120)


@pytest.fixture(scope="module")
def folder(run, tmp_path_factory):
    campaign_folder = campaign(
        tmp_path_factory.mktemp("campaigns") / "a_campaign",
        run,
        planners=("gap", "dwa", "eband"),
        bags=1,
    )
    shutil.copytree(campaign_folder, campaign_folder.with_name("b"))
    return campaign_folder


def draw_table(fitted, width):
    file = io.StringIO()
    Console(file=file, width=width).print(fitted)
    return file.getvalue()


def check_whole(fitted):
    """Nothing is in the drawn table but the words of its cells and heads, and all of
    them are.
    """
    texts = [
        fitted.title,
        fitted.caption,
        *(text for column in fitted.columns for text in column),
    ]
    words = set(" ".join(texts).split())
    for width in WIDTHS:
        output = draw_table(fitted, width)
        assert max(map(len, output.splitlines())) <= width
        assert set(re.sub("─+", " ", output).split()) == words, width


LINES = """
compare a_campaign:dwa a_campaign:gap
compare a_campaign b
leaderboard a_campaign
leaderboard a_campaign --by time
precision a_campaign
precision a_campaign:dwa,gap
campaign --worlds 0-40 --planners dwa,eband --dry-run --out out
metrics --worlds 0-3
worlds list
difficulty predict barn300 --worlds 0-3
info
"""


@pytest.mark.parametrize("line", LINES.strip().splitlines())
def test_tables_of_commands_are_whole(folder, monkeypatch, line):
    # names of files are short: one that is wider than the terminal has to be broken
    monkeypatch.chdir(folder.parent)
    tables = []
    printed = options.console.print

    def record(*content, **look):
        tables.extend(item for item in content if isinstance(item, FittedTable))
        printed(*content, **look)

    monkeypatch.setattr(options.console, "print", record)
    with pytest.raises(SystemExit) as ended:
        main(line.split())
    assert ended.value.code == 0
    assert tables
    for fitted in tables:
        check_whole(fitted)


def test_tables_of_runs_and_campaigns_are_whole(folder):
    results = read_results(folder)
    summary = summarize_run(results)
    tables = [
        trials_table(results, "all"),
        ranked_table(summary),
        summary_table(summary.planners),
        *map(comparison_table, summary.comparisons),
    ]
    for fitted in tables:
        check_whole(rich_table(fitted))


def results_of(planners, worlds, step=0.01):
    """Return a success of each planner in each world, the first planner the fastest."""
    results = []
    for place, planner in enumerate(planners):
        for world in range(worlds):
            row = result(world)
            score = 0.4 - step * place
            scores = replace(row.scores, challenge=score)
            results.append(
                replace(row, planner=planner, protocol="challenge", scores=scores)
            )
    return results


def test_twenty_planners_fit_a_screen():
    names = [f"planner{number:02d}" for number in range(MAX_RANKED + 3)][::-1]
    lines = draw_table(
        rich_table(ranked_table(summarize_run(results_of(names, 8)))), 80
    ).splitlines()
    assert len(lines) < 40
    rows = [line.split() for line in lines if "planner" in line]
    assert [row[1] for row in rows[1:-1]] == names[:MAX_RANKED]
    assert "and 3 more planners" in " ".join(lines)


@pytest.mark.parametrize("width", [80, 120])
def test_a_run_of_twenty_planners_prints_at_most_40_lines(
    run, tmp_path, monkeypatch, capsys, width
):
    names = [f"planner{number:02d}" for number in range(MAX_RANKED)]
    out = campaign(tmp_path / "many", run, names, repetitions=1, bags=0, faster=0.1)
    monkeypatch.setattr(options.console, "width", width)
    print_results(SimpleNamespace(out=out), read_results(out), False, show_all=False)
    lines = "".join(capsys.readouterr()).splitlines()
    assert len(lines) <= 40
    assert max(map(len, lines[:-2])) <= width  # paths are whole, to be copied
    # On the wider terminal, an interval stands beside its estimate.
    intervals = [line for line in lines if re.search(r"\d \[", line)]
    assert len(intervals) == MAX_RANKED
    assert lines[-1] == f"next: barn report {out}"


@pytest.mark.parametrize("variables, is_colored", [({}, 1), ({"NO_COLOR": "1"}, 0)])
def test_outcomes_have_colors_unless_no_color(variables, is_colored):
    file = io.StringIO()
    console = Console(
        file=file, force_terminal=True, _environ={"TERM": "xterm"} | variables
    )
    ConsoleReporter(console).notify("success 3, timeout 1")
    assert (
        "\x1b[32msuccess\x1b[0m 3, \x1b[31mtimeout" in file.getvalue()
    ) == is_colored


def test_planners_that_a_test_separates_have_ranks_of_their_own():
    rows = ranked_table(summarize_run(results_of(["b", "a"], 12, 0.3))).rows
    assert [row[:2] for row in rows] == [["1", "b"], ["2", "a"]]


@pytest.mark.parametrize("worlds, has_intervals", [(5, False), (6, True)])
def test_few_worlds_have_no_intervals(worlds, has_intervals):
    table = ranked_table(summarize_run(results_of(["a", "b"], worlds)))
    assert any("[" in cell for cell in table.rows[0]) == has_intervals


@pytest.mark.parametrize(
    "planners, worlds, words",
    [
        ("a", 3, ""),
        (
            "ab",
            3,
            "3 worlds: too few to compare planners; run at least 6, or better 20",
        ),
        ("ab", 6, "a ranks first; its lead over b is not significant"),
    ],
)
def test_a_run_of_few_worlds_has_no_verdict(planners, worlds, words):
    summary = summarize_run(results_of(planners, worlds))
    verdict = run.conclude(summary, show_all=False)
    assert verdict.startswith(words) and bool(verdict) == bool(words)


def test_failures_take_a_line_and_explain_themselves():
    assert describe_failures([result(0)]) == ""
    crash = Outcome.PLANNER_DIED
    failures = [
        replace(
            row,
            outcome=outcome,
            detail=detail,
            scores=replace(row.scores, success=False),
        )
        for row, outcome, detail in (
            (result(0), Outcome.TIMEOUT, "2 m from the goal"),
            (result(1), crash, "KeyError: 'x'"),
            (result(2), crash, "KeyError: 'y'"),
        )
    ]
    assert describe_failures(failures).splitlines() == [
        "failures: DWA 2 planner_died, 1 timeout",
        "  planner_died, for example: KeyError: 'x'",
    ]


def test_columns_that_do_not_fit_go_below_and_repeat_the_first():
    columns = ("planner", *(f">measure{number} [m/s]" for number in range(12)))
    rows = [
        ("dwa", *["-12.345 [-13.456, -11.234]"] * 12),
        ("eband", *["<0.001 *"] * 12),
    ]
    fitted = table(columns, rows)
    check_whole(fitted)
    assert (
        draw_table(fitted, 60).count("eband")
        > draw_table(fitted, 120).count("eband")
        > 1
    )
    assert all(
        "*" not in line.split("<0.001")[0]
        for line in draw_table(fitted, 60).splitlines()
        if "*" in line
    )


@pytest.mark.parametrize(
    "width, lines",
    [(60, ["a 12.345 [11.111, 13.333] *"]), (30, ["a 12.345", "[11.111, 13.333] *"])],
)
def test_limits_go_below_estimates_on_narrow_terminals(width, lines):
    fitted = table(("measure", ">E-Band"), [("a", "12.345 [11.111, 13.333] *")])
    body = draw_table(fitted, width).rpartition("─")[2].splitlines()
    assert [" ".join(line.split()) for line in body if line.strip()] == lines


def test_only_a_word_wider_than_the_terminal_is_broken():
    fitted = table(("name", "path"), [("dwa", "/" + "a" * 100)])
    output = draw_table(fitted, 60)
    assert max(map(len, output.splitlines())) <= 60
    assert output.count("a") == 100 + sum(
        text.count("a") for text in ("dwa", "name", "path")
    )


def test_an_empty_table_has_its_head():
    assert "nothing there" in " ".join(
        draw_table(table(("nothing there", ">b"), []), 60).split()
    )


def test_there_is_no_other_way_to_a_table():
    package = Path(barn_eval.__file__).parent
    users = [
        path.name
        for path in package.rglob("*.py")
        if "rich.table import Table" in path.read_text("utf-8")
    ]
    assert users == ["tables.py"]


@pytest.fixture
def show(monkeypatch):
    """Takes one event every two seconds; returns the text shown and the last state."""
    # A clock that is moved by hand.
    clock = SimpleNamespace(now=100.0, monotonic=lambda: clock.now)
    monkeypatch.setattr(reporting, "time", clock)

    def take(total, earlier, events, make_reporter=ConsoleReporter, **look):
        console = Console(file=io.StringIO(), **{"width": 200} | look)
        progress = RunProgress(total, earlier, make_reporter(console))
        with progress.reporter.show_progress(progress):
            for event in events:
                clock.now += 2.0
                progress.take(event)
            text = progress.text()
        return console.file.getvalue(), text

    return take


def test_progress_figures_are_those_of_the_session(show):
    _, text = show(100, [result(90)], [result(number) for number in range(9)])
    # nine trials of 12 simulated seconds in 18 seconds, 90 to go
    assert text == "30.0/min, 6.0 x real time, 0:03:00 left, success 10"


def test_lines_come_now_and_then_and_at_the_end(show):
    output, _ = show(101, [result(0)] * 70, [result(number) for number in range(31)])
    lines = output.splitlines()
    assert [line.split()[0] for line in lines] == ["85/101", "100/101", "101/101"]
    assert (
        lines[-1]
        == "101/101 trials, 30.0/min, 6.0 x real time, in 0:01:02, success 101"
    )


def test_trials_of_a_small_experiment_have_a_line_each(show):
    slow = replace(
        result(2),
        outcome=Outcome.TIMEOUT,
        detail="too slow",
        scores=replace(result(2).scores, success=False),
    )
    output, _ = show(3, [result(0)], [result(1), slow])
    first, second, _ = output.splitlines()
    assert first == "[2/3] dwa_w0001_r00: success in 10.10 s"
    assert second == "[3/3] dwa_w0002_r00: timeout (too slow)"


@pytest.mark.parametrize(
    "verbosity, trial_lines, progress_lines",
    [(Verbosity.QUIET, 0, 0), (Verbosity.NORMAL, 0, 1), (Verbosity.VERBOSE, 11, 1)],
)
def test_trials_of_a_larger_run_have_lines_if_asked_for(
    show, verbosity, trial_lines, progress_lines
):
    make_reporter = partial(ConsoleReporter, verbosity=verbosity)
    output, _ = show(11, [], [result(number) for number in range(11)], make_reporter)
    lines = output.splitlines()
    assert sum(line.startswith("[") for line in lines) == trial_lines
    assert sum("real time" in line for line in lines) == progress_lines


def test_a_terminal_shows_the_planners_as_they_drive(show):
    events = results_of(["dwa", "gap"], 6)
    output, _ = show(12, [], events, force_terminal=True, width=80)
    shown = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", output)
    rows = [line.split() for line in shown.splitlines()]
    assert ["dwa", "6", "100%", "0.400"] in rows
    assert ["gap", "6", "100%", "0.390"] in rows


def test_what_is_waited_for_is_said_once(show):
    waiting = [Notice("dwa", "local-0", "waiting for /scan")] * 3
    output, _ = show(1, [], [*waiting, result(1), *waiting[:1]])
    assert output.count("waiting for /scan") == 1


@pytest.mark.parametrize("width", [60, 80, 120])
def test_a_narrow_terminal_shows_progress_whole(show, width):
    results = [
        replace(result(number), outcome=outcome)
        for number, outcome in enumerate(Outcome)
    ]
    output, text = show(3000, results, [result(100)], force_terminal=True, width=width)
    last = re.split(r"\x1b\[[0-9;?]*[A-Za-z]", output)
    words = set(" ".join(last).replace(",", " ").split())
    assert "\x1b[" in output
    assert {f"{len(Outcome) + 1}/3000", "30.0/min", "left"} <= words
    assert set(text.replace(",", " ").split()) <= words


def test_losses_are_told_at_once(show):
    loss = TrialLoss("dwa_w0001_r00", 1, "its worker process was killed by SIGKILL")
    output, _ = show(2, [], [loss])
    assert output.startswith(
        "dwa_w0001_r00: attempt 1 was lost: its worker process was killed by SIGKILL\n"
    )


def test_a_library_logs_what_a_command_prints(show, caplog):
    caplog.set_level("INFO", "barn_eval")
    loss = TrialLoss("dwa_w0001_r00", 1, "it was killed")
    show(2, [], [loss, result(1)], lambda _: Reporter())
    assert [(record.levelname, record.message) for record in caplog.records] == [
        ("WARNING", "dwa_w0001_r00: attempt 1 was lost: it was killed"),
        ("INFO", "[1/2] dwa_w0001_r00: success in 10.10 s"),
        ("INFO", "1/2 trials, 15.0/min, 3.0 x real time, 0:00:04 left, success 1"),
    ]


def test_durations_are_read_at_a_glance():
    assert [format_duration(value) for value in (0.4, 59.6, 3725.0, 90000.0)] == [
        "0:00:00",
        "0:01:00",
        "1:02:05",
        "25:00:00",
    ]
