"""The replay of a trial: as one HTML file, a picture, a GIF or a film."""

from collections.abc import Callable
from pathlib import Path

from barn_eval.analysis.planner_style import colours
from barn_eval.bags.recorded import Recorded, read_recorded
from barn_eval.pages.page import render, write_page
from barn_eval.pages.replay_facts import facts, planner_of, subtitle
from barn_eval.pages.replay_payload import payload


def write_replay(
    bag: Path,
    *,
    html: Path | None = None,
    png: Path | None = None,
    gif: Path | None = None,
    mp4: Path | None = None,
    frames_per_s: float = 10.0,
    speed: float = 2.0,
    note: Callable[[str], None] = lambda _: None,
) -> list[Path]:
    """Write the trial of a bag to the files named and return them; without any, to a page named after the bag.

    frames_per_s, speed: of GIF and film, the latter in multiples of the trial's own. note: gets a line for each thing
    that is amiss with the bag. Raises BagError, ConfigError or StoreError in one line.
    """
    recorded = read_recorded(bag)
    for line in recorded.notes:
        note(f"note: {line}")
    if not (html or png or gif or mp4):
        html = Path(f"{recorded.name.removesuffix('.mcap')}.html")
    if html:
        write_page(html, replay_page(recorded))
    if png or gif or mp4:
        from barn_eval.pages import replay_draw as draw  # noqa: PLC0415 (matplotlib)

        if png:
            draw.write_png(recorded, png)
        if gif:
            draw.write_gif(recorded, gif, frames_per_s, speed)
        if mp4:
            draw.write_mp4(recorded, mp4, frames_per_s, speed)
    return [path for path in (html, png, gif, mp4) if path]


def replay_page(recorded: Recorded) -> str:
    """Return the page, whatever the bag holds as text being text in it."""
    planner = planner_of(recorded)
    return render(
        "replay.html",
        title=recorded.name,
        colour=colours([planner])[0] if planner else "",
        subtitle=subtitle(recorded),
        notes=recorded.notes,
        facts=facts(recorded),
        data=payload(recorded),
    )
