"""The bag of a direct trial: the topics that the nodes of a ROS trial would publish, from the same readings."""

from __future__ import annotations

from barn_eval.bags.encode import (
    MAP_TYPE,
    BoolEncoder,
    ClockEncoder,
    GoalEncoder,
    JointEncoder,
    OdometryEncoder,
    PathEncoder,
    PoseEncoder,
    ScanEncoder,
    TransformEncoder,
    TwistEncoder,
    encode_map,
)
from barn_eval.bags.encode_views import (
    DIAGNOSTICS_TYPE,
    MARKERS_TYPE,
    encode_band,
    encode_candidates,
    encode_diagnostics,
)
from barn_eval.bags.live_score import TOPICS as SCORE_TOPICS
from barn_eval.bags.live_score import LiveScore
from barn_eval.bags.messages import make, serialise
from barn_eval.bags.recorder import LATCHED, Recorder
from barn_eval.trials.referee import Standing
from barn_eval.trials.spec import MAP_FRAME, ODOM_FRAME, TrialSpec
from barn_planners.candidates import shown_candidates
from barn_planners.interface import Decision, Planner, PlannerStatus
from barn_sim.config import LocalisationConfig
from barn_sim.model import WHEELS, fixed_frames, robot_description
from barn_sim.simulator import Sensors
from barn_worlds.types import Velocity2D, nanoseconds

BASE_FRAME, LIDAR_FRAME = "base_link", "lidar_link"
# How often a planner's node shows what it has in mind, and says how it is unless that changes.
_VIEW_PERIOD_NS = nanoseconds(0.5)
_DIAGNOSTICS_PERIOD_NS = nanoseconds(1.0)


class TrialBag:
    """Record a trial instant by instant; every message carries the time of its instant."""

    def __init__(self, recorder: Recorder, spec: TrialSpec) -> None:
        self._recorder = recorder
        self._spec = spec
        self._clock = ClockEncoder()
        self._odometry = OdometryEncoder(ODOM_FRAME, BASE_FRAME)
        self._truth = OdometryEncoder(MAP_FRAME, BASE_FRAME)
        self._pose = PoseEncoder(MAP_FRAME, _variances(spec.simulator.localisation))
        self._contact = BoolEncoder()
        self._joints = JointEncoder([f"{wheel}_joint" for wheel in WHEELS])
        self._transforms = TransformEncoder([(MAP_FRAME, ODOM_FRAME), (ODOM_FRAME, BASE_FRAME)])
        self._goal = GoalEncoder(spec.planning_frame)
        self._command = TwistEncoder()
        self._shown = _Shown(recorder, spec.planning_frame)
        self._score = LiveScore(spec)
        self._goal_period_ns = nanoseconds(spec.protocol.goal_period_s)
        self._next_goal_ns: int | None = 0
        self._add_topics()

    def begin(self, first: Sensors) -> None:
        """Record what is published once, at the start."""
        stamp_ns = first.stamp_ns
        self._scan = ScanEncoder(first.scan, LIDAR_FRAME, self._spec.protocol.control_period_s)
        robot = serialise(make("std_msgs/msg/String", data=robot_description(self._spec.simulator.lidar)))
        self._recorder.write("/robot_description", robot, stamp_ns)
        self._recorder.write("/tf_static", _fixed_transforms(self._spec), stamp_ns)
        if self._spec.map is not None:
            self._recorder.write("/map", encode_map(self._spec.map, stamp_ns, MAP_FRAME), stamp_ns)

    def reading(self, sensors: Sensors) -> None:
        """Record the readings of an instant and the goal, where it is sent again."""
        stamp_ns, write = sensors.stamp_ns, self._recorder.write
        believed, measured = sensors.localisation, sensors.odometry
        write("/clock", self._clock.encode(stamp_ns), stamp_ns)
        write("/odom", self._odometry.encode(measured), stamp_ns)
        write("/ground_truth/odom", self._truth.encode(sensors.truth), stamp_ns)
        write("/amcl_pose", self._pose.encode(believed, stamp_ns), stamp_ns)
        correction = believed @ measured.pose.inverse()
        write("/tf", self._transforms.encode([correction, measured.pose], stamp_ns), stamp_ns)
        write("/collision", self._contact.encode(sensors.collision), stamp_ns)
        joints = sensors.joints
        write("/joint_states", self._joints.encode(joints.positions, joints.velocities, stamp_ns), stamp_ns)
        write("/scan", self._scan.encode(sensors.scan), stamp_ns)
        if self._next_goal_ns is not None and stamp_ns >= self._next_goal_ns:
            write("/goal_pose", self._goal.encode(self._spec.goal, stamp_ns), stamp_ns)
            self._next_goal_ns = stamp_ns + self._goal_period_ns if self._goal_period_ns else None

    def answer(self, command: Velocity2D | None, decision: Decision, planner: Planner, stamp_ns: int) -> None:
        """Record the planner's answer to the readings of an instant and what it shows."""
        if command is not None:
            self._recorder.write("/cmd_vel", self._command.encode(command), stamp_ns)
        self._shown.record(decision, planner, stamp_ns)

    def standing(self, standing: Standing, stamp_ns: int) -> None:
        """Record how the trial stands at the end of an instant, when that is due."""
        for topic, data in self._score.take(standing, stamp_ns):
            self._recorder.write(topic, data, stamp_ns)

    def _add_topics(self) -> None:
        add = self._recorder.add_topic
        add("/robot_description", "std_msgs/msg/String", LATCHED)
        if self._spec.map is not None:
            add("/map", MAP_TYPE, LATCHED)
        for topic, encoder in (
            ("/clock", self._clock),
            ("/odom", self._odometry),
            ("/ground_truth/odom", self._truth),
            ("/amcl_pose", self._pose),
            ("/tf", self._transforms),
            ("/collision", self._contact),
            ("/joint_states", self._joints),
            ("/goal_pose", self._goal),
            ("/cmd_vel", self._command),
        ):
            add(topic, encoder.type_name)
        add("/scan", ScanEncoder.type_name)
        for topic, type_name in SCORE_TOPICS.items():
            add(topic, type_name)
        add("/tf_static", TransformEncoder.type_name, LATCHED)


class _Shown:
    """Record what a planner shows, as often as its node would publish it."""

    def __init__(self, recorder: Recorder, planning_frame: str) -> None:
        self._recorder = recorder
        self._plan = PathEncoder(planning_frame)
        self._local_plan = PathEncoder(ODOM_FRAME)
        self._due_ns = {"plan": 0, "view": 0, "diagnostics": 0}
        self._status: PlannerStatus | None = None

    def record(self, decision: Decision, planner: Planner, stamp_ns: int) -> None:
        """Record what is due after a decision."""
        if decision.plan is not None and self._due("plan", stamp_ns, _VIEW_PERIOD_NS):
            self._write("/plan", self._plan.type_name, self._plan.encode(decision.plan, stamp_ns), stamp_ns)
        if self._due("view", stamp_ns, _VIEW_PERIOD_NS):
            self._record_view(planner, stamp_ns)
        if decision.command is None:
            return
        if decision.status is not self._status:
            self._due_ns["diagnostics"] = stamp_ns
        if self._due("diagnostics", stamp_ns, _DIAGNOSTICS_PERIOD_NS):
            self._status = decision.status
            data = encode_diagnostics(decision, "planner", stamp_ns)
            self._write("/diagnostics", DIAGNOSTICS_TYPE, data, stamp_ns)

    def _record_view(self, planner: Planner, stamp_ns: int) -> None:
        view = planner.view()
        if view.local_plan is not None:
            data = self._local_plan.encode(view.local_plan, stamp_ns)
            self._write("/local_plan", self._local_plan.type_name, data, stamp_ns)
        if view.costmap is not None:
            data = encode_map(view.costmap, stamp_ns, ODOM_FRAME)
            self._write("/local_costmap/costmap", MAP_TYPE, data, stamp_ns)
        if view.band is not None:
            self._write("/band", MARKERS_TYPE, encode_band(view.band, stamp_ns, ODOM_FRAME), stamp_ns)
        if view.candidates is not None:
            data = encode_candidates(shown_candidates(view.candidates, view.candidate_costs), stamp_ns, ODOM_FRAME)
            self._write("/candidates", MARKERS_TYPE, data, stamp_ns)

    def _due(self, what: str, stamp_ns: int, period_ns: int) -> bool:
        if stamp_ns < self._due_ns[what]:
            return False
        self._due_ns[what] = stamp_ns + period_ns
        return True

    def _write(self, topic: str, type_name: str, data: bytes, stamp_ns: int) -> None:
        self._recorder.add_topic(topic, type_name)
        self._recorder.write(topic, data, stamp_ns)


def _variances(config: LocalisationConfig) -> tuple[float, float, float]:
    """Return the variances of x, y and yaw that the simulator states for its localisation."""
    if config.mode == "exact":
        return 0.0, 0.0, 0.0
    return config.position_std_m**2, config.position_std_m**2, config.yaw_std_rad**2


def _fixed_transforms(spec: TrialSpec) -> bytes:
    transforms = []
    for child, (x, y, z) in fixed_frames(spec.simulator.lidar).items():
        header = make("std_msgs/msg/Header", frame_id=BASE_FRAME)
        transform = make("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child)
        where = transform.transform.translation
        where.x, where.y, where.z = x, y, z
        transform.transform.rotation.w = 1.0
        transforms.append(transform)
    return serialise(make(TransformEncoder.type_name, transforms=transforms))
