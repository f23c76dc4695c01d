"""Serve a page on a run that updates itself, from the run's files alone."""

import json
import threading
from collections import Counter
from contextlib import suppress
from datetime import datetime, timedelta
from functools import lru_cache
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from ipaddress import ip_address
from pathlib import Path
from socket import gethostname
from socketserver import TCPServer
from typing import Any, NamedTuple
from urllib.parse import unquote, urlsplit

from barn_eval.analysis.entries import entries_of
from barn_eval.analysis.measures import ranking_measure
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.sources import Source, read_source
from barn_eval.analysis.summary import make_bars
from barn_eval.analysis.text_table import count_noun
from barn_eval.analysis.verdict import Conclusion, conclude_results, list_cautions
from barn_eval.pages import LOOPBACK, PAGE_PORT
from barn_eval.pages.live.gate import accepts_viewer
from barn_eval.pages.replay.page import replay_page
from barn_eval.pages.template import render, themed
from barn_eval.results.bags import BAGS
from barn_eval.results.bags.recorded import read_recorded_trial
from barn_eval.results.rows import ROWS_FILE, RowFile
from barn_eval.results.run_file import RunFile
from barn_eval.trials.result import Rows, TrialResult
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.base.files import make_json_safe

MAX_LISTED = 50  # trials, and failures
_RATE_TRIALS = 60  # the last trials, from which the rate is computed
_IDLE_S = 10.0  # a connection that says nothing for so long is closed
_CACHED_REPLAYS = 4
_HTML = "text/html; charset=utf-8"
_TEXT = "text/plain; charset=utf-8"
# A page shows text of planners, so it may load and run nothing but its own.
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
        "img-src data:; connect-src 'self'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


class RunState:
    """The state of a results folder, computed anew only when its rows have changed."""

    def __init__(self, folder: Path):
        """Keep the folder for `read`; ConfigError if it holds no run."""
        RunFile.read(folder)
        self.folder = folder
        # The argument is the version of the rows, by which the state is cached.
        self._read_version = lru_cache(maxsize=1)(lambda _: read_state(folder))

    def read(self) -> dict[str, Any]:
        """Return the run's state as JSON data, cached until rows change, or its "problem".

        "problem" says why files cannot be read.
        """
        path = self.folder / ROWS_FILE
        version = (0, 0)
        if path.exists():
            status = path.stat()
            # Size and time: two rows may come within one step of the file's clock.
            version = (status.st_size, status.st_mtime_ns)
        # The version is from before the reading, so that rows which come meanwhile are
        # read next time.
        try:
            return self._read_version(version)
        except (BarnError, OSError) as error:
            # The run goes on, and the next look may succeed: errors are not cached.
            return {"title": self.folder.resolve().name, "problem": str(error)}

    def bag(self, trial_id: str) -> Path:
        """Return the folder of a trial's bag; ConfigError if missing or outside the run."""
        trial_ids = {result.trial_id for result in RowFile(self.folder).read()}
        bag = self.folder / BAGS / trial_id
        # Only names of trials are looked up on disk: others are a client's, and may be
        # anything. A link could lead to a bag outside the folder.
        if (
            trial_id not in trial_ids
            or not bag.is_dir()
            or self.folder.resolve() not in bag.resolve().parents
        ):
            raise ConfigError(
                f"{trial_id[:100]!r}: there is no bag of a trial with this name"
            )
        return bag


def read_state(folder: Path) -> dict[str, Any]:
    """Return progress, outcomes, last trials and conclusion of a run as JSON data.

    BarnError if its files do not belong together.
    """
    rows = RowFile(folder).read()
    source = read_source(folder, rows)
    results = source.results
    newest = rows[::-1]
    failures = [row for row in newest if not row.scores.success]
    counts = Counter(result.outcome for result in results).most_common()
    state: dict[str, Any] = {
        "title": folder.resolve().name,
        "problem": "",
        "done": len(results),
        "planned": source.planned,
        "again": sum(not row.is_scored for row in rows),
        "outcomes": [(outcome.words, count) for outcome, count in counts],
        **_pace(rows, source.planned),
        "failures": [_trial_state(folder, row) for row in failures[:MAX_LISTED]],
        "latest": [_trial_state(folder, row) for row in newest[:MAX_LISTED]],
    }
    if results:
        return state | _conclusion_state(source)
    return state | {
        "verdict": "No trial has ended yet.",
        "details": "",
        "bars": [],
        "notes": [],
    }


def _conclusion_state(source: Source) -> dict[str, Any]:
    """Return task, conclusion, cautions and bars of results so far as JSON data."""
    entries = entries_of([source])
    measure = ranking_measure(source.results)
    bars = make_bars(entries)
    try:
        conclusion = conclude_results({e.label: e.results for e in entries})
    except BarnError as error:
        conclusion = Conclusion(str(error))
    protocol = source.results[0].protocol
    worlds = count_noun(bars.worlds, "world")
    return {
        "task": f"Protocol {protocol}, robot {source.robot or 'Jackal'}",
        "metric": f"{measure.heading}, from 0 to {bars.limit}: means over {worlds}",
        "verdict": conclusion.short,
        "details": conclusion.details,
        "notes": list_cautions(bars.worlds),
        "bars": [bar | {"color": themed(bar["color"])} for bar in bars.rows],
    }


def _pace(rows: Rows, planned: int | None) -> dict[str, Any]:
    """Return last trial's end, trials per minute and seconds left, as known, as JSON data.

    The rate is that of the last trials; there is none before two of them have ended.
    """
    # Only the last trials: early ones compile kernels, and planners differ in speed.
    pace: dict[str, Any] = {"last": "", "per_minute": None, "left_s": None}
    ends = sorted(filter(None, map(_end_of, rows[-_RATE_TRIALS:])))
    if not ends:
        return pace
    pace["last"] = ends[-1].isoformat()
    span_s = (ends[-1] - ends[0]).total_seconds()
    if span_s > 0.0:
        rate = (len(ends) - 1) / span_s
        pace["per_minute"] = 60.0 * rate
        if planned:
            done = sum(row.is_scored for row in rows)
            pace["left_s"] = max(0, planned - done) / rate
    return pace


def _end_of(row: TrialResult) -> datetime | None:
    """Return when a trial ended; None if its row has no start, or one without a zone."""
    try:
        start = datetime.fromisoformat(row.wall_clock.started_at)
    except ValueError:
        return None
    # Times with and without a zone cannot be sorted together.
    if start.tzinfo is None:
        return None
    return start + timedelta(seconds=row.wall_clock.duration_s)


def _trial_state(folder: Path, row: TrialResult) -> dict[str, Any]:
    """Return a trial as the page lists it, as JSON data."""
    return {
        "id": row.trial_id,
        "planner": spelling(row.planner),
        "world": row.world,
        "outcome": row.outcome.words,
        "detail": row.detail,
        "counts": row.is_scored,
        "time_s": row.scores.traversal_time_s if row.scores.success else None,
        "bag": (folder / BAGS / row.trial_id).is_dir(),
    }


class _Response(NamedTuple):
    """The response to a request."""

    status: HTTPStatus
    content: str
    media_type: str


class PageServer(ThreadingHTTPServer):
    """Serves the page of a results folder from a thread until it is closed.

    Content is computed for one request at a time.
    """

    daemon_threads = True

    def __init__(
        self, folder: str | Path, *, host: str = LOOPBACK, port: int = PAGE_PORT
    ):
        """Start a thread that serves; ConfigError if the address cannot be served on.

        Args:
            folder: A results folder.
            host: An address of this machine.
            port: A port; 0 takes any that is free.

        Raises:
            ConfigError: The folder holds no run, or the address is not available.
        """
        self._state = RunState(Path(folder))
        self._lock = threading.Lock()
        # Drawing takes seconds, and a page is several megabytes.
        self._replay = lru_cache(_CACHED_REPLAYS)(
            lambda bag: replay_page(read_recorded_trial(bag))
        )
        try:
            super().__init__((host, port), _Handler)
        except (OSError, OverflowError) as error:
            # A port above 65535 is an OverflowError, which has no strerror.
            reason = getattr(error, "strerror", None) or error
            raise ConfigError(
                f"host {host!r}, port {port}: cannot be served: {reason}"
            ) from None
        address, bound_port = self.server_address[:2]
        # A server may listen on 0.0.0.0, but a browser cannot open that everywhere.
        if ip_address(str(address)).is_unspecified:
            host = LOOPBACK
        self.url = f"http://{host}:{bound_port}/"
        self._thread = threading.Thread(target=self.serve_forever, daemon=True)
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        """Close the server, as `close` does."""
        self.close()

    def close(self) -> None:
        """Stop serving, close the socket and wait for the thread to end."""
        self.shutdown()
        self.server_close()
        self._thread.join()

    def respond(self, path: str) -> _Response:
        """Return page, state (JSON) or replay for a URL path; BarnError for any other.

        BarnError also for a bag that is not there or cannot be read.
        """
        with self._lock:
            if path == "/":
                page = render("campaign.html", data=self._state.read())
                return _Response(HTTPStatus.OK, page, _HTML)
            if path == "/state":
                state = make_json_safe(self._state.read())
                content = json.dumps(state, allow_nan=False)
                return _Response(HTTPStatus.OK, content, "application/json")
            if path.startswith("/replay/"):
                bag = self._state.bag(unquote(path.removeprefix("/replay/")))
                return _Response(HTTPStatus.OK, self._replay(bag), _HTML)
        raise ConfigError("there is nothing here")

    def server_bind(self) -> None:
        """Bind the socket without asking a name server for the address's name."""
        TCPServer.server_bind(self)
        self.server_name = gethostname()
        self.server_port = self.server_address[1]


class _Handler(BaseHTTPRequestHandler):
    """Answers the requests of one connection to the page's server."""

    server: PageServer
    timeout = _IDLE_S
    server_version = "barn"
    sys_version = ""

    def do_GET(self) -> None:
        """Answer a GET request with a page or JSON, or a line that says why not."""
        if accepts_viewer(self.headers):
            try:
                response = self.server.respond(urlsplit(self.path).path)
            except (BarnError, OSError, ValueError) as error:
                response = _Response(HTTPStatus.NOT_FOUND, str(error), _TEXT)
        else:
            reason = "refused: the name is not this machine's, or another site asks"
            response = _Response(HTTPStatus.FORBIDDEN, reason, _TEXT)

        content = response.content.encode()
        self.send_response(response.status)
        self.send_header("Content-Type", response.media_type)
        self.send_header("Content-Length", str(len(content)))
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        # A client may leave before the answer ends.
        with suppress(ConnectionError):
            self.end_headers()
            self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing, because a line per request would hide messages that matter."""
