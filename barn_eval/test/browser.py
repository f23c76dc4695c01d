"""Pages in a headless Chromium, as Playwright drives it, and what holds for each
however it is looked at.
"""

import shutil
from pathlib import Path
from urllib.parse import urlsplit

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
PHONE = {
    "viewport": {"width": 390, "height": 844},
    "device_scale_factor": 2,
    "is_mobile": True,
    "has_touch": True,
}


def launch(playwright):
    """The system's Chromium, or else Playwright's own.

    The test is skipped without either.
    """
    browser_path = next(filter(None, map(shutil.which, BROWSERS)), None)
    if not browser_path and not Path(playwright.chromium.executable_path).exists():
        pytest.skip(
            f"no browser: none of {', '.join(BROWSERS)} on the path, nor what `playwright install` fetches"
        )
    return playwright.chromium.launch(executable_path=browser_path)


class Opened:
    """Opens pages, each in a profile of its own, and keeps what they write and ask for."""

    def __init__(self, browser):
        self._browser = browser
        self._contexts = []
        self.written = []
        self.asked = set()

    def __call__(self, address, **view):
        """The page at an address (a path or a URL), ready.

        A view is what Playwright says of a context.
        """
        context = self._browser.new_context(
            **{"viewport": {"width": 1280, "height": 900}} | view
        )
        self._contexts.append(context)
        context.set_default_timeout(600_000.0)
        context.on("console", lambda message: self.written.append(message.text))
        context.on("weberror", lambda error: self.written.append(str(error.error)))
        context.on("request", lambda request: self.asked.add(request.url))
        page = context.new_page()
        page.goto(address.absolute().as_uri() if isinstance(address, Path) else address)
        page.wait_for_function(
            "document.body.dataset.ready || !document.querySelector('script')"
        )
        return page

    def check(self):
        """No page has written to the console, nor asked for more than files and the
        machine's own server.
        """
        assert self.written == []
        inline_schemes = {"file", "data", "blob"}
        assert [
            url
            for url in self.asked
            if urlsplit(url).scheme not in inline_schemes and "//127.0.0.1:" not in url
        ] == []

    def close(self):
        for context in self._contexts:
            context.close()


def violations(page):
    """What axe-core has against a page as it is now: the rule, its impact and where.

    What axe cannot judge counts too, but for the contrast of single signs, and of what
    has to be scrolled to.
    """
    axe = pytest.importorskip(
        "axe_playwright_python.sync_playwright",
        reason="axe-playwright-python is not installed",
    )
    page.evaluate(
        "document.querySelectorAll('details').forEach((one) => { one.open = true })"
    )
    page.add_style_tag(
        content=".wide { background: none !important }"
    )  # shadows at the edges, behind no text
    answer = (
        axe.Axe()
        .run(page, options={"resultTypes": ["violations", "incomplete"]})
        .response
    )
    spared = {"nonBmp", "shortTextContent", "elmPartiallyObscured"}
    return [
        (violation["id"], violation["impact"], node["target"])
        for violation in answer["violations"] + answer["incomplete"]
        for node in violation["nodes"]
        if not any(
            (check["data"] or {}).get("messageKey") in spared for check in node["any"]
        )
    ]
