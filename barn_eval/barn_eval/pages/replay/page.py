"""The page of a trial, or of several on one clock, and what is said of a trial in words and figures."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from barn_eval.analysis.measures import MEASURES, MOVING
from barn_eval.analysis.planners import assign_colors, spelling
from barn_eval.pages.replay.payload import payload
from barn_eval.pages.template import render
from barn_eval.results.bags.recorded import MAP, RecordedTrial
from barn_metrics.bootstrap import number

_SCORES = (
    "traversal_time_s",
    "normalised_time_s_per_m",
    "challenge",
    "challenge_2022",
    "optimal_time_s",
)
_MEASURES = ("driven_m", "min_clearance_m", "contact_s")
_SEEDS = ("campaign_seed", "simulator_seed", "planner_seed", "repetition")


def replay_page(*found: RecordedTrial) -> str:
    """Return the page of one trial or several, whatever their bags hold as text being text in it."""
    named = labels(found)
    shades = assign_colors([planner_of(recorded) for recorded in found])
    known = len(found) > 1 or planner_of(found[0])
    trials, drawn = [], []
    for label, shade, one in zip(named, shades, found, strict=True):
        trials.append(
            {
                "label": label,
                "colour": shade if known else "",
                "subtitle": subtitle(one),
                "notes": one.notes,
            }
        )
        drawn.append(payload(one) | {"label": label, "colour": shade})
    rows = [dict(facts(recorded)) for recorded in found]
    frames = {
        (recorded.frame, "true pose" if recorded.frame == MAP else "odometry"): None
        for recorded in found
    }
    return render(
        "replay.html",
        title=" and ".join(dict.fromkeys(recorded.name for recorded in found)),
        trials=trials,
        facts=[
            (name, [row.get(name, "") for row in rows])
            for name in {key: None for row in rows for key in row}
        ],
        frames=list(frames),
        along_path=all(one["along_path"] for one in drawn),
        moving=any(recorded.moving is not None for recorded in found),
        same_world=len({world_key(recorded) for recorded in found}) == 1
        and found[0].scene is not None,
        data={"trials": drawn},
    )


def labels(found: Sequence[RecordedTrial]) -> list[str]:
    """Return by what trials are told apart: their planners and, for one that is there twice, bag or folder as well."""
    names = [spelling(planner_of(recorded)) or recorded.name for recorded in found]
    often = Counter(names)
    for more in (
        lambda one: one.name,
        lambda one: one.folder,
        lambda one: f"{one.folder}/{one.name}",
    ):
        told = [
            f"{name} ({more(one)})" if often[name] > 1 else name
            for name, one in zip(names, found, strict=True)
        ]
        if len(set(told)) == len(told):
            return told
    return [f"{name} ({number})" for number, name in enumerate(names, 1)]


def world_key(recorded: RecordedTrial) -> bytes:
    """Return what is equal for equal scenes."""
    if recorded.scene is None:
        return b""
    moving = (
        b""
        if recorded.moving is None
        else str(_mapping(recorded.trial, "world").get("checksum")).encode()
    )
    return recorded.scene.cylinders_m.tobytes() + moving


def subtitle(recorded: RecordedTrial) -> str:
    """Return which planner drove in which world, as far as the bag says."""
    result, trial = recorded.result, recorded.trial
    planner = planner_of(recorded)
    name = _mapping(trial, "world").get("name") or result.get("world_name")
    parts = [
        f"planner {spelling(planner)}" if planner else "",
        f"world {name.removeprefix('world_')}" if name else "",
    ]
    protocol = _mapping(trial, "protocol").get("name") or result.get("protocol")
    parts += [
        f"{protocol} protocol" if protocol else "",
        f"{recorded.times_s[-1]:.2f} s of simulated time",
    ]
    return ", ".join(part for part in parts if part)


def planner_of(recorded: RecordedTrial) -> str:
    """Return the name of the planner, empty where the bag does not say."""
    return str(
        _mapping(recorded.trial, "planner").get("name")
        or recorded.result.get("planner")
        or ""
    )


def outcome_by(recorded: RecordedTrial, time_s: float) -> str:
    """Return the outcome once the trial has come to its end, an empty text before."""
    over = time_s >= recorded.times_s[-1] - 1e-6
    return (
        _text(recorded.result.get("outcome", "no result in the bag")).replace("_", " ")
        if over
        else ""
    )


def facts(recorded: RecordedTrial) -> list[tuple[str, str]]:
    """Return names and values of outcome, score and measures; the seeds that make the trial again."""
    result = recorded.result
    if not result:
        return [("outcome", "not in the bag")]
    rows = [("outcome", _text(result.get("outcome")))]
    if result.get("detail"):
        rows.append(("how it ended", _text(result["detail"])))
    for part, keys in (
        ("scores", _SCORES),
        ("measures", _MEASURES),
        ("motion", MOVING),
    ):
        values = _mapping(result, part)
        if values.get("touched"):
            rows.append(("first contact with", _text(values["touched"])))
        for measure in (MEASURES[key] for key in keys if key in values):
            value = values[measure.key]
            text = measure.number(value) if isinstance(value, (int, float)) else "none"
            rows.append((measure.trial_heading, text))
    phase_s = _mapping(result, "motion").get("phase_s")
    if isinstance(phase_s, (int, float)):
        rows.append(("phase of what moves [s]", number(phase_s, 2)))
    rows.append(
        (
            "seeds",
            ", ".join(
                f"{name.removesuffix('_seed')} {_text(result.get(name))}"
                for name in _SEEDS
            ),
        )
    )
    rows.append(("world checksum", _text(result.get("world_checksum"))))
    return rows


def _mapping(content: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    value = content.get(key)
    return value if isinstance(value, Mapping) else {}


def _text(value: object) -> str:
    return "not known" if value is None else str(value)
