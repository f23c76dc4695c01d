"""The page of a run or campaign, which updates itself: its state, from its files alone, and the server of the two."""

import json
import threading
from collections import Counter
from contextlib import AbstractContextManager, suppress
from datetime import datetime, timedelta
from functools import lru_cache
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from ipaddress import ip_address
from pathlib import Path
from socket import gethostname
from socketserver import TCPServer
from typing import Any
from urllib.parse import unquote, urlsplit

from barn_eval.analysis.measures import ranking_measure
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.sources import Source, entries_of, read_source
from barn_eval.analysis.summary import make_bars
from barn_eval.analysis.text_table import count_noun
from barn_eval.analysis.verdict import Conclusion, conclude_results, list_cautions
from barn_eval.pages import LOOPBACK, PAGE_PORT
from barn_eval.pages.replay.page import replay_page
from barn_eval.pages.template import render, themed
from barn_eval.results.bags import BAGS
from barn_eval.results.bags.recorded import read_recorded_trial
from barn_eval.results.rows import ROWS_FILE, RowFile
from barn_eval.results.run_file import RunFile
from barn_eval.trials.outcome import Outcome
from barn_eval.trials.result import Rows, TrialResult
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.base.text_files import make_json_safe

MOST_LISTED = 50  # trials and failures
_RECENT = 60  # trials, from whose times the rate is taken
_IDLE_S = 10.0  # after which a connection that says nothing is closed
_KEPT_REPLAYS = 4
_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; connect-src 'self'"
_HEADERS = {"Content-Security-Policy": _POLICY, "X-Content-Type-Options": "nosniff"}
_HEADERS |= {"Referrer-Policy": "no-referrer", "Cache-Control": "no-store"}
_HTML, _TEXT = "text/html; charset=utf-8", "text/plain; charset=utf-8"


class CampaignState:
    """The state of a folder as plain data, computed anew only when its results have changed."""

    def __init__(self, folder: Path) -> None:
        RunFile.read(folder)
        self.folder = folder
        self._seen: tuple[int, int] | None = None
        self._state: dict[str, Any] = {}

    def read(self) -> dict[str, Any]:
        """Return the state: progress, verdict, bars, failures and last trials; "problem" where files cannot be read."""
        path = self.folder / ROWS_FILE
        found = path.stat() if path.exists() else None
        seen = (found.st_size, found.st_mtime_ns) if found else (0, 0)
        if seen != self._seen or not self._state:
            try:
                self._state = state_of(self.folder)
            except (BarnError, OSError) as error:
                self._state = {
                    "title": self.folder.resolve().name,
                    "problem": str(error),
                }
            self._seen = seen
        return self._state

    def bag(self, trial_id: str) -> Path:
        """Return the bag of a trial of this folder; ConfigError if it has none, or if that lies elsewhere."""
        bag = self.folder / BAGS / trial_id
        known = trial_id in {result.trial_id for result in RowFile(self.folder).read()}
        if (
            not known
            or not bag.is_dir()
            or self.folder.resolve() not in bag.resolve().parents
        ):
            raise ConfigError(
                f"{trial_id[:100]!r}: there is no bag of a trial of this name"
            )
        return bag


def state_of(folder: Path) -> dict[str, Any]:
    """Return how an experiment stands; BarnError if its files do not belong together."""
    rows = RowFile(folder).read()
    source = read_source(folder, rows)
    results = source.results
    state: dict[str, Any] = {
        "title": folder.resolve().name,
        "problem": "",
        "done": len(results),
        "planned": source.planned,
        "again": sum(not row.is_scored for row in rows),
        "outcomes": [
            (_words(name), count)
            for name, count in Counter(one.outcome for one in results).most_common()
        ],
        **_pace(rows, source.planned),
        "failures": [
            _trial(folder, row) for row in rows[::-1] if not row.scores.success
        ][:MOST_LISTED],
        "latest": [_trial(folder, row) for row in rows[::-1][:MOST_LISTED]],
    }
    nothing = {
        "verdict": "No trial has ended yet.",
        "details": "",
        "bars": [],
        "notes": [],
    }
    return state | (_leader(source) if results else nothing)


def _leader(source: Source) -> dict[str, Any]:
    entries = entries_of([source])
    metric = ranking_measure(source.results)
    first, shown = source.results[0], make_bars(entries)
    try:
        told = conclude_results({entry.label: entry.results for entry in entries})
    except BarnError as error:
        told = Conclusion(str(error))
    return {
        "task": f"Protocol {first.protocol}, robot {source.robot or 'Jackal'}",
        "metric": f"{metric.heading}, from 0 to {shown.limit}: means over {count_noun(shown.worlds, 'world')}",
        "verdict": told.short,
        "details": told.details,
        "notes": list_cautions(shown.worlds),
        "bars": [bar | {"colour": themed(bar["colour"])} for bar in shown.rows],
    }


def _pace(rows: Rows, planned: int | None) -> dict[str, Any]:
    """Return when the last trial ended (ISO 8601), trials per minute of the last ones, and seconds left at that."""
    ends = sorted(end for end in map(_end, rows[-_RECENT:]) if end is not None)
    span_s = (ends[-1] - ends[0]).total_seconds() if ends else 0.0
    if span_s <= 0.0:
        return {
            "last": ends[-1].isoformat() if ends else "",
            "per_minute": None,
            "left_s": None,
        }
    rate = (len(ends) - 1) / span_s
    left = (
        max(0, planned - sum(row.is_scored for row in rows)) / rate if planned else None
    )
    return {"last": ends[-1].isoformat(), "per_minute": 60.0 * rate, "left_s": left}


def _end(row: TrialResult) -> datetime | None:
    try:
        began = datetime.fromisoformat(row.wall_clock.started_at)
    except ValueError:  # rows of the evaluator do not say
        return None
    return (
        began + timedelta(seconds=row.wall_clock.duration_s) if began.tzinfo else None
    )


def _trial(folder: Path, row: TrialResult) -> dict[str, Any]:
    return {
        "id": row.trial_id,
        "planner": spelling(row.planner),
        "world": row.world,
        "outcome": _words(row.outcome),
        "detail": row.detail,
        "counts": row.is_scored,
        "time_s": row.scores.traversal_time_s if row.scores.success else None,
        "bag": (folder / BAGS / row.trial_id).is_dir(),
    }


def _words(outcome: Outcome) -> str:
    return outcome.value.replace("_", " ")


class Watch(AbstractContextManager["Watch"]):
    """The page of a folder, served from a thread until it is closed; a context manager.

    host: an address of this machine. port: 0 takes any that is free. Raises ConfigError in one line for a folder
    without an experiment, and for an address that cannot be had.
    """

    def __init__(
        self, folder: str | Path, *, host: str = LOOPBACK, port: int = PAGE_PORT
    ) -> None:
        state = CampaignState(Path(folder))
        try:
            self._server = _Server((host, port), state)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise ConfigError(
                f"host {host!r}, port {port}: cannot be served: {reason}"
            ) from None
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
        self.replay = lru_cache(_KEPT_REPLAYS)(
            lambda bag: replay_page(read_recorded_trial(bag))
        )
        super().__init__(address, _Handler)

    def page(self, path: str) -> tuple[HTTPStatus, str, str]:
        """Return status, content and type of a path; BarnError for a bag that cannot be read."""
        with self.lock:
            if path == "/":
                return (
                    HTTPStatus.OK,
                    render("campaign.html", data=self.state.read()),
                    _HTML,
                )
            if path == "/state":
                return (
                    HTTPStatus.OK,
                    json.dumps(make_json_safe(self.state.read()), allow_nan=False),
                    "application/json",
                )
            if path.startswith("/replay/"):
                return (
                    HTTPStatus.OK,
                    self.replay(self.state.bag(unquote(path.removeprefix("/replay/")))),
                    _HTML,
                )
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
        status, content, kind = (
            HTTPStatus.FORBIDDEN,
            "not the name of this machine",
            _TEXT,
        )
        if self.server.allowed(self.headers.get("Host", "")):
            try:
                status, content, kind = self.server.page(urlsplit(self.path).path)
            except (BarnError, OSError, ValueError) as error:
                status, content = HTTPStatus.NOT_FOUND, str(error)
        data = content.encode()
        self.send_response(status)
        for name, value in {
            "Content-Type": kind,
            "Content-Length": str(len(data)),
            **_HEADERS,
        }.items():
            self.send_header(name, value)
        with suppress(
            ConnectionError
        ):  # of a client that leaves before the answer's end
            self.end_headers()
            self.wfile.write(data)

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing: a line per request would drown what matters."""
