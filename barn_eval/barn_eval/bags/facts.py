"""The trial and its score in words, from what the bag says of itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from barn_eval.bags.recorded import Recorded

# Key in the result, what it is called, unit.
_SCORES = (
    ("traversal_time_s", "time", "s"),
    ("normalised_time_s_per_m", "time per metre as counted", "s/m"),
    ("challenge", "challenge metric (of 0.5)", ""),
    ("challenge_2022", "challenge metric of 2022 (of 0.25)", ""),
    ("optimal_time_s", "optimal time", "s"),
)
_MEASURES = (
    ("driven_m", "driven length", "m"),
    ("min_clearance_m", "smallest clearance", "m"),
    ("contact_s", "time in contact", "s"),
)


def subtitle(recorded: Recorded) -> str:
    """Return which planner drove in which world, as far as the bag says."""
    result = recorded.result
    trial = recorded.trial
    world = _mapping(trial, "world")
    planner = _mapping(trial, "planner").get("name") or result.get("planner")
    name = world.get("name") or result.get("world_name")
    parts = [f"planner {planner}" if planner else "", f"world {name}" if name else ""]
    protocol = _mapping(trial, "protocol").get("name") or result.get("protocol")
    parts += [f"{protocol} protocol" if protocol else "", f"{recorded.times_s[-1]:.2f} s of simulated time"]
    return ", ".join(part for part in parts if part)


def facts(recorded: Recorded) -> list[tuple[str, str]]:
    """Return names and values of outcome, score and measures; the seeds that make the trial again."""
    result = recorded.result
    if not result:
        return [("outcome", "not in the bag")]
    rows = [("outcome", _text(result.get("outcome")))]
    if result.get("detail"):
        rows.append(("how it ended", _text(result["detail"])))
    for part, names in (("scores", _SCORES), ("measures", _MEASURES)):
        values = _mapping(result, part)
        rows += [(title, _number(values[key], unit)) for key, title, unit in names if key in values]
    seeds = ("campaign_seed", "simulator_seed", "planner_seed", "repetition")
    rows.append(("seeds", ", ".join(f"{name.removesuffix('_seed')} {_text(result.get(name))}" for name in seeds)))
    rows.append(("world checksum", _text(result.get("world_checksum"))))
    return rows


def _mapping(content: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    value = content.get(key)
    return value if isinstance(value, Mapping) else {}


def _number(value: Any, unit: str) -> str:
    if not isinstance(value, (int, float)):
        return "none"
    return f"{value:.3f} {unit}".rstrip()


def _text(value: Any) -> str:
    return "not known" if value is None else str(value)
