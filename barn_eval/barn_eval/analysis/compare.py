"""Comparisons of planners on the worlds and seeds that they share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from barn_eval.analysis.statistics import Paired, paired, rank_correlation
from barn_eval.trials.result import TrialResult
from barn_metrics.bootstrap import Floats, Integers, Interval
from barn_worlds.errors import BarnError

Value = Callable[[TrialResult], float | None]


@dataclass(frozen=True)
class Measure:
    """A figure of a trial that planners are compared by; None where a trial has none."""

    name: str
    unit: str
    larger_is_better: bool
    value: Value


MEASURES = (
    Measure("success", "", True, lambda one: float(one.scores.success)),
    Measure("time of successes", "s", False, lambda one: one.scores.traversal_time_s if one.scores.success else None),
    Measure("time as counted", "s", False, lambda one: one.scores.scored_time_s),
    Measure("time per metre as counted", "s/m", False, lambda one: one.scores.normalised_time_s_per_m),
    Measure("challenge metric", "", True, lambda one: one.scores.challenge),
    Measure("challenge metric of 2022", "", True, lambda one: one.scores.challenge_2022),
    Measure("driven length", "m", False, lambda one: one.measures.driven_m if one.scores.success else None),
    Measure("smallest clearance", "m", True, lambda one: one.measures.min_clearance_m),
    Measure("time in contact", "s", False, lambda one: one.measures.contact_s),
    Measure("rms jerk", "m/s3", False, lambda one: one.measures.rms_jerk_mps3),
    Measure("rotation", "rad", False, lambda one: one.measures.rotation_rad if one.scores.success else None),
)


@dataclass(frozen=True)
class Row:
    """The comparison of A and B by one measure, over the trials that both have a value for."""

    measure: str
    unit: str
    larger_is_better: bool
    paired: Paired


@dataclass(frozen=True)
class Comparison:
    """A and B on what they share; rank_correlation is Spearman's, of the counted time per metre over worlds."""

    a: str
    b: str
    protocol: str
    trials_a: int
    trials_b: int
    rows: tuple[Row, ...]
    rank_correlation: Interval


def compare(a: Sequence[TrialResult], b: Sequence[TrialResult], label_a: str = "", label_b: str = "") -> Comparison:
    """Compare the results of one planner with those of another, or of the same one under other settings.

    Raises BarnError for results that cannot be paired: of different protocols, of worlds that are not the same, of
    other seeds, or with no trial in common.
    """
    _check_pairs(a, b)
    return Comparison(
        label_a or a[0].planner,
        label_b or b[0].planner,
        a[0].protocol,
        len(a),
        len(b),
        tuple(_row(a, b, measure) for measure in MEASURES),
        rank_correlation(_columns(a, _normalised)[:2], _columns(b, _normalised)[:2]),
    )


def _row(a: Sequence[TrialResult], b: Sequence[TrialResult], measure: Measure) -> Row:
    first, second = _columns(a, measure.value), _columns(b, measure.value)
    found = paired(first, second, larger_is_better=measure.larger_is_better)
    return Row(measure.name, measure.unit, measure.larger_is_better, found)


def _normalised(result: TrialResult) -> float:
    return result.scores.normalised_time_s_per_m


def _columns(results: Sequence[TrialResult], value: Value) -> tuple[Floats, Integers, Integers]:
    values = [value(result) for result in results]
    return (
        np.array([np.nan if one is None else one for one in values], np.float64),
        np.array([result.world for result in results], np.int64),
        np.array([result.repetition for result in results], np.int64),
    )


def _check_pairs(a: Sequence[TrialResult], b: Sequence[TrialResult]) -> None:
    first, second = ({(one.world, one.repetition): one for one in results} for results in (a, b))
    if len(first) != len(a) or len(second) != len(b):
        raise BarnError("results of several planners cannot be compared as one; choose a planner of each")
    shared = first.keys() & second.keys()
    if not shared:
        raise BarnError("the two have no trial of the same world and repetition")
    for key in sorted(shared):
        one, other = first[key], second[key]
        for name, what in (
            ("protocol", "protocols"),
            ("world_checksum", "worlds of the same number"),
            ("simulator_seed", "simulator seeds"),
        ):
            values = getattr(one, name), getattr(other, name)
            if values[0] != values[1]:
                raise BarnError(f"{one.trial_id} and {other.trial_id} have different {what}: {values[0]}, {values[1]}")
