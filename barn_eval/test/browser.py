"""A headless Chromium for tests of pages, spoken to through chromedriver with nothing but HTTP and JSON (WebDriver)."""

import base64
import json
import shutil
import socket
import subprocess
import time
import urllib.request

ARGUMENTS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


def missing():
    """Why there is no browser to test with, or an empty text."""
    names = [("chromium", "chromium-browser", "google-chrome"), ("chromedriver",)]
    absent = [choice[0] for choice in names if not any(shutil.which(name) for name in choice)]
    return f"no {' and no '.join(absent)} on the path (Debian: chromium, chromium-driver)" if absent else ""


class Browser:
    """One browser with one page. Use as a context manager."""

    def __init__(self, profile, width=1280, height=900, dark=False):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self._driver = subprocess.Popen(
            [shutil.which("chromedriver"), f"--port={port}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        self._url = f"http://127.0.0.1:{port}"
        arguments = [*ARGUMENTS, f"--user-data-dir={profile}", f"--window-size={width},{height}"]
        if dark:
            arguments.append("--force-dark-mode")
        binary = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
        options = {"args": arguments, "binary": binary}
        wanted = {"goog:chromeOptions": options, "goog:loggingPrefs": {"browser": "ALL"}}
        self._wait_for_driver()
        session = self._call("POST", "/session", {"capabilities": {"alwaysMatch": wanted}})
        self._url += f"/session/{session['sessionId']}"
        if dark:
            features = [{"name": "prefers-color-scheme", "value": "dark"}]
            self.devtools("Emulation.setEmulatedMedia", {"features": features})

    def __enter__(self):
        return self

    def __exit__(self, *_):
        try:
            self._call("DELETE", "")
        finally:
            self._driver.terminate()
            self._driver.wait(timeout=10)

    def open(self, path):
        self.visit(path.absolute().as_uri())

    def visit(self, address):
        self._call("POST", "/url", {"url": address})

    def run(self, script, *arguments):
        """The value that a script returns."""
        return self._call("POST", "/execute/sync", {"script": script, "args": list(arguments)})

    def wait(self, condition, limit_s=100.0):
        """Wait until a JavaScript expression is true and return its value."""
        until = time.monotonic() + limit_s
        while time.monotonic() < until:
            value = self.run(f"return {condition}")
            if value:
                return value
            time.sleep(0.05)
        raise AssertionError(f"{condition} did not become true; console: {self.console()}")

    def click(self, selector):
        """A click of the mouse, as a user makes it: fails if the element is hidden or covered."""
        found = self._call("POST", "/element", {"using": "css selector", "value": selector})
        self._call("POST", f"/element/{next(iter(found.values()))}/click", {})

    def type(self, selector, text):
        found = self._call("POST", "/element", {"using": "css selector", "value": selector})
        element = next(iter(found.values()))
        self._call("POST", f"/element/{element}/value", {"text": text})

    def key(self, name):
        """A key pressed and released wherever the focus is, such as "Tab" or "Enter"."""
        codes = {"Tab": 9, "Enter": 13, "Escape": 27, "ArrowLeft": 37, "ArrowRight": 39, "Space": 32}
        about = {"key": " " if name == "Space" else name, "code": name, "windowsVirtualKeyCode": codes[name]}
        text = {"Enter": "\r", "Space": " "}.get(name, "")
        self.devtools("Input.dispatchKeyEvent", {"type": "keyDown", "text": text, **about})
        self.devtools("Input.dispatchKeyEvent", {"type": "keyUp", **about})

    def console(self):
        """Messages of the console since the last call, errors of scripts among them."""
        return [entry["message"] for entry in self._call("POST", "/se/log", {"type": "browser"})]

    def devtools(self, command, parameters):
        return self._call("POST", "/goog/cdp/execute", {"cmd": command, "params": parameters})

    def picture(self, path, whole=False):
        shot = self.devtools("Page.captureScreenshot", {"format": "png", "captureBeyondViewport": whole})
        path.write_bytes(base64.b64decode(shot["data"]))

    def _wait_for_driver(self):
        until = time.monotonic() + 20.0
        while True:
            try:
                return self._call("GET", "/status")
            except OSError:  # noqa: PERF203 (this is the wait)
                if time.monotonic() > until:
                    raise
                time.sleep(0.05)

    def _call(self, method, path, content=None):
        data = None if content is None else json.dumps(content).encode()
        request = urllib.request.Request(self._url + path, data, {"Content-Type": "application/json"}, method=method)
        try:
            with urllib.request.urlopen(request, timeout=60) as answer:
                return json.load(answer)["value"]
        except urllib.error.HTTPError as error:
            raise AssertionError(json.load(error)["value"]["message"]) from None
