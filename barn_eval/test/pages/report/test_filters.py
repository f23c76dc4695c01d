"""A report's filters choose which trials, worlds and maps are shown.

Figures and tables stay those of all trials.
"""

import pytest
from browser import PHONE, violations

from barn_eval.pages.report.page import build_report, report_page

# What is set, and which results it leaves.
FILTERS = {
    "worlds": (
        {"filter-from": "2", "filter-to": "6"},
        lambda result: 2 <= result.world <= 6,
    ),
    "failures": (
        {"filter-outcome": "failed"},
        lambda result: not result.scores.success,
    ),
    "planner": ({"filter-planner": "DWA"}, lambda result: result.planner == "dwa"),
    "search": ({"search": "r00"}, lambda result: result.repetition == 0),
    "one world": (
        {"filter-from": "3", "filter-to": "3"},
        lambda result: result.world == 3,
    ),
    "nothing": ({"search": "no such"}, lambda result: False),
}
NUMBERS = "map((one) => Number(one.id.split('-')[2]))"
SHOWN = (
    f"(all) => all.filter((one) => getComputedStyle(one).display !== 'none').{NUMBERS}"
)
FAINT = f"(all) => all.filter((one) => getComputedStyle(one).opacity < 1).{NUMBERS}"


@pytest.fixture(scope="module")
def report(folder):
    return build_report([folder], hardest=8)


@pytest.fixture(scope="module")
def file(report, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(report_page(report, "Filters"), "utf-8")
    return path


def choose(page, values):
    """Set filters as a user does."""
    for name, value in values.items():
        if page.locator(f"select#{name}").count():
            page.select_option(f"#{name}", value)
        else:
            page.fill(f"#{name}", value)


def trajectories(page):
    """Return the places of the trials whose trajectories are seen."""
    return set(page.locator("[id^=hardest-trial-]").evaluate_all(SHOWN))


def test_trials_shown_are_those_left_and_figures_those_of_all(report, file, open_page):
    page = open_page(file)
    figures = page.locator(
        "figure:not(#figure-hardest) svg, section > .wide table:not(#trials), .verdict, .bars"
    )
    before = figures.evaluate_all("(all) => all.map((one) => one.outerHTML)")
    assert len(before) > 10
    for values, keep in FILTERS.values():
        page.click("#filter-reset")
        choose(page, values)
        left = {drive.position for drive in report.trials if keep(drive.result)}
        count = (
            f"{len(left)} of {len(report.trials)} trials" if left else "no such trial"
        )
        assert page.locator("#count").text_content() == count
        ids = page.locator("#trials tbody tr").evaluate_all(
            "(rows) => rows.map((row) => row.dataset.trial)"
        )
        assert ids == [
            drive.result.trial_id for drive in report.trials if drive.position in left
        ]
        assert (
            trajectories(page)
            == {drive.position for drive in report.trials if drive.track is not None}
            & left
        )
        worlds = {report.trials[place].result.world for place in left}
        map_worlds = {drive.result.world for drive in report.trials}
        assert (
            set(page.locator("[id^=hardest-world-]").evaluate_all(FAINT))
            == map_worlds - worlds
        )
    assert figures.evaluate_all("(all) => all.map((one) => one.outerHTML)") == before


def test_paper_and_a_filter_taken_back_show_all(report, file, open_page):
    page = open_page(file)
    tracks = {drive.position for drive in report.trials if drive.track is not None}
    assert trajectories(page) == tracks
    choose(page, {"search": "r01"})
    assert (
        trajectories(page)
        == {place for place in tracks if report.trials[place].result.repetition == 1}
        != tracks
    )
    page.emulate_media(media="print")
    assert trajectories(page) == tracks
    page.emulate_media(media="screen")
    page.click("#filter-reset")
    assert trajectories(page) == tracks


def test_a_band_of_difficulty_can_be_chosen(report, file, open_page):
    page = open_page(file)
    band = report.overview.bands[-1]
    choose(page, {"filter-band": band.name})
    assert {
        int(cell)
        for cell in page.locator("#trials tbody td:nth-child(2)").all_text_contents()
    } == set(band.worlds)


def test_a_filtered_page_is_whole_and_readable(file, open_page, screenshots):
    page = open_page(file, **PHONE, color_scheme="dark")
    page.locator("#filters").evaluate("(one) => { one.open = true }")
    choose(page, {"filter-band": "hardest"})
    page.screenshot(path=screenshots / "report_filtered.png", full_page=True)
    assert (
        page.evaluate("document.documentElement.scrollWidth")
        <= page.viewport_size["width"]
    )
    assert violations(page) == []
