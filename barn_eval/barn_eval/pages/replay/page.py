"""The replay page of a trial, or of several on one clock."""

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any

from barn_eval.analysis.measures import MEASURES, MOVING, SHOWN
from barn_eval.analysis.planners import assign_colors, spelling
from barn_eval.pages.replay.payload import make_payload
from barn_eval.pages.template import render
from barn_eval.results.bags.recorded import MAP, RecordedTrial
from barn_metrics.bootstrap import number

_SEEDS = ("campaign_seed", "simulator_seed", "planner_seed", "repetition")


def replay_page(*recorded_trials: RecordedTrial) -> str:
    """Return the HTML page of one or several trials, with text from bags escaped."""
    labels = label_trials(recorded_trials)
    planners = [planner_of(recorded) for recorded in recorded_trials]
    colors = assign_colors(planners)
    has_colors = len(recorded_trials) > 1 or planners[0] != ""
    trials = []
    payloads = []
    for label, color, recorded in zip(labels, colors, recorded_trials, strict=True):
        trials.append(
            {
                "label": label,
                "color": color if has_colors else "",
                "subtitle": describe(recorded),
                "notes": recorded.notes,
            }
        )
        payloads.append(make_payload(recorded) | {"label": label, "color": color})

    facts = [list_facts(recorded) for recorded in recorded_trials]
    first = recorded_trials[0]
    world_keys = {world_key(recorded) for recorded in recorded_trials}
    names = dict.fromkeys(recorded.name for recorded in recorded_trials)
    return render(
        "replay.html",
        title=" and ".join(names),
        trials=trials,
        facts=facts,
        fact_names=dict.fromkeys(chain.from_iterable(facts)),
        frames=dict.fromkeys(recorded.frame for recorded in recorded_trials),
        map_frame=MAP,
        along_path=all(payload["along_path"] for payload in payloads),
        moving=any(recorded.moving is not None for recorded in recorded_trials),
        same_world=len(world_keys) == 1 and first.scene is not None,
        data={"trials": payloads},
    )


def label_trials(recorded_trials: Sequence[RecordedTrial]) -> list[str]:
    """Return distinct labels: planner and, if it appears twice, bag, folder or number."""
    names = [spelling(planner_of(trial)) or trial.name for trial in recorded_trials]
    counts = Counter(names)
    # The shortest origin that tells the trials apart.
    for template in ("{trial.name}", "{trial.folder}", "{trial.folder}/{trial.name}"):
        labels = []
        for name, trial in zip(names, recorded_trials, strict=True):
            origin = template.format(trial=trial)
            labels.append(f"{name} ({origin})" if counts[name] > 1 else name)
        if len(set(labels)) == len(labels):
            return labels
    return [f"{name} ({place})" for place, name in enumerate(names, 1)]


def world_key(recorded: RecordedTrial) -> bytes:
    """Return a key, equal for trials in the same world; empty without a scene."""
    if recorded.scene is None:
        return b""
    cylinders = recorded.scene.cylinders_m.tobytes()
    if recorded.moving is None:
        return cylinders
    # Motions are not in the scene, so equal cylinders may be of two worlds.
    checksum = _mapping(recorded.trial, "world").get("checksum")
    return cylinders + str(checksum).encode()


def describe(recorded: RecordedTrial) -> str:
    """Return a text with planner, world and protocol, if known, and simulated time [s]."""
    parts = []
    planner = planner_of(recorded)
    if planner:
        parts.append(f"planner {spelling(planner)}")
    world = _find_name(recorded, "world", "world_name")
    if world:
        parts.append(f"world {world.removeprefix('world_')}")
    protocol = _find_name(recorded, "protocol", "protocol")
    if protocol:
        parts.append(f"{protocol} protocol")
    parts.append(f"{recorded.times_s[-1]:.2f} s of simulated time")
    return ", ".join(parts)


def planner_of(recorded: RecordedTrial) -> str:
    """Return the name of the planner, or "" if the bag has none."""
    return _find_name(recorded, "planner", "planner")


def _find_name(recorded: RecordedTrial, part: str, key: str) -> str:
    """Return the name in a part of the trial, or else `key` of its result, or ""."""
    name = _mapping(recorded.trial, part).get("name")
    return str(name or recorded.result.get(key) or "")


def outcome_at(recorded: RecordedTrial, time_s: float) -> str:
    """Return the outcome, or that the bag has none, from the trial's end on, else "".

    Args:
        recorded: The trial.
        time_s: Time since its start.
    """
    # Times of frames are sums of periods, which round.
    if time_s < recorded.times_s[-1] - 1e-6:
        return ""
    outcome = recorded.result.get("outcome", "no result in the bag")
    return _value_text(outcome).replace("_", " ")


def list_facts(recorded: RecordedTrial) -> dict[str, str]:
    """Return outcome, scores, measures and seeds as texts; outcome alone without result."""
    result = recorded.result
    if not result:
        return {"outcome": "not in the bag"}
    facts = {"outcome": _value_text(result.get("outcome"))}
    if result.get("detail"):
        facts["how it ended"] = _value_text(result["detail"])

    parts = {
        "scores": SHOWN["replay scores"],
        "measures": SHOWN["replay measures"],
        "motion": MOVING,
    }
    for part, keys in parts.items():
        values = _mapping(result, part)
        if values.get("touched"):
            facts["first contact with"] = _value_text(values["touched"])
        for key in keys:
            if key not in values:
                continue
            measure = MEASURES[key]
            value = values[key]
            # A bag may come from anywhere, so its values have any type.
            is_number = isinstance(value, int | float)
            text = measure.number(value) if is_number else "none"
            facts[measure.trial_heading] = text

    phase_s = _mapping(result, "motion").get("phase_s")
    if isinstance(phase_s, int | float):
        facts["phase of moving obstacles [s]"] = number(phase_s, 2)
    seeds = []
    for name in _SEEDS:
        seeds.append(f"{name.removesuffix('_seed')} {_value_text(result.get(name))}")
    facts["seeds"] = ", ".join(seeds)
    facts["world checksum"] = _value_text(result.get("world_checksum"))
    return facts


def _mapping(content: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """Return a mapping inside another, empty where there is none."""
    value = content.get(key)
    return value if isinstance(value, Mapping) else {}


def _value_text(value: object) -> str:
    """Return a value of a bag as text, "not known" for None."""
    return "not known" if value is None else str(value)
