"""The figures of a report.

Of the width and type of a paper, on axes of others, in the colors of the page.
"""

import re
from collections import Counter
from dataclasses import replace

import pytest
from matplotlib import rcParams
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.text import Text
from refusals import refused

from barn_eval.pages.figures import Plot, figure_of, style
from barn_eval.pages.report import maps
from barn_eval.pages.report.charts import CHARTS
from barn_eval.pages.report.page import draw, plot
from barn_eval.pages.template import render
from barn_eval.trials.protocol import CHALLENGE
from barn_eval.trials.result import Outcome
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.drawing.palette import FAINT, INK, ON_DARK

SHOWN = [
    chart for chart in CHARTS.values() if chart.name != "sweep"
]  # which is of sweeps alone
INKED = (
    "text.color",
    "axes.edgecolor",
    "axes.labelcolor",
    "axes.titlecolor",
    "xtick.color",
    "ytick.color",
)


def test_trials_without_a_track_say_so(report):
    message = "no track of this trial was kept, so there is no trajectory to show"
    problems = Counter(
        (drive.track is not None, drive.problem) for drive in report.trials
    )
    assert problems == {(True, ""): 3, (False, message): len(report.trials) - 3}


def test_planners_have_the_colors_of_the_page_in_its_figures(report):
    svg = report.figures["worlds"].element
    color = report.entries[0].color
    assert f"var(--c-{color[1:]}, {color})" in svg
    assert "currentColor" in svg
    style = render("colors.css")
    dark = style[style.index("@media screen and (prefers-color-scheme: dark)") :]
    assert all(f"--c-{color[1:]}: #" in dark for color in ON_DARK)


def test_differences_favor_the_planner_named_on_their_side(report):
    with style():
        first, *rest = draw(CHARTS["paired"], report)
    titles = [" ".join(axes.get_title(loc="left").split()) for axes in (first, *rest)]
    time = "time per meter as counted"
    assert titles == ["challenge metric", "success", time, "better in a trial"]
    (comparison,) = report.overview.comparisons
    assert comparison.a == "gap"

    def difference(key):
        return comparison.row(key).paired.difference.estimate

    assert difference("traversal_time_s") == pytest.approx(-0.3)  # gap is faster
    (label,) = first.get_yticklabels()
    assert label.get_text() == "DWA \u25c2 \u25b8 gap"
    inverted = [axes.xaxis_inverted() for axes in (first, *rest)]
    assert inverted == [False, False, True, False]
    assert first.lines[1].get_xydata().tolist() == [[difference("challenge"), 0.0]]


def test_speed_is_drawn_over_safety_with_the_limits_of_both(report):
    (axes,) = draw(CHARTS["trade"], report)
    for place, summary in enumerate(report.overview.summaries):
        (line, _, (across, up)) = axes.containers[place]
        time = summary["normalised_time_s_per_m"]
        clearance = summary["min_clearance_m"]
        assert line.get_xydata().tolist() == [[clearance.estimate, time.estimate]]
        (width,), (height,) = across.get_segments(), up.get_segments()
        assert width[:, 0] == pytest.approx([clearance.low, clearance.high])
        assert height[:, 1] == pytest.approx([time.low, time.high])


def test_the_style_has_the_colors_of_the_palette():
    with style():
        colors = {key: to_hex(rcParams[key]) for key in (*INKED, "grid.color")}
    assert colors == dict.fromkeys(INKED, INK) | {"grid.color": FAINT}


@pytest.mark.parametrize("width_mm", [88.0, 180.0])
@pytest.mark.parametrize("chart", SHOWN, ids=lambda item: item.name)
def test_figures_of_a_paper_have_its_width_and_type_of_7_to_9_pt(
    report, chart, width_mm
):
    with style(width_mm):
        figure = figure_of(draw(chart, report, width_mm=width_mm))
    assert figure.get_figwidth() == pytest.approx(width_mm / 25.4)
    sizes = {text.get_fontsize() for text in figure.findobj(Text) if text.get_text()}
    assert sizes and all(7.0 <= size <= 9.0 for size in sizes)


def test_a_pdf_has_its_fonts_embedded(report, tmp_path):
    axes = plot("trade", report.entries, width_mm=88.0)
    file = Plot(figure_of(axes), "").save(tmp_path / "trade.pdf")
    content = file.read_bytes()
    assert content.count(b"/FontFile2") >= 1 and b"/Type3" not in content
    with refused("width_mm: must lie in 60 to 400, got 8"):
        plot("trade", report.entries, width_mm=8)


@pytest.mark.parametrize("chart", SHOWN, ids=lambda item: item.name)
def test_a_figure_can_be_drawn_onto_axes_of_others(report, chart):
    figure_panels = plot(chart.name, report.entries)
    count = len(figure_panels)
    panels = Figure().subplots(1, count, squeeze=False)[0]
    drawn = plot(chart.name, report.entries, ax=panels[0] if count == 1 else panels)
    assert drawn == list(panels)

    def content(axes):
        lines = [line.get_xydata().tolist() for line in axes.lines]
        return axes.get_title(), axes.get_xlabel(), repr(lines)

    assert list(map(content, panels)) == list(map(content, figure_panels))
    with refused(f"'{chart.name}' needs one axes per panel: {count}, got {count + 1}"):
        plot(chart.name, report.entries, ax=[panels[0]] * (count + 1))


def test_a_figure_that_there_is_nothing_for_is_refused(report):
    with refused("unknown figure 'wrlds'; did you mean 'worlds'"):
        plot("wrlds", report.entries)
    with refused("figure 'paired': these results have no data for it"):
        plot("paired", report.entries[:1])
    assert set(CHARTS) == {*report.figures, "sweep"}


@pytest.mark.parametrize("name", ["hardest", "trails"])
def test_worlds_are_shown_from_start_to_goal(report, name):
    axes = plot(name, report.entries)[0]
    number = int(re.match(r"world (\d+)", axes.get_title(loc="left"))[1])
    course = CHALLENGE.course(open_dataset("barn300").load(number))
    (left, right), (below, above) = axes.get_xlim(), axes.get_ylim()
    for label, pose in (("start", course.start), ("goal", course.goal)):
        # Trails end with the planner's marker, which may be the same.
        line = next(line for line in axes.lines if line.get_label() == label)
        assert tuple(line.get_xydata()[0]) == pose.position
        assert left < pose.x < right and below < pose.y < above


def test_a_success_after_a_failure_ends_without_a_cross(report):
    trial = next(trial for trial in report.trials if trial.track is not None)
    outcomes = (Outcome.TIMEOUT, Outcome.SUCCESS, Outcome.COLLISION, Outcome.SUCCESS)
    drives = []
    for outcome in outcomes:
        is_success = outcome is Outcome.SUCCESS
        scores = replace(trial.result.scores, success=is_success)
        result = replace(trial.result, outcome=outcome, scores=scores)
        drives.append(replace(trial, result=result))
    axes = Figure().subplots()
    maps._draw_map(report, axes, trial.world, drives)
    crosses = [line for line in axes.lines if line.get_marker() == "x"]
    assert len(crosses) == 2
