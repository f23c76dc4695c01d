"""The messages of a trial's bag: those of its nodes, and beyond them the true scene and the score."""

from collections.abc import Iterable, Iterator

import numpy as np

from barn_eval.results.bags.recorder import Recorder
from barn_eval.trials.outcome import Outcome, Verdict, challenge_metric
from barn_eval.trials.protocol import Course
from barn_eval.trials.referee import Standing
from barn_eval.trials.spec import TrialSpec
from barn_planners.interface import Decision, Planner
from barn_planners.runtime.messages import PlannerMessages
from barn_sim.messages import SimulatorMessages
from barn_sim.sensors.readings import Sensors
from barn_worlds.base.arrays import Floats
from barn_worlds.base.types import Velocity2D, nanoseconds, seconds
from barn_worlds.messages import encode, topics
from barn_worlds.messages.cdr import make_message, serialize
from barn_worlds.messages.encode import (
    TEXT_VIEW_FACING,
    PoseStampedEncoder,
    encode_map,
    make_marker,
)
from barn_worlds.messages.scenes import encode_moving, encode_moving_poses, encode_scene
from barn_worlds.messages.topics import (
    FRAMES,
    LATCHED,
    RELIABLE,
    Frames,
    OutgoingMessage,
    Topic,
)
from barn_worlds.worlds.scene import TrialScene, scene_of

TRUE_TOPICS = (
    topics.WORLD,
    topics.MOVING,
    topics.MOVING_POSES,
)  # which nobody publishes
PUSHED_M = 0.01  # by which an obstacle has been pushed and does not only tremble


def trial_scene(spec: TrialSpec) -> TrialScene:
    """Return the scene in which a trial begins."""
    return scene_of(
        spec.world,
        spec.course.start,
        spec.course.goal,
        spec.scaled_protocol.goal_distance_m,
    )


def initial_scene(spec: TrialSpec, stamp_ns: int) -> OutgoingMessage:
    """Return the scene in which a trial begins, as a message."""
    return OutgoingMessage(topics.WORLD, encode_scene(trial_scene(spec), stamp_ns))


def last_scene(
    spec: TrialSpec, cylinders_m: Floats, stamp_ns: int
) -> OutgoingMessage | None:
    """Return the scene with cylinders at centres (k, 2), in the order of `World.cylinders_m`; None if none moved."""
    if not (np.hypot(*(cylinders_m - spec.world.cylinders_m).T) > PUSHED_M).any():
        return None
    return OutgoingMessage(
        topics.WORLD,
        encode_scene(trial_scene(spec).with_cylinders_at(cylinders_m), stamp_ns),
    )


def moving_obstacle_scene(
    spec: TrialSpec, since_start_ns: int, stamp_ns: int
) -> list[OutgoingMessage]:
    """Return moving obstacles and walls so long after the start of a trial; nothing without any, or if none is due."""
    some = spec.world.moving or spec.world.walls
    if not some or since_start_ns % nanoseconds(topics.MOVING.period_s):
        return []
    time_s = spec.phase_s + seconds(since_start_ns)
    return [
        OutgoingMessage(topics.MOVING, encode_moving(spec.world, time_s, stamp_ns)),
        OutgoingMessage(
            topics.MOVING_POSES, encode_moving_poses(spec.world, time_s, stamp_ns)
        ),
    ]


# What is published: a number to plot, a word to show, and a text within the scene.
TOPICS = (topics.SCORE, topics.OUTCOME, topics.SCORE_TEXT)
RUNNING = "running"
_PERIOD_NS = nanoseconds(topics.SCORE.period_s)
_BELOW_START_M = 1.5
_TEXT_M = 0.3
_TEXT_COLOUR = (0.0, 0.0, 0.0, 1.0)


class ScoreReporter:
    """Says twice a second, and once more at the verdict, how a trial stands."""

    def __init__(self, spec: TrialSpec) -> None:
        self._course = spec.course
        self._title = f"{spec.planner}, {spec.world.name}"
        self._due_ns: int | None = None
        self._concluded = False

    def take(self, standing: Standing, stamp_ns: int) -> Iterator[OutgoingMessage]:
        """Yield what is due at the end of an instant."""
        due = (
            self._due_ns is None
            or stamp_ns >= self._due_ns
            or standing.outcome is not None
        )
        if self._concluded or not due:
            return
        self._due_ns, self._concluded = (
            stamp_ns + _PERIOD_NS,
            standing.outcome is not None,
        )
        value, start = running_score(standing, self._course), self._course.start
        yield OutgoingMessage(topics.SCORE, encode.encode_number(value))
        yield OutgoingMessage(
            topics.OUTCOME,
            encode.encode_text(standing.outcome.value if standing.outcome else RUNNING),
        )
        text = make_marker(
            FRAMES.of(topics.SCORE_TEXT),
            "score",
            TEXT_VIEW_FACING,
            color=_TEXT_COLOUR,
            stamp_ns=stamp_ns,
        )
        text.pose.position.x, text.pose.position.y = start.x, start.y - _BELOW_START_M
        text.scale.z, text.text = (
            _TEXT_M,
            "\n".join(_lines(self._title, standing, value)),
        )
        yield OutgoingMessage(
            topics.SCORE_TEXT,
            serialize(make_message(topics.SCORE_TEXT.type_name, markers=[text])),
        )


def running_score(standing: Standing, course: Course) -> float:
    """Return the challenge metric: that of the verdict or, before it, what it would be if the goal were reached now."""
    outcome = standing.outcome or Outcome.SUCCESS
    on_clock_s = standing.clock_s if standing.outcome else standing.clock_s or 0.0
    return challenge_metric(
        Verdict(outcome, "", on_clock_s, 0.0, 0.0), course.optimal_time_s
    )


def _lines(title: str, standing: Standing, value: float) -> list[str]:
    clock = (
        "clock not started"
        if standing.clock_s is None
        else f"{standing.clock_s:.2f} s on the clock"
    )
    left = (
        ""
        if standing.goal_distance_m is None
        else f"{standing.goal_distance_m:.2f} m to the goal"
    )
    contact = f"{standing.contact_s:.2f} s in contact"
    outcome = (
        f"{standing.outcome.value}: {value:.3f}"
        if standing.outcome
        else f"worth {value:.3f} if there now"
    )
    return [title, clock, left, contact, outcome]


# Announced at the start, so that every bag lists them; what a planner shows is announced when it does.
_ALWAYS = (
    *(
        topics.CLOCK,
        topics.ODOM,
        topics.GROUND_TRUTH,
        topics.AMCL_POSE,
        topics.TF,
        topics.COLLISION,
    ),
    *(
        topics.JOINT_STATES,
        topics.GOAL_POSE,
        topics.CMD_VEL,
        topics.SCAN,
        *TOPICS,
        topics.TF_STATIC,
        topics.WORLD,
    ),
)


class TrialBag:
    """Record a trial instant by instant; every message carries the time of its instant."""

    def __init__(self, recorder: Recorder, spec: TrialSpec) -> None:
        self._recorder, self._spec, self._score = recorder, spec, ScoreReporter(spec)
        self._frames = frames = Frames(planning=spec.planning_frame)
        self._simulator, self._planner = (
            SimulatorMessages(spec.simulator, frames),
            PlannerMessages(frames),
        )
        self._goal = PoseStampedEncoder(frames.of(topics.GOAL_POSE))
        self._goal_period_ns = nanoseconds(spec.protocol.goal_period_s)
        self._next_goal_ns: int | None = 0
        for topic in (
            topics.ROBOT_DESCRIPTION,
            *(() if spec.map is None else (topics.MAP,)),
            *_ALWAYS,
        ):
            self._announce(topic)

    def begin(self, first: Sensors) -> None:
        """Record what is published once, at the start."""
        spec, stamp_ns = self._spec, first.stamp_ns
        self._record(self._simulator.constant(), stamp_ns)
        if spec.map is not None:
            self._record(
                [
                    OutgoingMessage(
                        topics.MAP,
                        encode_map(spec.map, stamp_ns, self._frames.of(topics.MAP)),
                    )
                ],
                stamp_ns,
            )
        self._record([initial_scene(spec, stamp_ns)], stamp_ns)

    def reading(self, sensors: Sensors, *, asked: bool = True) -> None:
        """Record the readings of an instant, the scan where the planner is asked, and the goal where it is sent."""
        stamp_ns = sensors.stamp_ns
        readings = self._simulator.sensors(sensors, stamp_ns)
        self._record(
            (one for one in readings if asked or one.topic is not topics.SCAN), stamp_ns
        )
        self._record(moving_obstacle_scene(self._spec, stamp_ns, stamp_ns), stamp_ns)
        if self._next_goal_ns is not None and stamp_ns >= self._next_goal_ns:
            self._record(
                [
                    OutgoingMessage(
                        topics.GOAL_POSE, self._goal.encode(self._spec.goal, stamp_ns)
                    )
                ],
                stamp_ns,
            )
            self._next_goal_ns = (
                stamp_ns + self._goal_period_ns if self._goal_period_ns else None
            )

    def answer(
        self,
        command: Velocity2D | None,
        decision: Decision,
        planner: Planner,
        stamp_ns: int,
    ) -> None:
        """Record the planner's answer to the readings of an instant and what it shows."""
        if command is not None:
            self._record([self._planner.command(command, stamp_ns)], stamp_ns)
        self._record(self._planner.display(planner, decision, stamp_ns), stamp_ns)

    def standing(self, standing: Standing, stamp_ns: int) -> None:
        """Record how the trial stands at the end of an instant, when that is due."""
        self._record(self._score.take(standing, stamp_ns), stamp_ns)

    def conclude(self, cylinders_m: Floats, stamp_ns: int) -> None:
        """Record where obstacles stand at the end, centres (k, 2) m, if any has been pushed."""
        scene = last_scene(self._spec, cylinders_m, stamp_ns)
        self._record([scene] if scene else [], stamp_ns)

    def _record(self, messages: Iterable[OutgoingMessage], stamp_ns: int) -> None:
        for topic, data in messages:
            self._announce(topic)
            self._recorder.write(topic.path, data, stamp_ns)

    def _announce(self, topic: Topic) -> None:
        """Announce a topic as a player should offer it, which is with a queue for many messages."""
        qos = LATCHED if topic.qos.durability == LATCHED.durability else RELIABLE
        self._recorder.add_topic(topic.path, topic.type_name, qos)
