"""Every page on a desk, on a phone in the dark, on paper and by keyboard.

Whole, readable, named, alone.
"""

import pytest
from browser import PHONE, violations
from report_work import campaign

from barn_eval.analysis.leaderboard import make_boards
from barn_eval.api.results import report
from barn_eval.pages.live.server import PageServer
from barn_eval.pages.replay.files import write_replay
from barn_eval.pages.report.leaderboard import write_boards

PAGES = ("report", "leaderboard", "replay", "campaign")
VIEWS = {
    "desk": {"viewport": {"width": 1920, "height": 1080}},
    "phone": PHONE | {"color_scheme": "dark"},
}
NAMED = {
    "button",
    "link",
    "combobox",
    "textbox",
    "searchbox",
    "spinbutton",
    "slider",
    "image",
    "application",
}
BACKGROUND = "getComputedStyle(document.body).backgroundColor"


@pytest.fixture(scope="module")
def addresses(run, tmp_path_factory):
    """The address of each page."""
    place = tmp_path_factory.mktemp("pages")
    folder = campaign(place / "campaign", run)
    report([folder], place / "report.html", hardest=1)
    write_boards(make_boards([folder]), place / "leaderboard.html")
    write_replay([folder / "bags" / "gap_w0000_r00"], [place / "replay.html"])
    with PageServer(folder, port=0) as page:
        yield {name: (place / f"{name}.html").as_uri() for name in PAGES[:3]} | {
            "campaign": page.url
        }


@pytest.fixture(params=PAGES)
def name(request):
    return request.param


@pytest.mark.parametrize("view", VIEWS)
def test_a_page_is_whole_readable_and_alone(
    addresses, open_page, screenshots, name, view
):
    page = open_page(addresses[name], **VIEWS[view])
    page.screenshot(path=screenshots / f"{name}_{view}.png", full_page=True)
    assert (
        page.evaluate("document.documentElement.scrollWidth")
        <= page.viewport_size["width"]
    )
    assert violations(page) == []
    assert (page.evaluate(BACKGROUND) == "rgb(255, 255, 255)") == (view == "desk")
    if view == "desk":
        right = "Math.max(...[...document.querySelectorAll('main *')].map((one) => one.getBoundingClientRect().right))"
        assert page.evaluate(right) > 1700
    requests = {
        url for url in open_page.asked if not url.startswith(("data:", "blob:"))
    }
    assert requests <= {
        addresses[name],
        addresses[name] + "state",
    }  # which is the campaign's page's own


def test_parts_of_a_page_have_names(addresses, open_page, name):
    page = open_page(addresses[name])
    nodes = page.context.new_cdp_session(page).send("Accessibility.getFullAXTree")[
        "nodes"
    ]
    parts = [
        node for node in nodes if not node["ignored"] and node["role"]["value"] in NAMED
    ]
    assert [node for node in parts if not node.get("name", {}).get("value")] == []
    assert {node["role"]["value"] for node in nodes if not node["ignored"]} >= {
        "heading",
        "main",
    }


def test_a_page_is_white_on_paper(addresses, open_page, screenshots, name):
    page = open_page(
        addresses[name], color_scheme="dark", viewport={"width": 718, "height": 1047}
    )
    page.emulate_media(media="print")
    assert page.evaluate(BACKGROUND) == "rgb(255, 255, 255)"
    page.screenshot(path=screenshots / f"{name}_print.png", full_page=True)
    assert page.pdf(
        path=screenshots / f"{name}_print.pdf", prefer_css_page_size=True
    ).startswith(b"%PDF")
    assert violations(page) == []


def test_the_keyboard_reaches_every_control(addresses, open_page, name):
    reach = (
        "() => { const seen = document.activeElement; const all = [...document.querySelectorAll("
        "'a[href], button, input, select, summary, canvas[tabindex], .wide[tabindex]')].filter((one) =>"
        " one.checkVisibility() && !one.disabled && !one.closest('dialog') && one.getClientRects().length);"
        " return [all.indexOf(seen), all.length] }"
    )
    page = open_page(addresses[name])
    _, count = page.evaluate(reach)
    reached = set()
    for _ in range(count + 60):
        page.keyboard.press("Tab")
        reached.add(page.evaluate(reach)[0])
        if reached >= set(range(count)):
            break
    assert reached >= set(range(count))


def test_a_wide_screen_has_two_columns_a_narrow_one_has_one(addresses, open_page):
    tops = "[...document.querySelectorAll('#outcomes, #paired')].map((one) => one.getBoundingClientRect().top)"
    page = open_page(addresses["report"])
    for width, columns in ((1500, 2), (1499, 1)):
        page.set_viewport_size({"width": width, "height": 900})
        first, second = page.evaluate(tops)
        assert (first == second) == (columns == 2)
