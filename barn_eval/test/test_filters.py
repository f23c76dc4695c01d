"""A report's filters: each figure and table of the page is of the trials that they leave, with Python's own numbers."""

import re
from dataclasses import replace

import numpy as np
import pytest
from browser import PHONE, violations
from report_work import campaign, drive

from barn_eval.analysis.compare import compare
from barn_eval.analysis.difficulty import IN_BANDS, by_world
from barn_eval.analysis.measures import MEASURES
from barn_eval.analysis.reasons import sorted_by
from barn_eval.analysis.summary import summarise
from barn_eval.analysis.tables import band_name, comparison_table, headline_table, measures_table
from barn_eval.pages.report.page import build_report, report_page
from barn_eval.trials.protocol import CHALLENGE, DYNABARN
from barn_metrics.bootstrap import number, over_worlds

TIME = "normalised_time_s_per_m"
# What is set, and which results it leaves.
FILTERS = {
    "worlds": ({"filter-from": "2", "filter-to": "6"}, lambda one: 2 <= one.world <= 6),
    "failures": ({"filter-outcome": "failed"}, lambda one: not one.scores.success),
    "planner": ({"filter-planner": "DWA"}, lambda one: one.planner == "dwa"),
    "search": ({"search": "r00"}, lambda one: one.repetition == 0),
    "one world": ({"filter-from": "3", "filter-to": "3"}, lambda one: one.world == 3),
}


@pytest.fixture(scope="module", params=[CHALLENGE, DYNABARN], ids=lambda protocol: protocol.name)
def report(request, tmp_path_factory):
    place = tmp_path_factory.mktemp("filters")
    run = drive(place / "run", request.param)
    return build_report([campaign(place / "campaign", run, worlds=12, protocol=request.param)], hardest=12)


@pytest.fixture(scope="module")
def file(report, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(report_page(report, "Filters"), "utf-8")
    return path


def choose(page, chosen):
    """Set filters as a user does."""
    for name, value in chosen.items():
        if page.locator(f"select#{name}").count():
            page.select_option(f"#{name}", value)
        else:
            page.fill(f"#{name}", value)
    page.wait_for_function("!report.chosen.pending.length")


def left(report, keep):
    """Return the entries that have results left, with those."""
    entries = [replace(entry, results=tuple(filter(keep, entry.results))) for entry in report.entries]
    return [entry for entry in entries if entry.results]


def shown(page, name):
    """Return the cells of the table of that name, of the trials chosen."""
    cells = "(rows) => rows.map((row) => [...row.cells].map((cell) => cell.textContent))"
    return page.locator(f"table[data-table={name}] tbody tr").evaluate_all(cells)


def bare(text):
    """Return an estimate without its limits."""
    return re.sub(r" \[-?\d[^\]]*\]", "", text)


def as_shown(rows, columns):
    """Return rows of a table as the page writes them: with limits of success alone."""
    return [
        [cell if "success [%]" in (column, row[0]) else bare(cell) for column, cell in zip(columns, row, strict=True)]
        for row in rows
    ]


@pytest.mark.parametrize("kind", FILTERS)
def test_numbers_are_those_of_python_for_the_trials_left(report, file, open_page, kind):
    chosen, keep = FILTERS[kind]
    page, entries = open_page(file), left(report, keep)
    choose(page, chosen)
    labels = [entry.label for entry in entries]
    keys = tuple(report.overview.summaries[0].means)
    summaries = [summarise(entry.results, keys) for entry in entries]
    metric = MEASURES[report.overview.comparisons[0].metric]
    headline = headline_table(labels, summaries, metric)
    assert shown(page, "headline") == as_shown(headline.rows, headline.columns)
    if len(entries) == 2:
        driven = {row[0] for row in report.tables[1].rows}
        measures = measures_table(labels, summaries, [key for key in keys if MEASURES[key].heading in driven])
        assert shown(page, "measures") == as_shown(measures.rows, measures.columns)
        rows = comparison_table(compare(entries[0].results, entries[1].results)).rows
        expected = [[*map(bare, row[:4]), "not tested", *map(bare, row[5:])] for row in rows]
        assert shown(page, "paired_1") == expected
    names = next(table.columns[1:] for table in report.tables if table.name == "outcomes")
    counts = [[str(one.outcomes.get(name, 0)) for name in names] for one in summaries]
    assert shown(page, "outcomes") == [[label, *row] for label, row in zip(labels, counts, strict=True)]
    in_bands = []
    for band in report.overview.bands:
        for entry in entries:
            inside = summarise([one for one in entry.results if one.world in band.worlds], IN_BANDS)
            texts = [MEASURES[key].text(inside[key]) for key in IN_BANDS]
            texts = [text if key == "success" else bare(text) for key, text in zip(IN_BANDS, texts, strict=True)]
            in_bands += [[band_name(band), entry.label, str(inside.trials), *texts]] if inside.trials else []
    assert shown(page, "bands") == in_bands
    best = [summaries[place] for place in sorted_by(metric, summaries)]
    assert page.locator("#chosen-bars .text").all_text_contents() == [
        bare(metric.text(one[metric.key])) for one in best
    ]
    count = sum(len(entry.results) for entry in entries)
    verdict = page.locator("#chosen-verdict").text_content()
    assert verdict.startswith(f"Of {count} trial")
    assert labels[sorted_by(metric, summaries)[0]] in verdict
    assert page.locator("#count").text_content() == f"{count} of {len(report.drives)} trials"


def test_limits_that_are_drawn_are_those_of_a_percentile_bootstrap(report, file, open_page):
    page = open_page(file)
    choose(page, {"filter-from": "1"})
    for place, entry in enumerate(left(report, lambda one: one.world > 0)):
        estimate = f"(key) => window.report.chosen.estimate(key, window.report.chosen.groups[{place}], true)"
        rate, found = page.evaluate(estimate, "success"), page.evaluate(estimate, TIME)
        expected = MEASURES["success"].shown(summarise(entry.results)["success"])
        assert [rate["low"], rate["high"]] == pytest.approx([expected.low, expected.high], rel=1e-9)
        groups = [MEASURES[TIME].values(trials) for trials in by_world(entry.results).values()]
        sums, counts = np.array([part.sum() for part in groups]), np.array([len(part) for part in groups])
        limits = over_worlds(
            lambda drawn, sums=sums, counts=counts: sums[drawn].sum(-1) / counts[drawn].sum(-1),
            len(groups),
            method="percentile",
        )
        assert found["estimate"] == pytest.approx(limits.estimate, rel=1e-12)
        width = limits.high - limits.low  # a draw of 1000 moves a limit by a few percent of it
        assert [found["low"], found["high"]] == pytest.approx([limits.low, limits.high], abs=0.15 * width)


def test_every_figure_follows_the_filters_and_paper_has_all(report, file, open_page, screenshots):
    page = open_page(file)
    figures = [name for name in report.figures if name != "hardest"]

    def seen(kind):
        return [page.locator(f"#figure-{name} .{kind}").first.is_visible() for name in figures]

    def drawn():
        return [page.locator(f"#chosen-{name}").inner_html() for name in figures]

    def marks():
        visible = (
            "all.filter((one) => getComputedStyle(one).display !== 'none').map((one) => Number(one.id.split('-')[2]))"
        )
        return set(page.locator("[id^=hardest-trial-]").evaluate_all(f"(all) => {visible}"))

    tracks = {drive.place for drive in report.drives if drive.track is not None}
    assert (all(seen("of-all")), any(seen("of-chosen")), marks()) == (True, False, tracks)
    choose(page, {"search": "r00"})
    first = drawn()
    assert (any(seen("of-all")), all(seen("of-chosen"))) == (False, True)
    assert all("<path" in figure for figure in first)
    assert marks() == {place for place in tracks if report.drives[place].result.repetition == 0} != tracks
    choose(page, {"filter-planner": "DWA"})
    assert all(before != after for before, after in zip(first, drawn(), strict=True))
    page.emulate_media(media="print")
    assert (all(seen("of-all")), any(seen("of-chosen")), marks()) == (True, False, tracks)
    page.emulate_media(media="screen")
    page.click("#filter-reset")
    assert (all(seen("of-all")), any(seen("of-chosen")), marks()) == (True, False, tracks)
    choose(page, {"search": "no such"})
    assert page.locator("#chosen-verdict").text_content() == "Of 0 trials chosen in 0 worlds: none is left."


def test_a_band_of_difficulty_can_be_chosen(report, file, open_page):
    page = open_page(file)
    band = report.overview.bands[-1]
    choose(page, {"filter-band": band.name})
    assert {int(one) for one in page.locator("#trials tbody td:nth-child(2)").all_text_contents()} == set(band.worlds)
    points = page.evaluate("window.report.chosen.drawWorlds() && window.report.chosen.groups.flat().length")
    assert points == sum(one.trials for one in band.summaries)


@pytest.mark.parametrize("view", [{}, PHONE, {"color_scheme": "dark"}], ids=["desk", "phone", "dark"])
def test_a_filtered_page_is_whole_and_readable(file, open_page, screenshots, request, view):
    page = open_page(file, **view)
    page.locator("#filters").evaluate("(one) => { one.open = true }")
    choose(page, {"filter-band": "hardest"})
    page.screenshot(path=screenshots / f"report_filtered_{request.node.callspec.id}.png", full_page=True)
    assert page.evaluate("document.documentElement.scrollWidth") <= page.viewport_size["width"]
    colours = "[...document.querySelectorAll('figure svg text')].map((one) => getComputedStyle(one).fill)"
    assert set(page.evaluate(colours)) == {page.evaluate("getComputedStyle(document.body).color")}
    # axe cannot judge texts on drawings, which have the ink of the page, as just seen.
    assert [
        one for one in violations(page) if one[0] != "color-contrast" or not re.search(r"\[(x|y|transform)=", one[2][0])
    ] == []


def test_the_page_writes_numbers_as_python_does(file, open_page):
    values = [0.125, 2.5, 6.25, 12.25, 1.005, 0.5, 1.5, 99.95, -0.0004, -2.5, 0.0, 3.0, 1e9 + 0.5, 1 / 3, 87.5]
    cases = [[value, digits] for value in values for digits in range(4)]
    written = open_page(file).evaluate("(cases) => cases.map(([value, digits]) => number(value, digits))", cases)
    assert written == [number(value, digits) for value, digits in cases]


def test_a_filter_taken_back_at_once_leaves_the_page_as_it_came(file, open_page):
    page = open_page(file)
    page.evaluate("report.chosen.show([0]); report.chosen.show(null)")
    page.evaluate("new Promise((done) => setTimeout(done, 50))")  # figures out of view are drawn later
    assert page.evaluate("document.body.dataset.filtered") is None


def test_a_browser_that_cannot_unpack_still_filters_the_table_and_says_what_it_cannot(file, open_page, tmp_path):
    old = tmp_path / "old.html"
    text = file.read_text("utf-8")
    old.write_text(
        text.replace("<script>", "<script>delete globalThis.DecompressionStream;</script><script>", 1), "utf-8"
    )
    page = open_page(old)
    assert "this browser cannot unpack" in page.locator("#filter-problem").inner_text()
    page.select_option("#filter-planner", "DWA")
    assert page.locator("#count").inner_text() == "24 of 48 trials"
    assert page.evaluate("document.body.dataset.filtered") is None
