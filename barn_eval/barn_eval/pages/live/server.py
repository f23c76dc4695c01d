"""The server of a campaign's page: the page, its state and replays of its bags, and no other file."""

import json
import threading
from contextlib import AbstractContextManager
from functools import lru_cache
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from ipaddress import ip_address
from pathlib import Path
from socket import gethostname
from socketserver import TCPServer
from urllib.parse import unquote, urlsplit

from barn_eval.bags.recorded import read_recorded
from barn_eval.pages import LOOPBACK, PAGE_PORT
from barn_eval.pages.live.state import CampaignState
from barn_eval.pages.replay.page import replay_page
from barn_eval.pages.template import render
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.base.text_files import finite

_IDLE_S = 10.0  # after which a connection that says nothing is closed
_KEPT_REPLAYS = 4
_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; connect-src 'self'"
_HTML, _TEXT = "text/html; charset=utf-8", "text/plain; charset=utf-8"


class Watch(AbstractContextManager["Watch"]):
    """The page of a folder, served from a thread until it is closed; a context manager.

    host: an address of this machine. port: 0 takes any that is free. Raises ConfigError in one line for a folder
    without an experiment, and for an address that cannot be had.
    """

    def __init__(self, folder: str | Path, *, host: str = LOOPBACK, port: int = PAGE_PORT) -> None:
        state = CampaignState(Path(folder))
        try:
            self._server = _Server((host, port), state)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise ConfigError(f"host {host!r}, port {port}: cannot be served: {reason}") from None
        address, bound = self._server.server_address[:2]
        shown = LOOPBACK if ip_address(str(address)).is_unspecified else host
        self.url = f"http://{shown}:{bound}/"
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """Stop to serve."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Server(ThreadingHTTPServer):
    """What is served, computed for one request at a time."""

    daemon_threads = True

    def __init__(self, address: tuple[str, int], state: CampaignState) -> None:
        self.state = state
        self.lock = threading.Lock()
        self.replay = lru_cache(_KEPT_REPLAYS)(lambda bag: replay_page(read_recorded(bag)))
        super().__init__(address, _Handler)

    def page(self, path: str) -> tuple[HTTPStatus, str, str]:
        """Return status, content and type of a path; BarnError for a bag that cannot be read."""
        with self.lock:
            if path == "/":
                return HTTPStatus.OK, render("campaign.html", data=self.state.read()), _HTML
            if path == "/state":
                return HTTPStatus.OK, json.dumps(finite(self.state.read()), allow_nan=False), "application/json"
            if path.startswith("/replay/"):
                return HTTPStatus.OK, self.replay(self.state.bag(unquote(path.removeprefix("/replay/")))), _HTML
        return HTTPStatus.NOT_FOUND, "there is nothing here", _TEXT

    def server_bind(self) -> None:
        """Bind without asking a name server what the address is called."""
        TCPServer.server_bind(self)
        self.server_name, self.server_port = gethostname(), self.server_address[1]

    def allowed(self, host: str) -> bool:
        """Tell whether a request names an address: a name other than localhost may be another site's trick."""
        name = urlsplit(f"//{host}").hostname or ""
        try:
            ip_address(name)
        except ValueError:
            return name in ("localhost", self.server_name)
        return True


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = _IDLE_S
    server_version = "barn"
    sys_version = ""

    def do_GET(self) -> None:
        """Answer with a page, or with a line that says why not."""
        self._send(*self._answer())

    def _answer(self) -> tuple[HTTPStatus, str, str]:
        if not self.server.allowed(self.headers.get("Host", "")):
            return HTTPStatus.FORBIDDEN, "not the name of this machine", _TEXT
        try:
            return self.server.page(urlsplit(self.path).path)
        except (BarnError, OSError, ValueError) as error:
            return HTTPStatus.NOT_FOUND, str(error), _TEXT

    def _send(self, status: HTTPStatus, content: str, kind: str) -> None:
        data = content.encode()
        self.send_response(status)
        for name, value in (
            ("Content-Type", kind),
            ("Content-Length", str(len(data))),
            ("Content-Security-Policy", _POLICY),
            ("X-Content-Type-Options", "nosniff"),
            ("Referrer-Policy", "no-referrer"),
            ("Cache-Control", "no-store"),
        ):
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing: a line per request would drown what matters."""
