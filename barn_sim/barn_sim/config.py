"""Configuration of the simulator: the robot, its sensors and the obstacles.

Unless another source is named, values are those of a Clearpath Jackal J100 with a
Hokuyo UST-10LX, from the configuration of its drivers and models.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from barn_worlds.base.compute import Compute
from barn_worlds.base.config import (
    OPTIONAL,
    Checked,
    from_dict,
    optional,
    quantity,
    read_presets,
)
from barn_worlds.base.types import Pose2D, nanoseconds
from barn_worlds.messages.topics import FRAMES, Frames
from barn_worlds.robots.files import ROBOTS, STANDARD_ROBOT
from barn_worlds.robots.parts import DriveConfig, LidarConfig, OdometryConfig
from barn_worlds.robots.robot import Chassis, Robot

# Parts of a robot, which barn_worlds defines, are offered here, too.
__all__ = ("DriveConfig", "LidarConfig", "OdometryConfig")

# Results of trials belong to a version of the physics: the task fingerprint includes
# it. Increase it with every change of motion or contacts beyond rounding.
PHYSICS_VERSION = 1

Config = TypeVar("Config", bound="SimulatorConfig")


@dataclass(frozen=True)
class PhysicsConfig(Checked):
    """The integration and the ground."""

    # Longer ticks can be unstable: the springs of the tires are stiff, see `Tires`.
    tick_s: float = quantity(0.005, "physics step", "s", 0.0005, 0.01)
    gravity_m_s2: float = quantity(9.81, "acceleration of free fall", "m/s2", 1.0, 30.0)
    wheel_friction: float = quantity(
        0.5, "friction coefficient of the wheels on the ground", "", 0.0, 3.0
    )
    chassis_friction: float = quantity(
        1.0, "friction coefficient of the body", "", 0.0, 3.0
    )
    tyre_deflection_m: float = quantity(
        0.002, "deflection of a tire under its share of the weight", "m", 0.0005, 0.01
    )
    tyre_damping_ratio: float = quantity(
        0.5, "damping ratio of a tire; 1 is critical", "", 0.05, 1.0
    )
    tire_slip_mps: float = optional(
        0.0,
        "slip at which a tire reaches full friction; below it, friction grows with slip",
        "m/s",
        0.0,
        1.0,
    )


@dataclass(frozen=True)
class LocalizationConfig(Checked):
    """Source of the robot's estimate of its pose in the map frame.

    Mode exact gives the truth. In modes amcl and particles, the correction from odom to
    map changes only after the robot has moved or turned by the update distances. Then,
    in mode amcl, the error of the estimate takes one step of a first-order Gauss-Markov
    process. In mode particles, a filter matches a scan to its map without the truth.
    """

    mode: str = quantity(
        "exact",
        "source of the pose in the map frame",
        choices=("exact", "amcl", "particles"),
    )
    position_std_m: float = quantity(
        0.04, "standard deviation of the error along x and along y", "m", 0.0, 5.0
    )
    yaw_std_rad: float = quantity(
        0.01, "standard deviation of the yaw error", "rad", 0.0, 3.0
    )
    offset_x_m: float = quantity(
        0.0,
        "constant offset of the pose along x, as from a shifted map",
        "m",
        -5.0,
        5.0,
    )
    offset_y_m: float = quantity(
        0.0, "constant offset of the pose along y", "m", -5.0, 5.0
    )
    correlation_updates: float = quantity(
        5.0, "number of updates in which an error decays to 1/e", "", 0.01, 1000.0
    )
    update_distance_m: float = quantity(
        0.1, "distance between updates", "m", 0.001, 100.0
    )
    update_turn_rad: float = quantity(
        0.314, "turn between updates", "rad", 0.001, 100.0
    )
    historical_map: bool = quantity(
        False, "particles: use the original's map, with obstacles one cell nearer"
    )
    initial_std_m: float = quantity(
        0.5, "particles: standard deviation of x and y around the start", "m", 0.0, 10.0
    )
    initial_yaw_std_rad: float = quantity(
        0.262, "particles: standard deviation of heading at start", "rad", 0.0, 3.0
    )
    min_particles: int = quantity(500, "particles: smallest number", "", 1, 100_000)
    max_particles: int = quantity(
        2000, "particles: largest number, also at the start", "", 1, 100_000
    )
    motion_noise: float = quantity(
        0.2,
        "particles: noise of the motion model (alpha 1 to 4 of amcl)",
        "",
        0.0,
        10.0,
    )
    hit_share: float = quantity(
        0.5, "particles: weight of hitting a mapped obstacle", "", 0.0, 1.0
    )
    random_share: float = quantity(
        0.5, "particles: weight of a random range", "", 0.0, 1.0
    )
    hit_std_m: float = quantity(
        0.2,
        "particles: standard deviation of a hit from the obstacle",
        "m",
        0.001,
        10.0,
    )
    beams: int = quantity(
        720, "particles: number of beams to compare with the map", "", 2, 10_000
    )
    correction_delay_s: float = quantity(
        0.0, "particles: delay of each correction (amcl: 1 s)", "s", 0.0, 10.0
    )
    recovery_alpha_slow: float = quantity(
        0.0, "particles: decay of the slow average weight (as in amcl)", "", 0.0, 1.0
    )
    recovery_alpha_fast: float = quantity(
        0.0, "particles: decay of the fast average (Jackal: 0.1); 0: off", "", 0.0, 1.0
    )
    half_cell_low: bool = quantity(
        True, "particles: center cells on their lower corners (a quirk of amcl)"
    )


@dataclass(frozen=True)
class ObstacleConfig(Checked):
    """Whether and how obstacles can be pushed.

    Moments of inertia are those of the original world files.
    """

    movable: bool = quantity(False, "whether the grid's cylinders can be pushed over")
    containment_movable: bool = quantity(
        True, "with movable: whether the containment can be pushed over, too"
    )
    mass_kg: float = quantity(1.0, "mass of a cylinder", "kg", 0.01, 1000.0)
    inertia_tilt_kg_m2: float = quantity(
        0.145833, "moment of inertia about a horizontal axis", "kg m2", 1e-5, 1000.0
    )
    inertia_spin_kg_m2: float = quantity(
        0.125, "moment of inertia about the cylinder's axis", "kg m2", 1e-5, 1000.0
    )
    friction: float = quantity(1.0, "friction coefficient of an obstacle", "", 0.0, 3.0)
    random_phase: bool = optional(
        True,
        "whether moving obstacles start at a random time in their motions, drawn from the seed, instead of at 0",
    )
    clear_start_s: float = optional(
        0.0,
        "with random_phase: time for which no moving obstacle reaches a robot that"
        " stays at its start",
        "s",
        0.0,
        1000.0,
    )


@dataclass(frozen=True)
class SimulatorConfig(Checked):
    """Everything about a simulated robot except its world, start pose and seed."""

    control_period_s: float = quantity(
        0.05, "duration of a control step, from command to command", "s", 0.005, 1.0
    )
    physics: PhysicsConfig = PhysicsConfig()
    drive: DriveConfig = field(default_factory=DriveConfig)
    lidar: LidarConfig = field(default_factory=LidarConfig)
    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    localisation: LocalizationConfig = LocalizationConfig()
    obstacles: ObstacleConfig = ObstacleConfig()
    # Set as a whole, by `with_robot`; its fields are not parameters of a node.
    chassis: Chassis = field(default=STANDARD_ROBOT.chassis, metadata=OPTIONAL)

    def check_rules(self) -> None:
        """Raise ConfigError unless the periods are whole numbers of physics steps."""
        periods_s = {
            "control_period_s": self.control_period_s,
            # Compiled code counts ticks. A sensor period between two of them would
            # delay readings by a varying time.
            "odometry.rate_hz": 1.0 / self.odometry.rate_hz,
            "lidar.rate_hz": 1.0 / self.lidar.rate_hz,
        }
        tick = f"{self.physics.tick_s:g} s"
        for name, period_s in periods_s.items():
            ticks = self.ticks(period_s)
            is_whole = ticks >= 1 and ticks * self.tick_ns == nanoseconds(period_s)
            rule = f"must give a period of whole physics steps of {tick}"
            self.require(is_whole, name, rule)

    @property
    def tick_ns(self) -> int:
        """Duration of a physics step, in ns."""
        return nanoseconds(self.physics.tick_s)

    @property
    def scan_steps(self) -> int:
        """Number of control periods from one scan to the next, at least 1.

        Rounded up, since a scan comes with the readings of a control step.
        """
        # Less than a millionth of a step over a whole number is rounding.
        steps = 1.0 / (self.lidar.rate_hz * self.control_period_s)
        return max(1, math.ceil(steps - 1e-6))

    def ticks(self, period_s: float) -> int:
        """Return the number of physics steps in a period in s, rounded."""
        return round(nanoseconds(period_s) / self.tick_ns)


# Fields by part that a preset may change for any robot: noise and latency.
_PRESET_FIELDS = {
    "drive": ["command_latency_s"],
    "lidar": ["noise_m"],
    "odometry": ["yaw_noise_rad", "yaw_rate_noise_rad_s"],
}


def with_robot(config: Config, robot: Robot) -> Config:
    """Return a configuration with a robot's parts, unless standard; preset noise stays.

    Args:
        config: Configuration of any simulator. For the standard robot it is returned
            unchanged, because presets differ from that robot's own file.
        robot: Source of chassis, drive, lidar, odometry and grip of the wheels. A noise
            or latency that a preset changed, such as 0 in `ideal`, stays. A robot that
            equals a shipped one gets its name. Another robot with such a name becomes
            "NAME (own)".
    """
    for shipped in ROBOTS.values():
        if robot.drives_as(shipped):
            robot = shipped
    if robot is STANDARD_ROBOT and config.chassis == robot.chassis:
        return config
    if robot.name in ROBOTS and robot is not ROBOTS[robot.name]:
        own = replace(robot.chassis, name=f"{robot.name} (own)")
        robot = replace(robot, chassis=own)

    standard = SimulatorConfig()
    parts: dict[str, Any] = {
        "chassis": robot.chassis,
        "physics": replace(config.physics, wheel_friction=robot.wheel_friction),
    }
    for name, fields in _PRESET_FIELDS.items():
        changes = {}
        for key in fields:
            value = getattr(getattr(config, name), key)
            if value != getattr(getattr(standard, name), key):
                changes[key] = value
        parts[name] = replace(getattr(robot, name), **changes)
    # No noise means none of both kinds, absolute and relative.
    if not parts["lidar"].noise_m:
        parts["lidar"] = replace(parts["lidar"], noise_share=0.0)
    return replace(config, **parts)


def chassis_in(simulator: object) -> Chassis:
    """Return the `Chassis` in plain data, else the standard one; ConfigError if wrong.

    Args:
        simulator: Mapping that may have a chassis. Without one, or for anything else,
            the result is the standard robot's.

    Raises:
        ConfigError: If the chassis is not allowed.
    """
    chassis = None
    if isinstance(simulator, Mapping):
        # The first runs all drove a Jackal, so their configurations have no chassis.
        chassis = simulator.get("chassis")
    if chassis is None:
        return STANDARD_ROBOT.chassis
    return from_dict(Chassis, chassis, "simulator.chassis")


def robot_of(config: SimulatorConfig) -> Robot:
    """Return a configuration's chassis, drive, lidar, odometry, grip as a `Robot`."""
    return Robot(
        config.chassis,
        config.drive,
        config.lidar,
        config.odometry,
        config.physics.wheel_friction,
    )


# data/presets.yaml explains each of them.
PRESETS = read_presets("barn_sim", "presets.yaml", SimulatorConfig())


@dataclass(frozen=True)
class SimulatorNodeConfig(Checked):
    """Parameters that are fixed when the node starts."""

    # In lockstep, results do not depend on how busy the machine is.
    lockstep: bool = quantity(
        False, "wait for a command after each scan instead of running freely"
    )
    planner_rate_hz: float = quantity(
        0.0,
        "in lockstep: rate of the commands to wait for; 0: one command after each scan, or the measured rate",
        "Hz",
        0.0,
        1000.0,
    )
    start_paused: bool = quantity(False, "whether to start paused")
    command_type: str = quantity(
        "auto",
        "message type of commands; auto: the publisher's",
        choices=("auto", "twist", "twist_stamped"),
    )
    # A reliable publisher serves both kinds of subscribers, a best-effort one only its
    # own kind.
    scan_reliability: str = quantity(
        "reliable", "reliability of the scan", choices=("reliable", "best_effort")
    )
    map_frame: str = quantity(FRAMES.map, "frame of the world")
    odom_frame: str = quantity(FRAMES.odom, "frame of the odometry")
    base_frame: str = quantity(FRAMES.base, "frame of the robot")
    lidar_frame: str = quantity(FRAMES.lidar, "frame of the scans")
    ground_truth: bool = quantity(
        True,
        "publish the true pose and contacts, which a planner under test must not read",
    )
    # A descriptor that only a parent process can hand over, so that no other node can
    # pose as the evaluator.
    evaluator_fd: int = quantity(
        -1, "private socket to the evaluator; -1: none", "", -1, 1_000_000
    )

    @property
    def frames(self) -> Frames:
        """Names of the map, odom, base and lidar frames in the node's messages."""
        return Frames(
            self.map_frame, self.odom_frame, self.base_frame, self.lidar_frame
        )


@dataclass(frozen=True)
class RunConfig(SimulatorConfig):
    """Parameters that a reset applies: the simulator, the world and the start pose."""

    robot: str = quantity(
        STANDARD_ROBOT.name,
        "name or YAML file of a robot; it sets the parameters that you do not set",
    )
    dataset: str = quantity(
        "barn300", "name of a shipped data set, or path of a folder or file with worlds"
    )
    world: int = quantity(0, "number of the world", "", 0, 999_999_999)
    start_x_m: float = quantity(
        -2.25, "x of the start pose in the map frame", "m", -1e4, 1e4
    )
    start_y_m: float = quantity(
        3.0, "y of the start pose in the map frame", "m", -1e4, 1e4
    )
    start_yaw_rad: float = quantity(1.57, "yaw of the start pose", "rad", -7.0, 7.0)
    seed: int = quantity(0, "seed of all noise", minimum=0)
    real_time_factor: float = quantity(
        1.0,
        "ratio of simulated time to real time; 0: as fast as possible",
        "",
        0.0,
        1000.0,
    )
    command_wait_s: float = quantity(
        5.0, "real time for which lockstep waits for a command", "s", 0.001, 3600.0
    )

    compute: Compute = field(default_factory=Compute)
    compute_seed: int = quantity(
        0, "seed of the planner's delays in lockstep", minimum=0
    )

    @property
    def start(self) -> Pose2D:
        """Start pose of base_link in the map frame, m and rad."""
        return Pose2D(self.start_x_m, self.start_y_m, self.start_yaw_rad)
