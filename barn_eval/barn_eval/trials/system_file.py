"""The file of a simulator or robot that somebody else runs, judged as it drives."""

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from pathlib import Path

from barn_eval.trials.system import NO_CONTACT, OPERATOR, System
from barn_worlds.base.config import as_dict, from_dict, quantity
from barn_worlds.base.files import read_yaml

SCHEMA_VERSION = 1
INTERFACES = "simulation_interfaces"  # ROS's standard services of simulators
RESETS = (OPERATOR, "service", INTERFACES)
TOPICS = ("cmd_vel", "collision", "goal_pose", "map", "odom", "scan")


@dataclass(frozen=True)
class SystemFile(System):
    """A system that somebody else runs, and how the evaluator reaches it."""

    name: str = quantity("", "name of the simulator or robot")
    pose: str = quantity("/odom", "topic of poses, of type nav_msgs/msg/Odometry")
    frame: str = quantity("odom", "frame of poses", choices=("world", "odom"))
    clock: str = quantity("stamps", "source of times", choices=("stamps", "log"))
    contact: str = quantity(
        NO_CONTACT,
        "source of contacts: a topic of std_msgs/msg/Bool, operator, or none",
    )
    reset: str = quantity(OPERATOR, "what puts the robot at the start", choices=RESETS)
    reset_service: str = quantity(
        "/reset_simulation",
        "service that resets, of type std_srvs/srv/Trigger or ResetSimulation",
    )
    reset_scope: int = quantity(
        0,
        "bits of ResetSimulation: 1 time, 2 state, 4 spawned entities; 0: all",
        minimum=0,
        maximum=255,
    )
    robot_entity: str = quantity(
        "",
        "name of the robot in the simulator; after the reset, SetEntityState in the same"
        " namespace moves the robot to the start; empty: the reset moves the robot",
    )
    robot_z_m: float = quantity(
        0.0, "height at which SetEntityState places the robot", "m"
    )
    world_node: str = quantity(
        "",
        "node that takes dataset, world, robot, seed, start_x_m, start_y_m and"
        " start_yaw_rad as parameters before the reset; empty: none",
    )
    sim_time: bool = quantity(
        False, "whether planners of the suite take the time from /clock"
    )
    # Names on the graph, by the suite's names.
    topics: dict[str, str] = field(default_factory=dict)

    def check_rules(self) -> None:
        """Raise ConfigError for the suite's name or an invalid pose, contact or topic."""
        super().check_rules()
        self.require(
            self.is_observed, "name", "must not be that of the suite's own simulator"
        )
        is_topic = self.pose.startswith("/") and ":" not in self.pose
        self.require(is_topic, "pose", "must be a topic such as /odom in a live trial")
        is_reported = self.contact in (NO_CONTACT, OPERATOR)
        is_reported |= self.contact.startswith("/")
        self.require(is_reported, "contact", "must be a topic, operator or none")
        is_set = self.robot_entity == "" or self.reset == INTERFACES
        self.require(is_set, "robot_entity", f"needs reset: {INTERFACES}")
        unknown = self.topics.keys() - set(TOPICS)
        self.require(not unknown, "topics", f"must be among {', '.join(TOPICS)}")

    @property
    def system(self) -> System:
        """The part of it that belongs to the task, without how it is reached."""
        content = as_dict(self)
        return System(**{item.name: content[item.name] for item in fields(System)})

    def remappings(self) -> Iterator[str]:
        """Yield ROS rules FROM:=TO for odom, a contact topic and the file's topics."""
        names = {"odom": self.pose}
        if self.contact.startswith("/"):
            names["collision"] = self.contact
        for name, topic in (names | self.topics).items():
            yield f"{name}:={topic}"


def read_system(path: Path) -> SystemFile:
    """Return the system that a YAML file describes; raise ConfigError if invalid.

    Raises:
        ConfigError: If the file cannot be read, or a key or value is not allowed.
    """
    return from_dict(SystemFile, read_yaml(path, SCHEMA_VERSION), str(path))
