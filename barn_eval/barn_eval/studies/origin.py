"""With what a reproduction was made: the only part of it that names commits, versions and machines."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from barn_eval.experiments.provenance import provenance


@dataclass(frozen=True)
class Origin:
    """Commits, versions and machines of all sessions of the campaigns and of this analysis, each named once."""

    commits: tuple[str, ...]
    versions: tuple[dict[str, str], ...]
    machines: tuple[dict[str, Any], ...]


def origin(runs: Iterable[Mapping[str, Any]]) -> Origin:
    """Return what campaigns, given by their run.json, and this process have been made with."""
    sessions = [session for run in runs for session in run["sessions"]] + [provenance()]
    return Origin(
        tuple(dict.fromkeys(str(session["commit"] or "not known") for session in sessions)),
        _distinct(session["versions"] for session in sessions),
        _distinct(session["machine"] for session in sessions),
    )


def _distinct(entries: Iterable[dict[str, Any]]) -> tuple[dict[str, Any], ...]:
    return tuple({json.dumps(entry, sort_keys=True): entry for entry in entries}.values())
