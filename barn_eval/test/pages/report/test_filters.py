"""A report's filters choose which trials, worlds and maps are shown.

Figures and tables stay those of all trials.
"""

import pytest
from browser import PHONE, violations

from barn_eval.pages.report.maps import order_by_contrast
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
WORLDS = "(all) => all.map((one) => Number(one.dataset.world))"
DRAWN = "[...document.querySelectorAll('#maps figure')].every((one) => one.dataset.drawn !== undefined)"


@pytest.fixture(scope="module")
def report(folder):
    return build_report([folder], hardest=0)


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
    """Return the places of the trials whose trajectories are on the maps."""
    page.locator("#maps").evaluate("(one) => one.scrollIntoView()")
    page.wait_for_function(DRAWN)
    maps = page.locator("#maps figure")
    texts = maps.evaluate_all("(all) => all.map((one) => one.dataset.drawn)")
    return {int(place) for text in texts for place in text.split()}


def test_trials_shown_are_those_left_and_figures_those_of_all(report, file, open_page):
    page = open_page(file)
    figures = page.locator(
        "figure svg, section > .wide table:not(#trials), .verdict, .bars"
    )
    before = figures.evaluate_all("(all) => all.map((one) => one.outerHTML)")
    assert len(before) > 10
    for values, keep in FILTERS.values():
        page.click("#filter-reset")
        choose(page, values)
        left = {p for p, drive in enumerate(report.trials) if keep(drive.result)}
        count = (
            f"{len(left)} of {len(report.trials)} trials" if left else "no trials match"
        )
        assert page.locator("#count").text_content() == count
        ids = page.locator("#trials tbody tr").evaluate_all(
            "(rows) => rows.map((row) => row.dataset.trial)"
        )
        assert ids == [report.trials[place].result.trial_id for place in sorted(left)]
        assert trajectories(page) == {
            p for p in left if report.trials[p].track is not None
        }
        worlds = {report.trials[place].result.world for place in left}
        order = [w for w in report.order.worlds[::-1] if w in worlds]
        assert page.locator("#maps figure").evaluate_all(WORLDS) == order
    assert figures.evaluate_all("(all) => all.map((one) => one.outerHTML)") == before


def test_maps_come_in_the_order_chosen_and_open_trials(report, file, open_page):
    page = open_page(file)
    tracks = {p for p, drive in enumerate(report.trials) if drive.track is not None}
    assert trajectories(page) == tracks
    worlds = page.locator("#maps figure")
    page.select_option("#sort-maps", "number")
    assert worlds.evaluate_all(WORLDS) == sorted(report.order.worlds)
    page.select_option("#sort-maps", "contrast")
    first = order_by_contrast(report.entries, report.order)[0]
    assert first in worlds.evaluate_all(WORLDS)
    page.locator(f"#maps figure[data-world='{first}'] canvas").press("Enter")
    page.wait_for_selector("body[data-opened]")
    opened = page.evaluate("document.body.dataset.opened")
    assert f"_w{first:04d}_" in opened


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
