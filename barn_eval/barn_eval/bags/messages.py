"""What a trial's bag and those who watch it are told beyond the messages of its nodes: true scene and score."""

from collections.abc import Iterator

import numpy as np

from barn_eval.trials.outcome import Outcome, Verdict, challenge_metric
from barn_eval.trials.protocol import Course
from barn_eval.trials.referee import Standing
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trajectory import Floats
from barn_worlds.base.types import nanoseconds, seconds
from barn_worlds.messages.cdr import make, serialise
from barn_worlds.messages.encode import TEXT_VIEW_FACING, encode_number, encode_text, marker
from barn_worlds.messages.scenes import encode_moving, encode_moving_poses, encode_scene
from barn_worlds.messages.topics import FRAMES, MOVING, MOVING_POSES, OUTCOME, SCORE, SCORE_TEXT, WORLD, Outgoing
from barn_worlds.worlds.scene import TrialScene, scene_of

TRUE_TOPICS = (WORLD, MOVING, MOVING_POSES)  # which nobody publishes
MOVED_M = 0.01  # by which an obstacle has been pushed and does not only tremble


def trial_scene(spec: TrialSpec) -> TrialScene:
    """Return the scene in which a trial begins."""
    return scene_of(spec.world, spec.course.start, spec.course.goal, spec.rules.goal_distance_m)


def first_scene(spec: TrialSpec, stamp_ns: int) -> Outgoing:
    """Return the scene in which a trial begins, as a message."""
    return Outgoing(WORLD, encode_scene(trial_scene(spec), stamp_ns))


def last_scene(spec: TrialSpec, cylinders_m: Floats, stamp_ns: int) -> Outgoing | None:
    """Return the scene with cylinders at centres (k, 2), in the order of `World.cylinders_m`; None if none moved."""
    if not (np.hypot(*(cylinders_m - spec.world.cylinders_m).T) > MOVED_M).any():
        return None
    return Outgoing(WORLD, encode_scene(trial_scene(spec).moved(cylinders_m), stamp_ns))


def moving_scene(spec: TrialSpec, since_start_ns: int, stamp_ns: int) -> list[Outgoing]:
    """Return moving obstacles and walls so long after the start of a trial; nothing without any, or if none is due."""
    some = spec.world.moving or spec.world.walls
    if not some or since_start_ns % nanoseconds(MOVING.period_s):
        return []
    time_s = spec.phase_s + seconds(since_start_ns)
    return [
        Outgoing(MOVING, encode_moving(spec.world, time_s, stamp_ns)),
        Outgoing(MOVING_POSES, encode_moving_poses(spec.world, time_s, stamp_ns)),
    ]


# What is published: a number to plot, a word to show, and a text within the scene.
TOPICS = (SCORE, OUTCOME, SCORE_TEXT)
RUNNING = "running"
_PERIOD_NS = nanoseconds(SCORE.period_s)
_BELOW_START_M = 1.5
_TEXT_M = 0.3
_TEXT_COLOUR = (0.0, 0.0, 0.0, 1.0)


class LiveScore:
    """Says twice a second, and once more at the verdict, how a trial stands."""

    def __init__(self, spec: TrialSpec) -> None:
        self._course = spec.course
        self._title = f"{spec.planner}, {spec.world.name}"
        self._due_ns: int | None = None
        self._concluded = False

    def take(self, standing: Standing, stamp_ns: int) -> Iterator[Outgoing]:
        """Yield what is due at the end of an instant."""
        due = self._due_ns is None or stamp_ns >= self._due_ns or standing.outcome is not None
        if self._concluded or not due:
            return
        self._due_ns, self._concluded = stamp_ns + _PERIOD_NS, standing.outcome is not None
        value = score_so_far(standing, self._course)
        word = standing.outcome.value if standing.outcome else RUNNING
        yield Outgoing(SCORE, encode_number(value))
        yield Outgoing(OUTCOME, encode_text(word))
        yield Outgoing(SCORE_TEXT, self._text(_lines(self._title, standing, value), stamp_ns))

    def _text(self, lines: list[str], stamp_ns: int) -> bytes:
        text = marker(FRAMES.of(SCORE_TEXT), "score", TEXT_VIEW_FACING, colour=_TEXT_COLOUR, stamp_ns=stamp_ns)
        start = self._course.start
        text.pose.position.x, text.pose.position.y = start.x, start.y - _BELOW_START_M
        text.scale.z = _TEXT_M
        text.text = "\n".join(lines)
        return serialise(make(SCORE_TEXT.type_name, markers=[text]))


def score_so_far(standing: Standing, course: Course) -> float:
    """Return the challenge metric: that of the verdict or, before it, what it would be if the goal were reached now."""
    outcome = standing.outcome or Outcome.SUCCESS
    on_clock_s = standing.on_clock_s if standing.outcome else standing.on_clock_s or 0.0
    return challenge_metric(Verdict(outcome, "", on_clock_s, 0.0, 0.0), course.optimal_time_s)


def _lines(title: str, standing: Standing, value: float) -> list[str]:
    clock = "clock not started" if standing.on_clock_s is None else f"{standing.on_clock_s:.2f} s on the clock"
    left = "" if standing.left_m is None else f"{standing.left_m:.2f} m to the goal"
    contact = f"{standing.contact_s:.2f} s in contact"
    outcome = f"{standing.outcome.value}: {value:.3f}" if standing.outcome else f"worth {value:.3f} if there now"
    return [title, clock, left, contact, outcome]
