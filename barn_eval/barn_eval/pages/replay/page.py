"""The replay of a trial, or of several on one clock: as one HTML file, a picture, a GIF or a film."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from barn_eval.analysis.measures import MEASURES, MOVING, Measure
from barn_eval.analysis.planners import colours, spelling
from barn_eval.bags.recorded import MAP, Recorded, read_recorded
from barn_eval.pages import Share
from barn_eval.pages.replay.payload import payload
from barn_eval.pages.template import render, write_page
from barn_metrics.bootstrap import number
from barn_worlds.base.errors import ConfigError

_SCORES = ("traversal_time_s", "normalised_time_s_per_m", "challenge", "challenge_2022", "optimal_time_s")
_MEASURES = ("driven_m", "min_clearance_m", "contact_s")
# What the page says of the time shown, by the ids of its places.
_READOUTS = (
    ("pose", "robot"),
    ("driven", "driven"),
    ("commanded", "commanded"),
    ("clearance", "clearance"),
    ("progress", "along the path"),
    ("contact", "contact"),
    ("score", "challenge metric so far"),
)
MOST_BAGS = 6


def write_replay(
    bags: Path | Sequence[Path],
    *,
    html: Path | None = None,
    png: Path | None = None,
    gif: Path | None = None,
    mp4: Path | None = None,
    frames_per_s: float = 10.0,
    speed: float = 2.0,
    camera: str = "",
    note: Callable[[str], None] = lambda _: None,
    share: Share = lambda _: None,
) -> list[Path]:
    """Write the trials of bags to the files named and return them; without any, to a page named after the first bag.

    frames_per_s, speed: of GIF and film, the latter in multiples of the trial's own. camera: "chase", "top" or "side"
    draws picture, GIF and film in three dimensions. note: gets a line for each thing that is amiss with a bag; share:
    the share of a GIF's or film's frames that is drawn. Raises BagError, ConfigError or StoreError in one line.
    """
    paths = [bags] if isinstance(bags, Path) else list(bags)
    if not 1 <= len(paths) <= MOST_BAGS:
        raise ConfigError(f"a replay shows 1 to {MOST_BAGS} bags, got {len(paths)}")
    found = [read_recorded(path) for path in paths]
    for recorded in found:
        for line in recorded.notes:
            note(f"note: {line}" if len(found) == 1 else f"note: {recorded.name}: {line}")
    if not (html or png or gif or mp4):
        names = [recorded.name.removesuffix(".mcap") for recorded in found]
        html = Path(f"{'_and_'.join(names[:2])}.html")
    if html:
        write_page(html, replay_page(*found))
    if camera or png or gif or mp4:
        _draw(found, camera, png, gif, mp4, frames_per_s, speed, share)
    return [path for path in (html, png, gif, mp4) if path]


def _draw(
    found: Sequence[Recorded],
    camera: str,
    png: Path | None,
    gif: Path | None,
    mp4: Path | None,
    frames_per_s: float,
    speed: float,
    share: Share,
) -> None:
    if camera:
        from barn_eval.pages.replay.camera import write_pictures  # noqa: PLC0415 (PyBullet)

        write_pictures(found, camera, png=png, gif=gif, mp4=mp4, frames_per_s=frames_per_s, speed=speed, share=share)
        return
    from barn_eval.pages.replay import picture as draw  # noqa: PLC0415 (matplotlib)

    if png:
        draw.write_png(found, png)
    if gif:
        draw.write_gif(found, gif, frames_per_s, speed, share)
    if mp4:
        draw.write_mp4(found, mp4, frames_per_s, speed, share)


def replay_page(*found: Recorded) -> str:
    """Return the page of one trial or several, whatever their bags hold as text being text in it."""
    named = labels(found)
    shades = colours([planner_of(recorded) for recorded in found])
    known = len(found) > 1 or planner_of(found[0])
    trials = [
        {"label": label, "colour": shade if known else "", "subtitle": subtitle(recorded), "notes": recorded.notes}
        for label, shade, recorded in zip(named, shades, found, strict=True)
    ]
    drawn = [
        payload(recorded) | {"label": label, "colour": shade}
        for label, shade, recorded in zip(named, shades, found, strict=True)
    ]
    rows = [dict(facts(recorded)) for recorded in found]
    frames = {(recorded.frame, "true pose" if recorded.frame == MAP else "odometry"): None for recorded in found}
    return render(
        "replay.html",
        title=" and ".join(dict.fromkeys(recorded.name for recorded in found)),
        trials=trials,
        readouts=_READOUTS,
        facts=[
            (name, [row.get(name, "") for row in rows]) for name in dict.fromkeys(key for row in rows for key in row)
        ],
        frames=list(frames),
        along_path=all(one["along_path"] for one in drawn),
        moving=any(recorded.moving is not None for recorded in found),
        same_world=len({_world(recorded) for recorded in found}) == 1 and found[0].scene is not None,
        data={"trials": drawn},
    )


def labels(found: Sequence[Recorded]) -> list[str]:
    """Return by what trials are told apart: their planners and, for one that is there twice, bag or folder as well."""
    names = [spelling(planner_of(recorded)) or recorded.name for recorded in found]
    often = Counter(names)
    for more in (lambda one: one.name, lambda one: one.folder, lambda one: f"{one.folder}/{one.name}"):
        told = [f"{name} ({more(one)})" if often[name] > 1 else name for name, one in zip(names, found, strict=True)]
        if len(set(told)) == len(told):
            return told
    return [f"{name} ({number})" for number, name in enumerate(names, 1)]


def _world(recorded: Recorded) -> bytes:
    """Return what is equal for equal scenes."""
    if recorded.scene is None:
        return b""
    moving = b"" if recorded.moving is None else str(_mapping(recorded.trial, "world").get("checksum")).encode()
    return recorded.scene.cylinders_m.tobytes() + moving


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


def outcome_by(recorded: Recorded, time_s: float) -> str:
    """Return the outcome once the trial has come to its end, an empty text before."""
    over = time_s >= recorded.times_s[-1] - 1e-6
    return _text(recorded.result.get("outcome", "no result in the bag")).replace("_", " ") if over else ""


def facts(recorded: Recorded) -> list[tuple[str, str]]:
    """Return names and values of outcome, score and measures; the seeds that make the trial again."""
    result = recorded.result
    if not result:
        return [("outcome", "not in the bag")]
    rows = [("outcome", _text(result.get("outcome")))]
    if result.get("detail"):
        rows.append(("how it ended", _text(result["detail"])))
    for part, keys in (("scores", _SCORES), ("measures", _MEASURES), ("motion", MOVING)):
        values = _mapping(result, part)
        if values.get("touched"):
            rows.append(("first contact with", _text(values["touched"])))
        rows += [(MEASURES[key].trial_heading, _number(MEASURES[key], values[key])) for key in keys if key in values]
    seeds = ("campaign_seed", "simulator_seed", "planner_seed", "repetition")
    phase_s = _mapping(result, "motion").get("phase_s")
    if isinstance(phase_s, (int, float)):
        rows.append(("phase of what moves [s]", number(phase_s, 2)))
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
