"""The replay of a trial as one HTML file."""

from __future__ import annotations

from pathlib import Path

from barn_eval.bags.facts import facts, subtitle
from barn_eval.bags.recorded import Recorded
from barn_eval.pages.page import render, write_page
from barn_eval.pages.replay_payload import payload


def replay_page(recorded: Recorded) -> str:
    """Return the page, whatever the bag holds as text being text in it."""
    return render(
        "replay.html",
        title=recorded.name,
        subtitle=subtitle(recorded),
        notes=recorded.notes,
        facts=facts(recorded),
        data=payload(recorded),
    )


def write_replay(recorded: Recorded, path: Path) -> None:
    """Write the page; ConfigError or StoreError if it cannot be written."""
    write_page(path, replay_page(recorded))
