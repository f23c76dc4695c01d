"""Whether a row can be: scores that follow from its times, numbers within their ranges, and what its track tells."""

import math
from collections.abc import Iterator

import numpy as np

from barn_eval.results.tracks import CHANNELS, Track
from barn_eval.trials.identity import NOT_SET, flatten
from barn_eval.trials.outcome import ENVIRONMENT, PLANNER, SIMULATOR, Outcome, Verdict
from barn_eval.trials.result import TrialResult
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trajectory import Trajectory, TrajectoryLog, compute_clearances
from barn_eval.trials.trial import finish_trial
from barn_worlds.base.config import as_dict
from barn_worlds.robots.contact import contact_footprint

ROUNDING = 1e-6  # m, rad, s, and relative: what other processors may compute otherwise
JUDGED = (
    Outcome.SUCCESS,
    Outcome.COLLISION,
    Outcome.TIMEOUT,
    Outcome.NO_FIRST_MOTION,
)  # by readings alone
_SIGNED = {
    "min_clearance_m",
    "mean_clearance_m",
    "moving_clearance_m",
    "hit_robot_mps",
    "hit_closing_mps",
}
_SIGNED |= {"hit_robot_share", "time_to_collision_s"}


def computed(
    row: TrialResult, spec: TrialSpec, verdict: Verdict, trajectory: Trajectory
) -> TrialResult:
    """Return the row of a trial that ended so; what its planner said is as it was."""
    told = {
        name: getattr(row, name)
        for name in ("recoveries", "planner_verdict", "remarks", "delays")
    }
    return finish_trial(spec, row.mode, verdict, trajectory, **told).result


def difference(row: TrialResult, again: TrialResult, but: tuple[str, ...] = ()) -> str:
    """Return the first thing, but for keys that begin so, in which a row and the same computed again differ, or ""."""
    here, there = (dict(flatten(one.repeatable())) for one in (row, again))
    for key in {**there, **here}:
        stated, now = here.get(key, NOT_SET), there.get(key, NOT_SET)
        near = isinstance(now, float) and isinstance(stated, float)
        if now == stated or (
            near and math.isclose(now, stated, rel_tol=ROUNDING, abs_tol=ROUNDING)
        ):
            continue
        if not key.startswith(
            (*but, "measures.off_plan_m")
        ):  # which follows from what a planner says
            was, is_now = (getattr(one, "value", one) for one in (stated, now))
            return f"{key} is {was!r} in the row, {is_now!r} computed again"
    return ""


def unreasonable(row: TrialResult, spec: TrialSpec) -> Iterator[str]:
    """Yield what a row cannot say, whatever was driven: scores that do not follow, numbers out of their ranges."""
    time_s, lasted_s, measures = (
        row.scores.traversal_time_s,
        row.scores.duration_s,
        row.measures,
    )
    blamed = "" if row.outcome in JUDGED else row.fault
    verdict = Verdict(
        row.outcome, row.detail, time_s, lasted_s, measures.contact_s, blamed
    )
    nothing = TrajectoryLog().trajectory()
    if told := difference(
        row, computed(row, spec, verdict, nothing), ("measures.", "motion.", "motion")
    ):
        yield told
    if row.fault not in ("", PLANNER, SIMULATOR, ENVIRONMENT):
        yield f"fault is {row.fault!r}, can be {PLANNER}, {SIMULATOR}, {ENVIRONMENT} or empty"
    for key, value in flatten(as_dict(row)):
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if number and not (
            math.isfinite(value) and (value >= 0 or key.rpartition(".")[2] in _SIGNED)
        ):
            yield f"{key} is {value:g}, can be 0 or more"
    rules, fastest_mps = spec.scaled_protocol, spec.simulator.drive.max_speed_m_s
    limits = {
        "scores.duration_s": (
            lasted_s,
            rules.first_motion_limit_s
            + rules.limit_s
            + 2.0 * rules.look_period_s
            + 1.0,
        ),
        "scores.traversal_time_s": (time_s or 0.0, lasted_s),
        "measures.contact_s": (measures.contact_s, lasted_s),
        "measures.near_contact_s": (measures.near_contact_s or 0.0, lasted_s),
        "measures.driven_m": (
            measures.driven_m,
            math.inf if spec.world.moving else 1.2 * fastest_mps * lasted_s + 1.0,
        ),
        "measures.mean_speed_mps": (
            abs((measures.mean_speed_mps or 0.0) * lasted_s - measures.driven_m),
            0.0,
        ),
        "scores.least_time_s": (
            row.scores.least_time_s or 0.0,
            math.inf if not row.scores.success else time_s or 0.0,
        ),
    }
    for key, (value, most) in limits.items():
        if value > most + ROUNDING:
            yield f"{key} does not fit: {value:g} where {most:g} is the most"


def off_track(row: TrialResult, spec: TrialSpec, track: Track | None) -> Iterator[str]:
    """Yield what of a row is not what its track says, as far as its rounding and its 5 samples a second allow."""
    measures, lasted_s = row.measures, row.scores.duration_s
    if track is None:
        if measures.driven_m > 0.0 or row.outcome in JUDGED:
            yield f"has no track, though it drove {measures.driven_m:.2f} m"
        return
    step = dict(zip(CHANNELS, track.steps.tolist(), strict=True))
    times, poses, clearance = (
        track.samples[:, 0],
        track.samples[:, 1:4],
        track.samples[:, CHANNELS.index("clearance")],
    )
    nearest, stated = np.nanmin(clearance, initial=np.inf), measures.min_clearance_m
    if (
        stated is not None
        and np.isfinite(nearest)
        and abs(nearest - stated) > step["clearance"]
    ):
        yield f"came as near as {nearest:.3f} m by its track, {stated:.3f} m by its row"
    if bool(track.contact.any()) != bool(measures.contacts):
        yield f"has {measures.contacts} contacts by its row, by its track not so"
    straight_m = np.hypot(*np.diff(poses[:, :2], axis=0).T).sum()
    if straight_m > measures.driven_m + 2.0 * step["x"] * len(poses):
        yield f"drove {straight_m:.2f} m by its track, {measures.driven_m:.2f} m by its row"
    if abs(times[-1] - lasted_s) > step["time"]:
        yield f"lasted {times[-1]:.2f} s by its track, {lasted_s:.2f} s by its row"
    world = spec.world
    gaps = compute_clearances(
        poses,
        world.cylinders_m,
        world.cylinder_radius_m,
        contact_footprint(spec.simulator.chassis),
    )
    if (
        len(gaps)
        and (clearance - gaps).max() > 3.0 * step["x"] + step["yaw"] + step["clearance"]
    ):
        yield "was farther from obstacles by its track than its poses are in its world"
    yield from _off_course(row, spec, track)


def _off_course(row: TrialResult, spec: TrialSpec, track: Track) -> Iterator[str]:
    """Yield where a track does not end as its row does, or did not begin to move when that says."""
    rules, outcome, time_s = (
        spec.scaled_protocol,
        row.outcome,
        row.scores.traversal_time_s,
    )
    times, places, touched = (
        track.samples[:, 0],
        track.samples[:, 1:3],
        int(track.contact.sum()),
    )
    collided = outcome is Outcome.COLLISION
    free = outcome in JUDGED and rules.collision_ends_trial and not collided
    if (free and touched) or (collided and not touched):
        yield f"outcome is {outcome.value} in the row, its track has {touched} samples with a contact"
    left_m = math.hypot(*(places[-1] - (spec.course.goal.x, spec.course.goal.y)))
    drift_m = (
        0.02 if rules.goal_source == "truth" else 1.0 + 0.1 * row.measures.driven_m
    )
    if outcome is Outcome.SUCCESS and left_m > rules.goal_distance_m + drift_m:
        yield f"outcome is success in the row, its track ends {left_m:.2f} m from the goal"
    moved_m = np.hypot(*(places - places[0]).T) - rules.clock_start_distance_m
    near_s, far_s = (
        float(times[moved_m > off_m].min(initial=math.inf)) for off_m in (-0.05, 0.05)
    )
    slack_s = (
        float(np.diff(times).max(initial=0.0)) + rules.look_period_s + track.steps[0]
    )
    if (
        time_s is not None
        and not near_s - slack_s <= times[-1] - time_s <= far_s + slack_s
    ):
        yield f"traversal_time_s is {time_s:.2f} in the row, its track began to move after {near_s:.2f} s"
