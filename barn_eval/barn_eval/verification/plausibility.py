"""Check whether a row is plausible: its ranges, and what follows from its track."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from enum import Enum
from typing import Any

import numpy as np

from barn_eval.results.tracks import CHANNELS, PERIOD_S, Track
from barn_eval.trials.identity import first_difference, flatten
from barn_eval.trials.result import (
    ENVIRONMENT,
    PLANNER,
    SCHEMA_VERSION,
    SIMULATOR,
    Outcome,
    TrialResult,
    Verdict,
)
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trajectory import NEAR_CONTACT_M, Trajectory, TrajectoryLog
from barn_eval.trials.trial import finish_trial
from barn_worlds.base.config import as_dict
from barn_worlds.base.types import wrap_angle

# Difference that another processor may cause: in m, rad, s, and relative.
ROUNDING = 1e-6

# Outcomes that follow from the readings alone.
JUDGED_OUTCOMES = (
    Outcome.SUCCESS,
    Outcome.COLLISION,
    Outcome.LEFT_WORLD,
    Outcome.TIMEOUT,
    Outcome.NO_FIRST_MOTION,
)

# Numbers of a row that may be below zero.
_SIGNED = (
    "min_clearance_m",
    "mean_clearance_m",
    "moving_clearance_m",
    "hit_robot_mps",
    "hit_closing_mps",
    "hit_robot_share",
    "time_to_collision_s",
)


def recompute_row(
    row: TrialResult, spec: TrialSpec, verdict: Verdict, trajectory: Trajectory
) -> TrialResult:
    """Return a trial's row recomputed from its verdict and trajectory.

    Fields that only the planner knows are copied from `row`.

    Args:
        row: The row as written. It gives the schema and what only the planner knows.
        spec: The trial.
        verdict: How it ended.
        trajectory: What the robot did.
    """
    # Both are empty in mode direct.
    messages = {}
    if row.mode == "ros":
        messages = {"planner_verdict": row.planner_verdict, "remarks": row.remarks}
    finished = finish_trial(
        spec,
        row.mode,
        verdict,
        trajectory,
        recoveries=row.recoveries,
        delays=row.delays,
        observed=row.observed,
        schema_version=row.schema_version,
        **messages,
    )
    # Another version may have another fingerprint for the same task; run.json decides.
    # Only old rows may have none.
    if not row.task and row.schema_version == SCHEMA_VERSION:
        return finished.result
    return replace(finished.result, task=row.task)


def find_difference(
    row: TrialResult,
    content: Mapping[str, Any],
    place: str,
    tolerance: float = 0.0,
    ignored: tuple[str, ...] = (),
) -> Iterator[str]:
    """Yield a text on the first key in which a row differs from `content`, if any.

    Args:
        row: The row as written.
        content: The expected row, in the form of `TrialResult.repeatable`.
        place: Where `content` is from; the text ends with it.
        tolerance: Largest difference at which numbers count as equal.
        ignored: Beginnings of dotted keys that may differ.
    """
    difference = first_difference(row.repeatable(), content, tolerance, ignored)
    if difference is not None:
        key, *values = difference
        shown = [item.value if isinstance(item, Enum) else item for item in values]
        yield f"{key} is {shown[0]!r} in the row, {shown[1]!r} {place}"


def find_rescoring_difference(row: TrialResult, spec: TrialSpec) -> Iterator[str]:
    """Yield a text on the first value, measures aside, that differs if scored again.

    Measures and motion, which follow from the trajectory, are not compared.

    Args:
        row: The row.
        spec: The trial with its name.
    """
    scores = row.scores
    measures = row.measures
    culprit = "" if row.outcome in JUDGED_OUTCOMES else row.fault
    verdict = Verdict(
        row.outcome,
        row.detail,
        scores.traversal_time_s,
        scores.duration_s,
        measures.contact_s or 0.0,
        culprit,
    )
    no_trajectory = TrajectoryLog().trajectory()
    recomputed = recompute_row(row, spec, verdict, no_trajectory).repeatable()
    ignored = ("measures.", "motion")
    yield from find_difference(row, recomputed, "computed again", ROUNDING, ignored)


def find_implausible_values(row: TrialResult, spec: TrialSpec) -> Iterator[str]:
    """Yield a problem for each impossible number and for an unknown fault in a row.

    Args:
        row: The row.
        spec: The trial with its name.
    """
    if row.fault not in ("", PLANNER, SIMULATOR, ENVIRONMENT):
        yield (
            f"fault is {row.fault!r}, must be {PLANNER}, {SIMULATOR}, {ENVIRONMENT} or"
            " empty"
        )
    for key, value in flatten(as_dict(row)):
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            continue
        is_signed = key.rpartition(".")[2] in _SIGNED
        if not math.isfinite(value) or (value < 0 and not is_signed):
            yield f"{key} is {value:g}, must be 0 or more"
    yield from _find_excess(row, spec)


def _find_excess(row: TrialResult, spec: TrialSpec) -> Iterator[str]:
    """Yield a problem for each number of a row that exceeds what other values allow."""
    protocol = spec.scaled_protocol
    values = dict(flatten(as_dict(row)))
    duration_s = row.scores.duration_s

    longest_s = protocol.first_motion_limit_s + protocol.limit_s
    # The clock starts and stops when the referee looks, each up to a period late.
    longest_s = longest_s + 2.0 * protocol.look_period_s + 1.0

    # A moving obstacle may push the robot at any speed.
    # Slip adds at most 2% (`spec.WHEEL_SLIP`), so this margin is wide.
    longest_m = 1.2 * spec.simulator.drive.max_speed_m_s * duration_s + 1.0
    if spec.world.moving:
        longest_m = math.inf

    # Observed trials have readings at rates of their own.
    readings = math.inf
    if row.observed is None:
        readings = duration_s / spec.simulator.control_period_s + 1.0
    limits = {
        "recoveries": readings / 2.0,
        "measures.unanswered_cycles": readings,
        "scores.duration_s": longest_s,
        "scores.traversal_time_s": duration_s,
        "measures.contact_s": duration_s,
        "measures.near_contact_s": duration_s,
        "measures.driven_m": longest_m,
        "measures.rms_speed_step_mps": values.get("measures.speed_variation_mps"),
        "measures.rms_turn_step_radps": values.get("measures.turn_variation_radps"),
    }
    for key, limit in limits.items():
        value = values.get(key) or 0.0
        largest = limit or 0.0
        if value > largest + ROUNDING:
            yield f"{key} is {value:g}, must be at most {largest:g}"

    speed_mps = row.measures.mean_speed_mps or 0.0
    driven_m = row.measures.driven_m
    if abs(speed_mps * duration_s - driven_m) > ROUNDING:
        yield (
            f"measures.mean_speed_mps is {speed_mps:g}, but the robot drove"
            f" {driven_m:g} m in {duration_s:g} s"
        )


def compare_with_track(
    row: TrialResult, spec: TrialSpec, track: Track | None
) -> Iterator[str]:
    """Yield a problem per value that contradicts the track, or for a missing track.

    Compared, within the track's rounding, are clearance, contacts, driven length,
    duration, sums and the end. Five samples a second do not show everything.

    Args:
        row: The row.
        spec: The trial with its name.
        track: The track, or None if there is none.
    """
    measures = row.measures
    if track is None:
        if measures.driven_m > 0.0 or row.outcome in JUDGED_OUTCOMES:
            yield f"has no track, though the robot drove {measures.driven_m:.2f} m"
        return

    step = dict(zip(CHANNELS, track.steps.tolist(), strict=True))
    poses = track.samples[:, 1:4]
    clearance = track.samples[:, CHANNELS.index("clearance")]
    nearest_m = np.nanmin(clearance, initial=np.inf)
    stated_m = measures.min_clearance_m
    if stated_m is not None and np.isfinite(nearest_m):
        error_m = abs(nearest_m - stated_m)
        # The smallest clearance of a track is that of all readings, rounded.
        if error_m > step["clearance"]:
            yield (
                f"smallest clearance is {nearest_m:.3f} m in the track, {stated_m:.3f} m"
                " in the row"
            )
    if bool(track.contact.any()) != bool(measures.contacts):
        yield f"has {measures.contacts} contacts in the row; the track disagrees"

    dx, dy, _ = np.diff(poses, axis=0).T
    # The way between two samples cannot be shorter than a straight line.
    chords_m = np.hypot(dx, dy).sum()
    if chords_m > measures.driven_m + 2.0 * step["x"] * len(poses):
        yield (
            f"drove {chords_m:.2f} m in the track, {measures.driven_m:.2f} m in the row"
        )
    end_s = track.samples[-1, 0]
    duration_s = row.scores.duration_s
    if abs(end_s - duration_s) > step["time"]:
        yield f"lasted {end_s:.2f} s in the track, {duration_s:.2f} s in the row"

    yield from _compare_sums(row, track, step)

    # Clearances measured by scans do not follow from poses.
    gaps = np.empty(0)
    if row.observed is None or row.observed.clearance_by == "world":
        gaps = spec.clearances(poses)
    # Steps of x, y and yaw move an outline whose points lie up to a meter from
    # base_link.
    rounding_m = 3.0 * step["x"] + step["yaw"] + step["clearance"]
    # A sample has the least clearance since the previous one, so it cannot exceed that
    # at its own pose.
    if len(gaps) and (clearance - gaps).max() > rounding_m:
        yield "has larger clearances in the track than its poses have in the world"
    yield from _compare_ends(row, spec, track)


def _compare_sums(
    row: TrialResult, track: Track, step: Mapping[str, float]
) -> Iterator[str]:
    """Yield a problem for each sum or mean in a row that its track does not allow.

    A sample has the smallest clearance, and any contact, since the previous one. `step`
    is the rounding of each channel.
    """
    measures = row.measures
    channel = dict(zip(CHANNELS, track.samples.T, strict=True))
    periods_s = np.diff(channel["time"], prepend=channel["time"][0])
    slack_s = step["time"] * len(periods_s)
    clearance = channel["clearance"]
    near = clearance < NEAR_CONTACT_M + step["clearance"]
    # A contact in a period lasts at most the whole period.
    for key, value, mask in (
        ("contact_s", measures.contact_s, track.contact),
        ("near_contact_s", measures.near_contact_s, near),
    ):
        longest_s = periods_s[mask].sum() + slack_s
        if value is not None and value > longest_s:
            yield f"{key} is {value:.2f} in the row, at most {longest_s:.2f} by its track"

    turns = wrap_angle(np.diff(channel["yaw"]))
    least = {"rotation_rad": np.abs(turns).sum() - step["yaw"] * len(turns)}
    if periods_s.any():
        # The first reading counts like any other, though no time precedes it.
        first_m = np.abs(clearance).max() * PERIOD_S / periods_s.sum()
        mean_m = np.average(clearance, weights=periods_s)
        least["mean_clearance_m"] = mean_m - first_m - step["clearance"]
    for key, name in (
        ("speed_variation_mps", "command_speed"),
        ("turn_variation_radps", "command_turn"),
    ):
        # Between two samples, commands may vary more than these differences, not less.
        changes = np.abs(np.diff(channel[name]))
        least[key] = np.nansum(changes) - step[name] * len(changes)
    for key, smallest in least.items():
        value = getattr(measures, key)
        if value is not None and value < smallest - ROUNDING:
            yield f"{key} is {value:.3f} in the row, at least {smallest:.3f} by its track"


def _compare_ends(row: TrialResult, spec: TrialSpec, track: Track) -> Iterator[str]:
    """Yield a problem for each of outcome, arrival and time that the track refutes."""
    protocol = spec.scaled_protocol
    outcome = row.outcome
    times_s = track.samples[:, 0]
    positions = track.samples[:, 1:3]

    contacts = int(track.contact.sum())
    is_collision = outcome is Outcome.COLLISION
    ended_freely = outcome in JUDGED_OUTCOMES and not is_collision
    # If collisions end trials, a trial with another end has no contact.
    is_contact_free = ended_freely and protocol.collision_ends_trial
    if (is_contact_free and contacts) or (is_collision and not contacts):
        yield (
            f"outcome is {outcome.value} in the row, but the track has {contacts}"
            " samples with a contact"
        )

    # The odometry that judges arrival may have drifted away from the true position.
    goal = spec.course.goal
    left_m = math.hypot(*(positions[-1] - goal.position))
    drift_m = 0.02
    if protocol.goal_source != "truth":
        drift_m = 1.0 + 0.1 * row.measures.driven_m
    if outcome is Outcome.SUCCESS and left_m > protocol.goal_distance_m + drift_m:
        yield (
            f"outcome is success in the row, but the track ends {left_m:.2f} m from"
            " the goal"
        )

    time_s = row.scores.traversal_time_s
    if time_s is None:
        return
    dx, dy = (positions - positions[0]).T
    # The odometry may start the clock 5 cm before or after the true motion does.
    excess_m = np.hypot(dx, dy) - protocol.clock_start_distance_m
    if protocol.clock_start_distance_m == 0.0:
        excess_m = np.full(len(times_s), np.inf)
    earliest_s = float(times_s[excess_m > -0.05].min(initial=math.inf))
    latest_s = float(times_s[excess_m > 0.05].min(initial=math.inf))
    period_s = float(np.diff(times_s).max(initial=0.0))
    slack_s = period_s + protocol.look_period_s + track.steps[0]
    if not earliest_s - slack_s <= times_s[-1] - time_s <= latest_s + slack_s:
        yield (
            f"traversal_time_s is {time_s:.2f} in the row, but in the track motion"
            f" begins after {earliest_s:.2f} s"
        )
