"""The trial and its score in words, from what the bag says of itself."""

from collections.abc import Mapping
from typing import Any

from barn_eval.analysis.measures import MEASURES, Measure
from barn_eval.analysis.planner_style import spelling
from barn_eval.bags.recorded import Recorded

_SCORES = ("traversal_time_s", "normalised_time_s_per_m", "challenge", "challenge_2022", "optimal_time_s")
_MEASURES = ("driven_m", "min_clearance_m", "contact_s")


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
