"""Every page on a desk, a phone, in the dark, on paper and by keyboard: whole, readable, named, alone."""

import base64

import pytest
from browser import Browser, missing
from report_work import campaign, drive

from barn_eval.analysis.leaderboard import leaderboard
from barn_eval.pages.leaderboard import write_boards
from barn_eval.pages.replay_page import write_replay
from barn_eval.pages.report import write_report
from barn_eval.pages.watch import Watch

pytestmark = pytest.mark.skipif(bool(missing()), reason=missing())
PAGES = ("report", "leaderboard", "replay", "campaign")
NAMED = {"button", "link", "combobox", "textbox", "searchbox", "spinbutton", "slider", "image", "table", "application"}
# The lowest contrast of text with what is behind it, and the text.
CONTRAST = """
const shade = (text) => { const [r, g, b, a = 1] = text.match(/[\\d.]+/g).map(Number); return { rgb: [r, g, b], a }; };
const light = ({ rgb }) => rgb.map((v) => v / 255).map((v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
  .reduce((sum, v, at) => sum + v * [0.2126, 0.7152, 0.0722][at], 0);
const behind = (one) => { for (; one; one = one.parentElement) {
  const found = shade(getComputedStyle(one).backgroundColor); if (found.a === 1) return found; }
  return shade("rgb(255, 255, 255)"); };
let least = [99, ""];
for (const one of document.querySelectorAll("main *")) {
  const text = [...one.childNodes].filter((node) => node.nodeType === 3).map((node) => node.data.trim()).join("");
  if (!text || one.disabled || one.closest("svg") || !one.checkVisibility()) continue;
  const [a, b] = [light(shade(getComputedStyle(one).color)), light(behind(one))];
  const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
  if (ratio < least[0]) least = [ratio, text];
}
return least;
"""


@pytest.fixture(scope="module")
def addresses(tmp_path_factory):
    """The address of each page."""
    place = tmp_path_factory.mktemp("pages")
    folder = campaign(place / "campaign", drive(place / "run"))
    write_report([folder], place / "report.html", hardest=1)
    write_boards(leaderboard([folder]), place / "leaderboard.html")
    write_replay(folder / "bags" / "gap_w0000_r00", html=place / "replay.html")
    with Watch(folder, port=0) as page:
        yield {name: (place / f"{name}.html").as_uri() for name in PAGES[:3]} | {"campaign": page.url}


def check(browser, address):
    """What holds for every page however it is looked at."""
    browser.visit(address)
    browser.wait("document.readyState === 'complete'")
    browser.wait("document.body.dataset.ready || !document.querySelector('script')")
    assert browser.console() == []
    asked = browser.run("return performance.getEntriesByType('resource').map((one) => one.name)")
    asked = [one for one in asked if not one.startswith(("data:", "blob:"))]
    assert set(asked) <= {address + "state"}  # which is the campaign's page's own
    assert browser.run("return document.documentElement.scrollWidth <= innerWidth")
    ratio, text = browser.run(CONTRAST)
    assert ratio >= 4.5, text


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_whole_on_desk_and_phone_and_its_parts_have_names(addresses, tmp_path, name):
    with Browser(tmp_path / "profile") as browser:
        check(browser, addresses[name])
        browser.picture(tmp_path / f"{name}.png")
        nodes = browser.devtools("Accessibility.getFullAXTree", {})["nodes"]
        parts = [node for node in nodes if not node["ignored"] and node["role"]["value"] in NAMED - {"table"}]
        assert [node for node in parts if not node.get("name", {}).get("value")] == []
        assert len({node["role"]["value"] for node in nodes if not node["ignored"]} & {"heading", "main"}) == 2
        phone = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
        browser.devtools("Emulation.setDeviceMetricsOverride", phone)
        check(browser, addresses[name])
        browser.picture(tmp_path / f"{name}_phone.png")


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_dark_on_screen_and_white_on_paper(addresses, tmp_path, name):
    background = "return getComputedStyle(document.body).backgroundColor"
    with Browser(tmp_path / "profile", dark=True) as browser:
        check(browser, addresses[name])
        assert browser.run(background) != "rgb(255, 255, 255)"
        browser.picture(tmp_path / f"{name}_dark.png")
        dark = [{"name": "prefers-color-scheme", "value": "dark"}]
        browser.devtools("Emulation.setEmulatedMedia", {"media": "print", "features": dark})
        assert browser.run(background) == "rgb(255, 255, 255)"
        ratio, text = browser.run(CONTRAST)
        assert ratio >= 4.5, text
        pdf = base64.b64decode(browser.devtools("Page.printToPDF", {"preferCSSPageSize": True})["data"])
        assert pdf.startswith(b"%PDF")
        (tmp_path / f"{name}.pdf").write_bytes(pdf)


@pytest.mark.parametrize("name", PAGES)
def test_the_keyboard_reaches_every_control(addresses, tmp_path, name):
    reach = (
        "const seen = document.activeElement; const all = [...document.querySelectorAll('a[href], button, input,"
        " select, summary, canvas[tabindex], .wide[tabindex]')].filter((one) => one.checkVisibility() && !one.disabled"
        " && !one.closest('dialog') && one.getClientRects().length); return [all.indexOf(seen), all.length]"
    )
    with Browser(tmp_path / "profile") as browser:
        check(browser, addresses[name])
        _, count = browser.run(reach)
        reached = set()
        for _ in range(count + 60):
            browser.key("Tab")
            reached.add(browser.run(reach)[0])
            if reached >= set(range(count)):
                break
        assert reached >= set(range(count))
