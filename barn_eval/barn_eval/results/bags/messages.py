"""Messages of a trial's bag: those of its nodes, the true scene and the score."""

from collections.abc import Iterator

import numpy as np

from barn_eval.results.bags.recorder import Recorder
from barn_eval.trials.protocol import Course
from barn_eval.trials.referee import Referee, Standing
from barn_eval.trials.result import Outcome, Verdict, challenge_metric
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
from barn_worlds.messages.topics import FRAMES, Frames, OutgoingMessage
from barn_worlds.worlds.scene import TrialScene, scene_of

# Topics that no node publishes.
TRUE_TOPICS = (topics.WORLD, topics.MOVING, topics.MOVING_POSES)

# Motion from which an obstacle counts as pushed.
PUSHED_M = 0.01


def trial_scene(spec: TrialSpec) -> TrialScene:
    """Return a trial's initial scene: obstacles, walls, start, goal and goal radius."""
    course = spec.course
    distance_m = spec.scaled_protocol.goal_distance_m
    return scene_of(spec.world, course.start, course.goal, distance_m)


def initial_scene(spec: TrialSpec, stamp_ns: int) -> OutgoingMessage:
    """Return a message of /world: static obstacles, path, start and goal.

    Args:
        spec: The trial.
        stamp_ns: Time of the message.
    """
    return OutgoingMessage(topics.WORLD, encode_scene(trial_scene(spec), stamp_ns))


def moving_obstacle_scene(
    spec: TrialSpec, since_start_ns: int, stamp_ns: int
) -> list[OutgoingMessage]:
    """Return messages with moving obstacles' shapes and their poses, [] if not due.

    They are due every 0.1 s in worlds with moving obstacles or walls.

    Args:
        spec: The trial.
        since_start_ns: Time since the trial's first reading.
        stamp_ns: Time of the messages.
    """
    world = spec.world
    if not (world.moving or world.walls):
        return []
    if since_start_ns % nanoseconds(topics.MOVING.period_s):
        return []
    time_s = spec.phase_s + seconds(since_start_ns)
    shapes = encode_moving(world, time_s, stamp_ns)
    poses = encode_moving_poses(world, time_s, stamp_ns)
    return [
        OutgoingMessage(topics.MOVING, shapes),
        OutgoingMessage(topics.MOVING_POSES, poses),
    ]


# Topics of the score: a number to plot, a word to show, and a text within the scene.
TOPICS = (topics.SCORE, topics.OUTCOME, topics.SCORE_TEXT)
RUNNING = "running"
_PERIOD_NS = nanoseconds(topics.SCORE.period_s)
_BELOW_START_M = 1.5
_LETTER_M = 0.3
_BLACK = (0.0, 0.0, 0.0, 1.0)


class ScoreReporter:
    """Reports a trial's score twice a second and once more at the verdict."""

    def __init__(self, spec: TrialSpec):
        """Prepare the messages of a trial; the first ones are due at once."""
        self._course = spec.course
        self._title = f"{spec.planner}, {spec.world.name}"
        self._due_ns = 0
        self._concluded = False
        frame = FRAMES.of(topics.SCORE_TEXT)
        self._text = make_marker(frame, "score", TEXT_VIEW_FACING, color=_BLACK)
        self._text.pose.position.x = spec.course.start.x
        self._text.pose.position.y = spec.course.start.y - _BELOW_START_M
        self._text.scale.z = _LETTER_M

    def take(self, referee: Referee, stamp_ns: int) -> Iterator[OutgoingMessage]:
        """Yield score, outcome and text if due: every 0.5 s, and once at the verdict.

        After the verdict, nothing is due.

        Args:
            referee: Judges the trial.
            stamp_ns: Time of the instant.
        """
        is_over = referee.verdict is not None
        is_due = stamp_ns >= self._due_ns
        if self._concluded or not (is_due or is_over):
            return
        self._due_ns = stamp_ns + _PERIOD_NS
        self._concluded = is_over

        standing = referee.standing
        score = running_score(standing, self._course)
        word = standing.outcome.value if standing.outcome else RUNNING
        yield OutgoingMessage(topics.SCORE, encode.encode_number(score))
        yield OutgoingMessage(topics.OUTCOME, encode.encode_text(word))

        text = self._text
        encode.set_stamp(text.header, stamp_ns)
        text.text = self._describe(standing, score)
        message = make_message(topics.SCORE_TEXT.type_name, markers=[text])
        yield OutgoingMessage(topics.SCORE_TEXT, serialize(message))

    def _describe(self, standing: Standing, score: float) -> str:
        """Return the text below the start: planner, world, clock, distance, score."""
        clock = "clock not started"
        if standing.clock_s is not None:
            clock = f"{standing.clock_s:.2f} s on the clock"
        distance = ""
        if standing.goal_distance_m is not None:
            distance = f"{standing.goal_distance_m:.2f} m to the goal"
        contact = f"{standing.contact_s:.2f} s in contact"
        worth = f"worth {score:.3f} if there now"
        if standing.outcome:
            worth = f"{standing.outcome.value}: {score:.3f}"
        return "\n".join((self._title, clock, distance, contact, worth))


def running_score(standing: Standing, course: Course) -> float:
    """Return the challenge metric of the outcome, or of an arrival now; 0 if unknown.

    Args:
        standing: State of the trial.
        course: Start, goal and lengths of its world.
    """
    outcome = standing.outcome or Outcome.SUCCESS
    clock_s = standing.clock_s
    if standing.outcome is None:
        # A robot at the goal before its clock starts has taken no time.
        clock_s = clock_s or 0.0
    verdict = Verdict(outcome, "", clock_s, 0.0, 0.0)
    return challenge_metric(verdict, course.optimal_time_s) or 0.0


# Announced at the start, so that every bag lists them. Topics that a planner displays
# are announced with their first message.
_ALWAYS = (
    topics.GOAL_POSE,
    topics.CMD_VEL,
    topics.SCAN,
    *TOPICS,
    topics.TF_STATIC,
    topics.WORLD,
)


class TrialBag:
    """Records a trial instant by instant; messages have the time of their instant."""

    def __init__(self, recorder: Recorder, spec: TrialSpec):
        """Announce a trial's topics to its recorder.

        Args:
            recorder: Recorder of the bag, which stays open.
            spec: The trial.
        """
        self._recorder = recorder
        self._spec = spec
        self._score = ScoreReporter(spec)
        # A planner with a map gets its goal and its pose in the map frame.
        planning = FRAMES.map if spec.protocol.map_given else FRAMES.odom
        self._frames = Frames(planning=planning)
        self._simulator = SimulatorMessages(spec.simulator, self._frames)
        self._planner = PlannerMessages(self._frames)
        self._goal = PoseStampedEncoder(self._frames.of(topics.GOAL_POSE))
        self._goal_period_ns = nanoseconds(spec.protocol.goal_period_s)
        self._next_goal_ns: int | None = 0

        recorder.announce(topics.ROBOT_DESCRIPTION)
        if spec.map is not None:
            recorder.announce(topics.MAP)
        self._instant = recorder.prepare_block(self._simulator.layouts())
        for topic in _ALWAYS:
            recorder.announce(topic)

    def begin(self, first: Sensors) -> None:
        """Record URDF, static transforms, any map, and scene; call this first, once."""
        spec = self._spec
        stamp_ns = first.stamp_ns
        self._recorder.record(self._simulator.constant(), stamp_ns)
        if spec.map is not None:
            data = encode_map(spec.map, stamp_ns, self._frames.of(topics.MAP))
            self._recorder.record([OutgoingMessage(topics.MAP, data)], stamp_ns)
        self._recorder.record([initial_scene(spec, stamp_ns)], stamp_ns)

    def reading(self, sensors: Sensors, *, asked: bool = True) -> None:
        """Record sensors, a new scan if `asked`, and moving obstacles and goal if due.

        Args:
            sensors: The readings.
            asked: Whether the planner gets them; if not, the scan is left out.
        """
        stamp_ns = sensors.stamp_ns
        rows = self._simulator.rows(sensors, stamp_ns)
        self._recorder.write_block(self._instant, rows, stamp_ns)
        # Checks rely on this: the planner answers each scan in a bag.
        if asked and sensors.scan.stamp_ns == stamp_ns:
            self._recorder.record(
                [self._simulator.scan(sensors.scan, stamp_ns)], stamp_ns
            )
        self._recorder.record(
            moving_obstacle_scene(self._spec, stamp_ns, stamp_ns), stamp_ns
        )

        if self._next_goal_ns is not None and stamp_ns >= self._next_goal_ns:
            data = self._goal.encode(self._spec.goal, stamp_ns)
            self._recorder.record([OutgoingMessage(topics.GOAL_POSE, data)], stamp_ns)
            self._next_goal_ns = None
            if self._goal_period_ns:
                self._next_goal_ns = stamp_ns + self._goal_period_ns

    def answer(
        self,
        command: Velocity2D | None,
        decision: Decision,
        planner: Planner,
        stamp_ns: int,
    ) -> None:
        """Record the command, if any, and what the planner displays with it.

        Args:
            command: The command, if the planner gives one.
            decision: Decision of the planner.
            planner: The planner, which displays more than its command.
            stamp_ns: Time of the instant.
        """
        if command is not None:
            self._recorder.record([self._planner.command(command, stamp_ns)], stamp_ns)
        self._recorder.record(
            self._planner.display(planner, decision, stamp_ns), stamp_ns
        )

    def standing(self, referee: Referee, stamp_ns: int) -> None:
        """Record score, outcome and their text if due: every 0.5 s and at the verdict.

        Args:
            referee: Judges the trial, and has judged the instant.
            stamp_ns: Time of the instant.
        """
        self._recorder.record(self._score.take(referee, stamp_ns), stamp_ns)

    def conclude(self, cylinders_m: Floats, stamp_ns: int) -> None:
        """Record the scene again if a cylinder was pushed; the bag stays open.

        Args:
            cylinders_m: Centers (k, 2) in m, in the order of `World.cylinders_m`.
            stamp_ns: Time of the last instant.
        """
        dx, dy = (cylinders_m - self._spec.world.cylinders_m).T
        if (np.hypot(dx, dy) > PUSHED_M).any():
            scene = trial_scene(self._spec).with_cylinders_at(cylinders_m)
            data = encode_scene(scene, stamp_ns)
            self._recorder.record([OutgoingMessage(topics.WORLD, data)], stamp_ns)
