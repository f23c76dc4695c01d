"""The bag of a direct trial: the topics that the nodes of a ROS trial would publish, from the same readings."""

from __future__ import annotations

from barn_eval.encode import (
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
from barn_eval.messages import make, serialise
from barn_eval.recorder import LATCHED, Recorder
from barn_eval.trial import MAP_FRAME, ODOM_FRAME, TrialSpec
from barn_planners.interface import Decision
from barn_sim.model import WHEELS, robot_description
from barn_sim.simulator import Sensors
from barn_worlds.types import nanoseconds

BASE_FRAME, LIDAR_FRAME = "base_link", "lidar_link"


class TrialBag:
    """Record a trial instant by instant; every message carries the time of its instant."""

    def __init__(self, recorder: Recorder, spec: TrialSpec) -> None:
        self._recorder = recorder
        self._spec = spec
        self._clock = ClockEncoder()
        self._odometry = OdometryEncoder(ODOM_FRAME, BASE_FRAME)
        self._truth = OdometryEncoder(MAP_FRAME, BASE_FRAME)
        self._pose = PoseEncoder(MAP_FRAME)
        self._contact = BoolEncoder()
        self._joints = JointEncoder([f"{wheel}_joint" for wheel in WHEELS])
        self._transforms = TransformEncoder([(MAP_FRAME, ODOM_FRAME), (ODOM_FRAME, BASE_FRAME)])
        self._goal = GoalEncoder(spec.planning_frame)
        self._command = TwistEncoder()
        self._plan = PathEncoder(spec.planning_frame)
        self._goal_period_ns = nanoseconds(spec.protocol.goal_period_s)
        self._next_goal_ns: int | None = 0
        self._add_topics()

    def begin(self, first: Sensors) -> None:
        """Record what is published once, at the start."""
        stamp_ns = first.stamp_ns
        self._scan = ScanEncoder(first.scan, LIDAR_FRAME, self._spec.protocol.control_period_s)
        robot = serialise(make("std_msgs/msg/String", data=robot_description(self._spec.simulator.lidar)))
        self._recorder.write("/robot_description", robot, stamp_ns)
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

    def decision(self, decision: Decision, stamp_ns: int) -> None:
        """Record the planner's answer."""
        if decision.plan is not None:
            self._recorder.write("/plan", self._plan.encode(decision.plan, stamp_ns), stamp_ns)
        if decision.command is not None:
            self._recorder.write("/cmd_vel", self._command.encode(decision.command), stamp_ns)

    def _add_topics(self) -> None:
        add = self._recorder.add_topic
        add("/robot_description", "std_msgs/msg/String", LATCHED)
        if self._spec.map is not None:
            add("/map", "nav_msgs/msg/OccupancyGrid", LATCHED)
        for topic, encoder in (
            ("/clock", self._clock),
            ("/odom", self._odometry),
            ("/ground_truth/odom", self._truth),
            ("/amcl_pose", self._pose),
            ("/tf", self._transforms),
            ("/collision", self._contact),
            ("/joint_states", self._joints),
            ("/goal_pose", self._goal),
            ("/plan", self._plan),
            ("/cmd_vel", self._command),
        ):
            add(topic, encoder.type_name)
        add("/scan", ScanEncoder.type_name)
