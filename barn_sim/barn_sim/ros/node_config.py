"""Parameters of the simulator node besides those of `barn_sim.config.SimulatorConfig`."""

from dataclasses import dataclass

from barn_sim.config import SimulatorConfig
from barn_worlds.config import Checked, quantity
from barn_worlds.messages.topics import FRAMES, Frames
from barn_worlds.types import Pose2D

COMMAND_TYPES = ("auto", "twist", "twist_stamped")


@dataclass(frozen=True)
class SimulatorNodeConfig(Checked):
    """Parameters that are fixed when the node starts."""

    lockstep: bool = quantity(False, "wait for one command after each scan instead of running freely")
    start_paused: bool = quantity(False, "start paused")
    command_type: str = quantity("auto", "type of the commands; auto: the publisher's", choices=COMMAND_TYPES)
    scan_reliability: str = quantity(
        "auto",
        "quality of service of the scan; auto: reliable in lockstep, else best_effort",
        choices=("auto", "reliable", "best_effort"),
    )
    map_frame: str = quantity(FRAMES.map, "frame of the world")
    odom_frame: str = quantity(FRAMES.odom, "frame of the odometry")
    base_frame: str = quantity(FRAMES.base, "frame of the robot")
    lidar_frame: str = quantity(FRAMES.lidar, "frame of the scans")

    @property
    def frames(self) -> Frames:
        """The frames together."""
        return Frames(self.map_frame, self.odom_frame, self.base_frame, self.lidar_frame)


@dataclass(frozen=True)
class RunConfig(SimulatorConfig):
    """Parameters that a reset applies: the simulator's configuration, the world and the start pose."""

    dataset: str = quantity("barn300", "name of a shipped data set, or path of a folder or file with worlds")
    world: int = quantity(0, "number of the world", minimum=0, maximum=999_999_999)
    start_x_m: float = quantity(-2.25, "x of the start pose in the map frame", "m", minimum=-1e4, maximum=1e4)
    start_y_m: float = quantity(3.0, "y of the start pose in the map frame", "m", minimum=-1e4, maximum=1e4)
    start_yaw_rad: float = quantity(1.57, "yaw of the start pose", "rad", minimum=-7.0, maximum=7.0)
    seed: int = quantity(0, "seed of all noise", minimum=0)
    real_time_factor: float = quantity(
        1.0, "simulated time over real time when running freely, 0 for as fast as possible", minimum=0.0, maximum=1000.0
    )
    command_wait_s: float = quantity(
        5.0, "how long lockstep waits for a command, in real time", "s", minimum=0.001, maximum=3600.0
    )

    @property
    def start(self) -> Pose2D:
        """Start pose in the map frame."""
        return Pose2D(self.start_x_m, self.start_y_m, self.start_yaw_rad)
