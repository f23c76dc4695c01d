"""The server of a campaign's page: the page, its state and replays of its bags, and no other file."""

import json
import threading
from collections import OrderedDict
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from ipaddress import ip_address
from pathlib import Path
from socket import gethostname
from socketserver import TCPServer
from types import TracebackType
from urllib.parse import unquote, urlsplit

from barn_eval.bags.recorded import read_recorded
from barn_eval.pages import LOOPBACK, PAGE_PORT
from barn_eval.pages.live.state import CampaignState, campaign_page
from barn_eval.pages.replay.page import replay_page
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.base.text_files import finite

MOST_REQUESTS = 16  # at a time
_IDLE_S = 10.0  # after which a connection that says nothing is closed
_KEPT_REPLAYS = 4
_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; connect-src 'self'"
_HTML, _JSON = "text/html; charset=utf-8", "application/json"


class Watch:
    """The page of a folder, served from a thread until it is closed; a context manager.

    host: an address of this machine. port: 0 takes any that is free. Raises ConfigError in one line for a folder
    without an experiment, and for an address that cannot be had.
    """

    def __init__(self, folder: str | Path, *, host: str = LOOPBACK, port: int = PAGE_PORT) -> None:
        pages = _Pages(CampaignState(Path(folder)))
        try:
            self._server = _Server((host, port), pages)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise ConfigError(f"host {host!r}, port {port}: cannot be served: {reason}") from None
        address, bound = self._server.server_address[:2]
        shown = LOOPBACK if ip_address(str(address)).is_unspecified else host
        self.url = f"http://{shown}:{bound}/"
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def __enter__(self) -> "Watch":
        """Return the page."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """Stop to serve."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Pages:
    """What is served, computed for one request at a time."""

    def __init__(self, state: CampaignState) -> None:
        self._state = state
        self._replays: OrderedDict[str, bytes] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, path: str) -> tuple[str, bytes] | None:
        """Return type and content of a path, None where there is nothing; BarnError for a bag that cannot be read."""
        with self._lock:
            if path == "/":
                return _HTML, campaign_page(self._state).encode()
            if path == "/state":
                return _JSON, json.dumps(finite(self._state.read()), allow_nan=False).encode()
            if path.startswith("/replay/"):
                return _HTML, self._replay(unquote(path.removeprefix("/replay/")))
            return None

    def _replay(self, trial_id: str) -> bytes:
        bag = self._state.bag(trial_id)
        if trial_id not in self._replays:
            self._replays[trial_id] = replay_page(read_recorded(bag)).encode()
            if len(self._replays) > _KEPT_REPLAYS:
                self._replays.popitem(last=False)
        return self._replays[trial_id]


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, address: tuple[str, int], pages: _Pages) -> None:
        self.pages = pages
        self.slots = threading.BoundedSemaphore(MOST_REQUESTS)
        super().__init__(address, _Handler)

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
        if not self.server.slots.acquire(blocking=False):
            self._send(HTTPStatus.SERVICE_UNAVAILABLE, "text/plain; charset=utf-8", b"busy")
            return
        try:
            self._answer()
        finally:
            self.server.slots.release()

    def _answer(self) -> None:
        if not self.server.allowed(self.headers.get("Host", "")):
            self._send(HTTPStatus.FORBIDDEN, "text/plain; charset=utf-8", b"not the name of this machine")
            return
        try:
            found = self.server.pages.get(urlsplit(self.path).path)
        except (BarnError, OSError, ValueError) as error:
            self._send(HTTPStatus.NOT_FOUND, "text/plain; charset=utf-8", str(error).encode())
            return
        if found is None:
            self._send(HTTPStatus.NOT_FOUND, "text/plain; charset=utf-8", b"there is nothing here")
        else:
            self._send(HTTPStatus.OK, *found)

    def _send(self, status: HTTPStatus, kind: str, content: bytes) -> None:
        self.send_response(status)
        for name, value in (
            ("Content-Type", kind),
            ("Content-Length", str(len(content))),
            ("Content-Security-Policy", _POLICY),
            ("X-Content-Type-Options", "nosniff"),
            ("Referrer-Policy", "no-referrer"),
            ("Cache-Control", "no-store"),
        ):
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing: a line per request would drown what matters."""
