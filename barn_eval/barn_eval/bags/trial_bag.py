"""The bag of a direct trial: the messages that the nodes of a ROS trial would publish, from the same readings."""

from collections.abc import Iterable

from barn_eval.bags.messages import LiveScore, first_scene, last_scene, moving_scene
from barn_eval.bags.recorder import Recorder
from barn_eval.trials.referee import Standing
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trajectory import Floats
from barn_planners.interface import Decision, Planner
from barn_planners.runtime.messages import PlannerMessages
from barn_sim.messages import SimulatorMessages
from barn_sim.sensors.readings import Sensors
from barn_worlds.base.types import Velocity2D, nanoseconds
from barn_worlds.messages import topics
from barn_worlds.messages.encode import PoseStampedEncoder, encode_map
from barn_worlds.messages.topics import LATCHED, RELIABLE, Frames, Outgoing, Topic

# Announced at the start, so that every bag lists them; what a planner shows is announced when it does.
_ALWAYS = (
    topics.CLOCK,
    topics.ODOM,
    topics.GROUND_TRUTH,
    topics.AMCL_POSE,
    topics.TF,
    topics.COLLISION,
    topics.JOINT_STATES,
    topics.GOAL_POSE,
    topics.CMD_VEL,
    topics.SCAN,
    topics.SCORE,
    topics.OUTCOME,
    topics.SCORE_TEXT,
    topics.TF_STATIC,
    topics.WORLD,
)


class TrialBag:
    """Record a trial instant by instant; every message carries the time of its instant."""

    def __init__(self, recorder: Recorder, spec: TrialSpec) -> None:
        frames = Frames(planning=spec.planning_frame)
        self._recorder = recorder
        self._spec = spec
        self._frames = frames
        self._simulator = SimulatorMessages(spec.simulator, frames)
        self._planner = PlannerMessages(frames)
        self._goal = PoseStampedEncoder(frames.of(topics.GOAL_POSE))
        self._score = LiveScore(spec)
        self._goal_period_ns = nanoseconds(spec.protocol.goal_period_s)
        self._next_goal_ns: int | None = 0
        given = () if spec.map is None else (topics.MAP,)
        for topic in (topics.ROBOT_DESCRIPTION, *given, *_ALWAYS):
            self._announce(topic)

    def begin(self, first: Sensors) -> None:
        """Record what is published once, at the start."""
        self._record(self._simulator.constant(), first.stamp_ns)
        if self._spec.map is not None:
            data = encode_map(self._spec.map, first.stamp_ns, self._frames.of(topics.MAP))
            self._record([Outgoing(topics.MAP, data)], first.stamp_ns)
        self._record([first_scene(self._spec, first.stamp_ns)], first.stamp_ns)

    def reading(self, sensors: Sensors, *, asked: bool = True) -> None:
        """Record the readings of an instant, the scan where the planner is asked, and the goal where it is sent."""
        stamp_ns = sensors.stamp_ns
        readings = self._simulator.sensors(sensors, stamp_ns)
        self._record((one for one in readings if asked or one.topic is not topics.SCAN), stamp_ns)
        self._record(moving_scene(self._spec, stamp_ns, stamp_ns), stamp_ns)
        if self._next_goal_ns is not None and stamp_ns >= self._next_goal_ns:
            self._record([Outgoing(topics.GOAL_POSE, self._goal.encode(self._spec.goal, stamp_ns))], stamp_ns)
            self._next_goal_ns = stamp_ns + self._goal_period_ns if self._goal_period_ns else None

    def answer(self, command: Velocity2D | None, decision: Decision, planner: Planner, stamp_ns: int) -> None:
        """Record the planner's answer to the readings of an instant and what it shows."""
        if command is not None:
            self._record([self._planner.command(command, stamp_ns)], stamp_ns)
        self._record(self._planner.shown(planner, decision, stamp_ns), stamp_ns)

    def standing(self, standing: Standing, stamp_ns: int) -> None:
        """Record how the trial stands at the end of an instant, when that is due."""
        self._record(self._score.take(standing, stamp_ns), stamp_ns)

    def conclude(self, cylinders_m: Floats, stamp_ns: int) -> None:
        """Record where obstacles stand at the end, centres (k, 2) m, if any has been pushed."""
        scene = last_scene(self._spec, cylinders_m, stamp_ns)
        self._record([scene] if scene else [], stamp_ns)

    def _record(self, messages: Iterable[Outgoing], stamp_ns: int) -> None:
        for topic, data in messages:
            self._announce(topic)
            self._recorder.write(topic.path, data, stamp_ns)

    def _announce(self, topic: Topic) -> None:
        """Announce a topic as a player should offer it, which is with a queue for many messages."""
        qos = LATCHED if topic.qos.durability == LATCHED.durability else RELIABLE
        self._recorder.add_topic(topic.path, topic.type_name, qos)
