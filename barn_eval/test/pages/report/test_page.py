"""Reports: figures that are those of the statistics, one file that needs nothing else,
and a page that works.
"""

import base64
import copy
import csv
import html
import json
import operator
import re
import shlex
import shutil
import zlib
from dataclasses import replace

import numpy as np
import pytest
from browser import violations
from refusals import refused
from report_work import EVIL, campaign, recorded_track, rewrite_rows

from barn_eval.analysis.entries import read_entries
from barn_eval.analysis.overview import reproduce
from barn_eval.analysis.significance import proportion
from barn_eval.analysis.sources import Source, read_source
from barn_eval.analysis.summary import make_bars
from barn_eval.analysis.text_table import TextTable, latex_text
from barn_eval.api.results import report as write_folders
from barn_eval.commands.run import command as run_command
from barn_eval.pages.figures import DASHES, MARKERS
from barn_eval.pages.latex import latex_table
from barn_eval.pages.report import page as report_module
from barn_eval.pages.report.charts import CHARTS
from barn_eval.pages.report.page import build_report, draw, report_page, write_assets
from barn_eval.pages.report.trials import page_data, world_part
from barn_eval.pages.template import script_json, themed
from barn_eval.results.folder import read_results
from barn_eval.results.tracks import MISSING_SAMPLE
from barn_eval.running.request import read_request
from barn_eval.trials.run_config import RunConfig
from barn_worlds.base.config import as_dict
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.drawing.palette import PLANNERS


@pytest.fixture(scope="module")
def page(report):
    return report_page(report, "A <b>title</b>")


def test_the_page_needs_nothing_but_itself(page):
    targets = re.findall(r"""(?:src|href)\s*=\s*["']([^"']*)""", page)
    assert targets
    assert all(target.startswith(("#", "data:")) for target in targets)
    assert "@import" not in page
    assert not re.findall(r"url\((?!#)", page)


def test_names_from_files_are_escaped(page):
    assert EVIL not in page
    assert "window.evil" in page  # as text
    assert page.count("<script") == page.count("</script>") == 2
    assert "A &lt;b&gt;title" in page


def test_json_within_a_script_cannot_leave_it():
    text = script_json({"a": "</script><!--\u2028\u2029&", "b": float("nan")})
    assert not set("<>&\u2028\u2029") & set(text)
    assert '"b":null' in text


def test_latex_takes_any_text():
    assert latex_text("50% of a_b & {c}\n") == r"50\% of a\_b \& \{c\} "
    text = r"$-$0.5 [$-$1.0, 2.0] a-1 2-3 \textless{}x\textgreater{}"
    assert latex_text("-0.5 [-1.0, 2.0] a-1 2-3 <x>") == text
    table = TextTable("t", "title", ("a", "b"), (("x_1", "2"),))
    assert r"x\_1 & 2 \\" in latex_table(table)
    assert table.csv() == "a,b\nx_1,2\n"


def test_figures_are_those_of_the_statistics(report, folder, tmp_path):
    results = [result for result in read_results(folder) if result.planner == "gap"]
    successes = np.array([result.scores.success for result in results], int)
    worlds = np.array([result.world for result in results])
    rate = proportion(successes, worlds)
    write_assets(report, tmp_path)
    with (tmp_path / "headline.csv").open(newline="") as file:
        (gap,) = (row for row in csv.DictReader(file) if row["planner"] == "gap")
    limits = f"[{100 * rate.low:.1f}, {100 * rate.high:.1f}]"
    assert gap["success [%]"] == f"{100 * rate.estimate:.1f} {limits}"
    names = {path.name for path in tmp_path.iterdir()}
    charts = "worlds trade bands outcomes paired distributions compute trails hardest"
    for name in charts.split():
        assert {f"{name}.svg", f"{name}.pdf"} <= names
    for name in ("headline", "bands", "measures", "outcomes", "paired_1"):
        assert {f"{name}.csv", f"{name}.tex"} <= names
    assert r"\toprule" in (tmp_path / "headline.tex").read_text()


def test_worlds_are_ordered_from_easy_to_difficult(report, folder):
    order = report.order
    assert list(order.mean_s_per_m) == sorted(order.mean_s_per_m)
    results = [result for result in read_results(folder) if result.world == 3]
    mean = np.mean([result.scores.normalised_time_s_per_m for result in results])
    assert order.mean_s_per_m[order.worlds.index(3)] == pytest.approx(mean)
    assert [len(band.worlds) for band in report.overview.bands] == [4, 4]


def test_a_packed_track_is_the_trajectory_to_within_its_steps(run):
    world = open_dataset("barn300").load(0)
    track = recorded_track(run / "bags" / "gap_w0000_r00", world)
    packed = track.packed
    data = zlib.decompress(base64.b64decode(packed["zlib"]))
    kind, offset, length = packed["arrays"]["samples"]
    assert kind == "Int16Array"
    whole = np.frombuffer(data, "<i2", length, offset).reshape(9, -1)
    whole = np.cumsum(whole, axis=1, dtype=np.int16).T
    np.testing.assert_array_equal(whole == MISSING_SAMPLE, np.isnan(track.samples))
    is_sample = ~np.isnan(track.samples)
    steps = np.array(packed["steps"])
    apart = np.abs(whole * steps - track.samples)
    assert (apart <= 0.5001 * steps)[is_sample].all()
    measures = read_results(run)[0].measures
    nearest_m = np.nanmin(track.samples[:, 8])
    assert nearest_m == pytest.approx(measures.min_clearance_m, abs=1e-9)


def test_the_command_to_reproduce_gives_its_configuration(tmp_path):
    config = RunConfig(worlds="0:9:3", repetitions=2, seed=7, bags="failed")
    planner = replace(config.planners[0], overrides={"dwa.sim_time_s": 1.5})
    config = replace(config, planners=(planner,))
    content = json.loads(json.dumps(as_dict(config)))
    source = Source(tmp_path, "campaign", (), content, (), None)
    barn, run, *words = shlex.split(reproduce(source).command)
    assert (barn, run) == ("barn", "run")
    parameters = run_command.make_context("run", words).params
    options = {key: value for key, value in parameters.items() if value}
    assert options["settings"] == {"dwa.dwa.sim_time_s": 1.5}
    assert read_request(None, options).config == config


def test_folders_that_cannot_be_reported_are_refused_in_one_line(
    folder, tmp_path, rejected
):
    strange = tmp_path / "strange"
    (tmp_path / "empty").mkdir()
    strange.mkdir()
    (strange / "run.json").write_text('{"hello": 1}')
    for paths, message in (
        ("nowhere", "holds no results of a run"),
        ("empty", "holds no results of a run"),
        ("strange", "holds no results of a run"),
        (f"{folder} {folder}", "is named twice"),
    ):
        assert message in rejected(f"report {paths} --out out.html")
    with refused("describes no run"):
        read_source(strange, [])
    (strange / "run.json").write_text("{")
    with refused("not JSON"):
        read_source(strange, [])


def test_planners_of_one_name_have_distinct_labels(folder, run, tmp_path):
    entries = read_entries([folder, run])
    assert [entry.label for entry in entries] == ["gap (campaign)", "DWA", "gap (run)"]
    report = build_report([folder, run], hardest=1)
    assert report.overview.refusals  # worlds of the one number had other seeds there
    assert "are not compared" in report_page(report, "two")


def test_the_page_begins_with_the_conclusion_and_cautions(report):
    text = report_page(report, "whole")
    verdict = report.overview.conclusion
    sentence = (
        r"gap ranks first; its lead over DWA is not significant \(p = .* worlds\)\."
    )
    assert re.fullmatch(sentence, verdict.short)
    markup = f'<p class="verdict">{verdict.short}</p>\n  <p>{verdict.details}</p>'
    assert markup in html.unescape(text)
    task = report.entries[0].results[0].task
    assert re.fullmatch("[0-9a-f]{12}", task)
    rules = text.index("Protocol challenge, robot Jackal")
    assert rules < text.index(verdict.short) < text.index(f"Task {task}: a checksum")
    assert text.index("Only 8 worlds") < text.index('id="headline"')


def test_the_first_screen_has_bars_and_the_headline(report):
    text = html.unescape(report_page(report, "whole"))
    gap, dwa = report.overview.summaries
    headline = report.tables[0]
    assert headline.columns[2].startswith("challenge metric (of")
    assert [row[0] for row in headline.rows] == ["gap", "DWA"]
    column = headline.columns.index("time of successes [s]")
    for row in headline.rows:
        assert row[column].endswith(f" of {gap.outcomes['success']}")
    widths = re.findall(r'class="bar" style="width: ([0-9.]+)%', text)
    expected = [100.0 * summary["challenge"].estimate / 0.5 for summary in (gap, dwa)]
    assert list(map(float, widths)) == pytest.approx(expected, abs=0.01)
    caption = "from 0 to 0.5: means over the 8 worlds that all planners have"
    assert f"challenge metric (of 0.5), {caption}" in text


def test_bars_and_conclusion_use_the_common_worlds(folder, tmp_path):
    part = copy_rows(folder, tmp_path / "part")

    def is_kept(row):
        return row["planner"] == "gap" or row["world"] < 5

    rewrite_rows(part, lambda rows: list(filter(is_kept, rows)))
    report = build_report([part], hardest=0)
    bars = make_bars(report.entries)
    conclusion = report.overview.conclusion.details
    means = re.match(r"Challenge metric ([0-9.]+) against ([0-9.]+) of", conclusion)
    assert [row["text"].split()[0] for row in bars.rows] == list(means.groups())
    assert bars.worlds == 5 and "Only 5 worlds" in report_page(report, "part")


def test_explanations_claim_nothing_beyond_the_tests(run, tmp_path):
    planners = ("gap", "dwa", "eband")
    three = campaign(tmp_path / "three", run, planners, worlds=8, bags=0)
    report = build_report([three], hardest=0)
    overview = report.overview
    page = html.unescape(report_page(report, "three"))
    assert overview.where.keys() == {band.name for band in overview.bands}
    for text in overview.where.values():
        assert all(name in text for name in ("gap", "DWA", "E-Band"))
        assert text in page
    assert len(overview.why) == 3
    for text, comparison in zip(overview.why, overview.comparisons, strict=True):
        assert text in page
        assert text.startswith(f"{comparison.a} and {comparison.b} ")
        parts = re.split(", not in | do not differ clearly in ", text)
        clear, unclear, *_ = (*parts, "")
        for row in comparison.rows:
            if row.key in ("success", "traversal_time_s", "challenge"):
                assert row.measure in (clear if row.p_holm <= 0.05 else unclear)


def test_columns_of_tables_are_those_chosen(folder, rejected):
    keys = ["mean_speed_mps", "success"]
    report = build_report([folder], hardest=0, columns=keys)
    assert report.tables[0].columns[2:5] == (
        "challenge metric (of 0.5)",
        "mean speed [m/s]",
        "success [%]",
    )
    data, rows = page_data(report.entries, report.trials, report.columns)
    assert len(rows) == len(report.trials)
    assert [name for name, *_ in data["columns"][4:]] == keys
    with refused("unknown measure 'mean_sped_mps'; did you mean 'mean_speed_mps'"):
        build_report([folder], columns=["mean_sped_mps"])
    assert "did you mean 'columns'" in rejected(f"report {folder} --set colums=success")


def test_a_trial_with_a_bag_links_to_its_replay(folder, report, tmp_path):
    pages = tmp_path / "pages"
    out = pages / "report.html"
    write_folders([folder], out, hardest=0, replays=pages / "replays")
    text = re.search(r'id="data">(.*?)</script>', out.read_text("utf-8"))[1]
    parts = json.loads(text)["parts"]
    linked = {}
    for position, (name, _, place, *_) in enumerate(parts["trials"]):
        replay = parts[f"world_{place}"]["trials"][str(position)]["replay"]
        if replay:
            linked[name] = replay
    assert linked.keys() == {path.name for path in (folder / "bags").iterdir()}
    for page in linked.values():
        assert "Plan view of the trial" in (pages / page).read_text("utf-8")
    part = world_part(report.trials, range(len(report.trials)), {})
    assert not any(trial["replay"] for trial in part["trials"].values())


# What a trial without motion has no number for.
NOTHING = {
    "measures": (
        "driven_ratio",
        "mean_speed_mps",
        "min_clearance_m",
        "mean_clearance_m",
        "rms_jerk_mps3",
    ),
    "wall_clock": ("compute_p50_ms", "compute_p95_ms", "compute_max_ms"),
}


def copy_rows(folder, path):
    """Copy a folder without its bags."""
    return shutil.copytree(folder, path, ignore=shutil.ignore_patterns("bags"))


def failed(row):
    """A row of a trial in which nothing moved: no time, no clearance, no speed."""
    row = copy.deepcopy(row) | {"outcome": "planner_not_ready"}
    row["scores"] |= {"success": False, "traversal_time_s": None}
    row["scores"] |= dict.fromkeys(("challenge", "challenge_2022"), 0.0)
    row["measures"]["driven_m"] = 0.0
    for part, keys in NOTHING.items():
        row[part] |= dict.fromkeys(keys)
    return row


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda rows: rows[:1], "odd is partial: 1 of 32 trials"),
        (
            lambda rows: [row for row in rows if row["planner"] == "gap"],
            "gap is the only planner",
        ),
        (lambda rows: list(map(failed, rows)), "computing time was not measured"),
        (lambda rows: [failed(rows[0])], "There are too few worlds for bands"),
        (lambda rows: [*map(failed, rows[::2]), *rows[1::2]], "planner_not_ready"),
        (
            lambda rows: [row | {"world_checksum": "0" * 64} for row in rows],
            "has changed since the trial",
        ),
        (
            lambda rows: [
                row | {"planner": EVIL, "trial_id": EVIL + row["trial_id"]}
                for row in rows[::2]
            ],
            "window.evil",
        ),
    ],
    ids=[
        "one trial",
        "one planner",
        "failures",
        "one failure",
        "one fails",
        "other worlds",
        "evil planner",
    ],
)
def test_a_campaign_of_an_odd_kind_is_reported(folder, tmp_path, change, message):
    odd = copy_rows(folder, tmp_path / "odd")
    rows = rewrite_rows(odd, change)
    report = build_report([odd])
    page = report_page(report, "odd")
    assert message in page
    assert EVIL not in page
    assert len(report.trials) == len(rows)
    assets = tmp_path / "assets"
    write_assets(report, assets)
    files = list(assets.iterdir())
    assert len(files) == 2 * (len(report.tables) + len(report.figures))
    assert all(file.stat().st_size > 0 for file in files)
    for table in report.tables:
        assert all(cell and "nan" not in cell for row in table.rows for cell in row[1:])
        latex_shape(latex_table(table))


def test_a_report_does_not_tell_which_worker_was_faster(folder, tmp_path):
    other = copy_rows(folder, tmp_path / "other")
    rewrite_rows(other, lambda rows: rows[::-1])
    first = read_entries([folder])
    second = read_entries([other])
    assert [entry.label for entry in second] == ["gap", "DWA"]
    assert [entry.results for entry in second] == [entry.results for entry in first]


HOSTILE = "[\\input{/etc/passwd}] * 100% $x$ #1 a_b^c ~ & | <script>"


def latex_shape(text):
    """Return the number of cells of each row of a tabular, and see that nothing in it
    is a command.
    """
    body = re.search(r"\\toprule\n(.*)\\bottomrule", text, re.DOTALL)[1]
    shape = []
    for row in body.replace("\\midrule\n", "").splitlines():
        assert row.startswith("{}")
        assert row.endswith(r" \\")
        bare = re.sub(r"\\[#$%&_{}]|\\text[a-z]+\{\}|\$-\$", "", row[2:-3])
        assert not set("\\{}$%#_^~<>|") & set(bare), row
        shape.append(bare.count("&") + 1)
    return shape


def test_latex_of_a_report_has_the_shape_of_a_tabular(report):
    hostile = TextTable("t", HOSTILE, (HOSTILE, "b"), ((HOSTILE, "-1"), ("* [", "2")))
    for table in (*report.tables, hostile):
        text = latex_table(table)
        assert text.count("\n%") == 0
        assert re.match(r"% [^\n]*\n\\begin\{tabular\}\{l+r*\}\n", text)
        width = len(re.search(r"\{(l+r*)\}", text)[1])
        assert latex_shape(text) == [width] * (1 + len(table.rows)), table.name


def put(page, element, value):
    """Give an input or a choice a value at once, as typing, picking or dragging does in
    the end.
    """
    script = (
        "(one, value) => { one.value = value;"
        "one.dispatchEvent(new Event('input')); one.dispatchEvent(new Event('change')) }"
    )
    page.locator(f"#{element}").evaluate(script, value)


def test_the_table_sorts_and_filters_and_a_trial_opens(
    page, open_page, screenshots, tmp_path
):
    file = tmp_path / "report.html"
    file.write_text(page, "utf-8")
    browser_page = open_page(file)

    def column(number):
        return browser_page.locator(
            f"#trials tbody td:nth-child({number})"
        ).all_text_contents()

    def text(element):
        return browser_page.locator(f"#{element}").text_content()

    def opened(trial):
        browser_page.wait_for_selector(f"body[data-opened={trial}]")

    assert len(column(1)) == 32
    browser_page.click("#trials th:nth-child(5) button")
    times = [float(cell) for cell in column(5)]
    assert times == sorted(times)
    browser_page.click("#trials th:nth-child(5) button")
    assert [float(cell) for cell in column(5)] == times[::-1]
    browser_page.select_option("#filter-outcome", "timeout")
    assert set(column(4)) == {"timeout"}
    browser_page.locator("#search").press_sequentially("dwa_w0004")
    assert column(2) == ["4"]
    browser_page.fill("#search", "gap_w0000")
    assert column(2) == []
    assert text("count") == "no trials match"
    browser_page.select_option("#filter-outcome", "")
    browser_page.fill("#search", "")
    put(browser_page, "filter-from", "3")
    put(browser_page, "filter-to", "5")
    browser_page.select_option("#filter-planner", "DWA")
    browser_page.select_option("#filter-outcome", "failed")
    assert set(column(4)) == {"timeout"}
    assert column(2) == ["3", "4"]
    browser_page.focus("tr[data-trial=dwa_w0004_r00]")
    browser_page.keyboard.press("Enter")
    opened("dwa_w0004_r00")
    browser_page.keyboard.press("Escape")
    browser_page.wait_for_function("!document.getElementById('trial').open")
    browser_page.click("#filter-reset")
    browser_page.fill("#search", "gap_w0000")
    browser_page.click("tr[data-trial=gap_w0000_r00]")
    opened("gap_w0000_r00")
    browser_page.screenshot(path=screenshots / "report_trial.png")
    assert violations(browser_page) == []
    assert browser_page.evaluate("window.report.view.player.time") > 5.0
    canvases = "['trial-scene', 'trial-chart-speed', 'trial-chart-clearance']"
    pixels = f"{canvases}.map((id) => document.getElementById(id).toDataURL())"
    at_end = browser_page.evaluate(pixels)
    put(browser_page, "trial-scrub", "1")
    at_begin = browser_page.evaluate(pixels)
    assert all(map(operator.ne, at_begin, at_end))
    browser_page.click("#trial-play")
    browser_page.wait_for_function("window.report.view.player.time > 2")
    browser_page.click("#close")
    browser_page.fill("#search", "dwa_w0004")
    browser_page.click("tr[data-trial=dwa_w0004_r00]")
    opened("dwa_w0004_r00")
    assert "no track of this trial" in text("trial-problem")
    assert EVIL in text("trial-ending")
    assert browser_page.evaluate("window.evil") is None
    assert browser_page.evaluate("document.documentElement.scrollWidth <= innerWidth")


def test_a_report_made_by_several_processes_is_the_same(folder, tmp_path, monkeypatch):
    shares = []

    def files(name, progress):
        place = tmp_path / name
        options = {"assets": place / "assets", "title": "Same", "progress": progress}
        write_folders([folder], place / "report.html", **options)
        return {path.name: path.read_bytes() for path in place.rglob("*.*")}

    several = files("several", shares.append)
    assert shares == sorted(set(shares))
    assert 0.0 < shares[0] < shares[-1] == 1.0
    monkeypatch.setattr(
        report_module, "run_forked", lambda jobs, progress: [job() for job in jobs]
    )
    assert files("one", lambda share: None) == several


def test_many_trials_are_in_scripts_beside_the_page(
    folder, tmp_path, monkeypatch, open_page
):
    monkeypatch.setattr(report_module, "MAX_TRIALS_IN_PAGE", 31)
    out = tmp_path / "so %41.html"
    write_folders([folder], out)
    parts = {path.name for path in (tmp_path / "so %41_data").iterdir()}
    assert parts == {"trials.js", *(f"world_{place}.js" for place in range(8))}
    assert '"zlib"' not in out.read_text("utf-8")
    assert not any("<" in path.read_text() for path in out.parent.rglob("*.js"))
    page = open_page(out)
    page.click("tr[data-trial=gap_w0000_r00]")
    page.wait_for_selector("body[data-opened=gap_w0000_r00]")
    assert page.evaluate("window.report.view.player.time") > 5.0
    assert page.evaluate("window.evil") is None
    monkeypatch.setattr(report_module, "MAX_TRIALS_IN_PAGE", 32)
    write_folders([folder], out)
    assert [path.name for path in (tmp_path / "so %41_data").iterdir()] == ["trials.js"]


def test_figures_show_values_open_trials_and_are_saved(page, open_page, tmp_path):
    file = tmp_path / "report.html"
    file.write_text(page, "utf-8")
    browser_page = open_page(file)
    dots = browser_page.locator("#figure-worlds [data-tips] use")
    dots.first.hover(force=True)
    assert browser_page.locator("#tip").text_content().startswith("gap, world 0: 2.0")
    dots.first.click(force=True)
    browser_page.wait_for_selector("body[data-opened=gap_w0000_r00]")
    browser_page.click("#trial-after")
    browser_page.wait_for_selector("body[data-opened=gap_w0000_r01]")
    browser_page.click("#close")
    bars = browser_page.locator("#figure-outcomes [data-tips]:nth-of-type(2) path")
    assert bars.count()
    for kind, begin in (("svg", b"<svg"), ("pdf", b"%PDF"), ("png", b"\x89PNG")):
        with browser_page.expect_download() as download:
            browser_page.click(f"#figure-trails [data-save={kind}]")
        content = download.value.path().read_bytes()
        assert content.startswith(begin)
        assert b"var(" not in content or kind != "svg"


def test_planners_have_one_mark_in_bars_legends_and_figures(report, page):
    numbers = report.look_numbers
    assert [look["marker"] for look in report.looks] == [MARKERS[n] for n in numbers]
    data, _ = page_data(report.entries, report.trials)
    assert [entry["marker"] for entry in data["entries"]] == numbers
    for entry, number in zip(report.entries, numbers, strict=True):
        mark = f'<span class="dot marker-{number}" style="background: {themed(entry.color)}">'
        assert f"{mark}</span>{entry.label}" in page
    (axes,) = draw(CHARTS["trade"], report)
    legend = axes.get_figure(root=True).legends[0]
    assert [line.get_marker() for line in legend.get_lines()] == [
        MARKERS[n] for n in numbers
    ]
    assert len({*MARKERS}) == len({*map(str, DASHES)}) == len(PLANNERS)
