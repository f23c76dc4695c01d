"""The topics of the suite: name, type, quality of service, frame and period of each."""

from dataclasses import dataclass, replace
from typing import NamedTuple


@dataclass(frozen=True, slots=True)
class Qos:
    """The quality of service that a publisher offers; its history is keep_last."""

    reliability: str = "reliable"
    durability: str = "volatile"
    depth: int = 10
    """Length of the queue, in messages."""


RELIABLE = Qos()
BEST_EFFORT = Qos(reliability="best_effort", depth=5)  # the sensor data profile of ROS
LATCHED = Qos(durability="transient_local", depth=1)
_DISPLAY = Qos(depth=1)


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic as a node declares it."""

    name: str
    """A relative name moves with the namespace of the node."""

    type_name: str
    qos: Qos = RELIABLE

    frame: str = ""
    """Field of `Frames` that the messages refer to, empty if none."""

    period_s: float = 0.0
    """Simulated time between two messages, 0 without a fixed period."""

    @property
    def path(self) -> str:
        """Name with a leading slash and without a namespace, as bags have it."""
        return self.name if self.name.startswith("/") else f"/{self.name}"


@dataclass(frozen=True, slots=True)
class Frames:
    """The names of the frames of a node, by default those of REP-105 and the URDF."""

    map: str = "map"
    odom: str = "odom"
    base: str = "base_link"
    lidar: str = "lidar_link"
    planning: str = "odom"
    """Frame of goals and global plans: map if there is a map, else odom."""

    def of(self, topic: Topic) -> str:
        """Return the name of the frame that a topic's messages have, or ""."""
        return str(getattr(self, topic.frame)) if topic.frame else ""


FRAMES = Frames()


class OutgoingMessage(NamedTuple):
    """A serialized message and its topic."""

    topic: Topic
    data: bytes


_ODOMETRY = "nav_msgs/msg/Odometry"
_POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
_GRID = "nav_msgs/msg/OccupancyGrid"
_PATH = "nav_msgs/msg/Path"
_TRANSFORMS = "tf2_msgs/msg/TFMessage"
_MARKERS = "visualization_msgs/msg/MarkerArray"
_STATUS = "diagnostic_msgs/msg/DiagnosticArray"

# From the simulator: fused odometry, the truth, and the estimated pose.
CLOCK = Topic("/clock", "rosgraph_msgs/msg/Clock")
ODOM = Topic("odom", _ODOMETRY, frame="odom")
GROUND_TRUTH = Topic("ground_truth/odom", _ODOMETRY, frame="map")
AMCL_POSE = Topic("amcl_pose", _POSE, frame="map")
TF = Topic("/tf", _TRANSFORMS, Qos(depth=100))
TF_STATIC = Topic("/tf_static", _TRANSFORMS, LATCHED)
COLLISION = Topic("collision", "std_msgs/msg/Bool")
JOINT_STATES = Topic("joint_states", "sensor_msgs/msg/JointState")
SCAN = Topic("scan", "sensor_msgs/msg/LaserScan", frame="lidar")
ROBOT_DESCRIPTION = Topic("robot_description", "std_msgs/msg/String", LATCHED)
SIMULATOR_DIAGNOSTICS = Topic("/diagnostics", _STATUS, period_s=1.0)

# From a planner. A robot takes commands of either type. What a planner shows around the
# robot is in the planning frame if its local costmap is.
CMD_VEL = Topic("cmd_vel", "geometry_msgs/msg/Twist")
CMD_VEL_STAMPED = replace(
    CMD_VEL, type_name="geometry_msgs/msg/TwistStamped", frame="base"
)
PLAN = Topic("plan", _PATH, _DISPLAY, "planning", 0.5)
LOCAL_PLAN = Topic("local_plan", _PATH, _DISPLAY, "odom", 0.5)
COSTMAP = Topic("local_costmap/costmap", _GRID, _DISPLAY, "odom", 0.5)
BAND = Topic("band", _MARKERS, _DISPLAY, "odom", 0.5)
CANDIDATES = Topic("candidates", _MARKERS, _DISPLAY, "odom", 0.5)
DIAGNOSTICS = Topic("diagnostics", _STATUS, period_s=1.0)

# From the evaluator, or a map server.
GOAL_POSE = Topic("goal_pose", "geometry_msgs/msg/PoseStamped", frame="planning")
MAP = Topic("map", _GRID, LATCHED, "map")
WORLD_PATH = Topic("plan", _PATH, LATCHED, "map")
SCORE = Topic("/score", "std_msgs/msg/Float64", period_s=0.5)
OUTCOME = Topic("/outcome", "std_msgs/msg/String", period_s=0.5)
SCORE_TEXT = Topic("/score_text", _MARKERS, frame="map", period_s=0.5)

# In bags only: what truly stands where. Nothing publishes it, because planners must not
# know.
WORLD = Topic("/world", _MARKERS, LATCHED, "map")
MOVING = Topic("/moving_obstacles", _MARKERS, frame="map", period_s=0.1)
MOVING_POSES = Topic(
    "/moving_obstacles/poses", "geometry_msgs/msg/PoseArray", frame="map", period_s=0.1
)
