"""The replay of a trial: as one HTML file, a picture, a GIF or a film."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from barn_eval.analysis.measures import MEASURES, Measure
from barn_eval.analysis.sources import colours, spelling
from barn_eval.bags.recorded import Recorded, read_recorded
from barn_eval.pages.page import render, write_page
from barn_eval.pages.replay_payload import payload

_SCORES = ("traversal_time_s", "normalised_time_s_per_m", "challenge", "challenge_2022", "optimal_time_s")
_MEASURES = ("driven_m", "min_clearance_m", "contact_s")


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


def subtitle(recorded: Recorded) -> str:
    """Return which planner drove in which world, as far as the bag says."""
    result, trial = recorded.result, recorded.trial
    planner = planner_of(recorded)
    name = _mapping(trial, "world").get("name") or result.get("world_name")
    parts = [f"planner {spelling(planner)}" if planner else "", f"world {name}" if name else ""]
    protocol = _mapping(trial, "protocol").get("name") or result.get("protocol")
    parts += [f"{protocol} protocol" if protocol else "", f"{recorded.times_s[-1]:.2f} s of simulated time"]
    return ", ".join(part for part in parts if part)


def planner_of(recorded: Recorded) -> str:
    """Return the name of the planner, empty where the bag does not say."""
    return str(_mapping(recorded.trial, "planner").get("name") or recorded.result.get("planner") or "")


def facts(recorded: Recorded) -> list[tuple[str, str]]:
    """Return names and values of outcome, score and measures; the seeds that make the trial again."""
    result = recorded.result
    if not result:
        return [("outcome", "not in the bag")]
    rows = [("outcome", _text(result.get("outcome")))]
    if result.get("detail"):
        rows.append(("how it ended", _text(result["detail"])))
    for part, keys in (("scores", _SCORES), ("measures", _MEASURES)):
        values = _mapping(result, part)
        rows += [(MEASURES[key].trial_heading, _number(MEASURES[key], values[key])) for key in keys if key in values]
    seeds = ("campaign_seed", "simulator_seed", "planner_seed", "repetition")
    rows.append(("seeds", ", ".join(f"{name.removesuffix('_seed')} {_text(result.get(name))}" for name in seeds)))
    rows.append(("world checksum", _text(result.get("world_checksum"))))
    return rows


def _mapping(content: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    value = content.get(key)
    return value if isinstance(value, Mapping) else {}


def _number(measure: Measure, value: Any) -> str:
    return measure.number(value) if isinstance(value, (int, float)) else "none"


def _text(value: Any) -> str:
    return "not known" if value is None else str(value)
