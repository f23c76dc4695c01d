"""The messages of a simulated robot, serialised: its node sends them, a direct trial records them."""

from collections.abc import Iterator

from barn_sim.body.model import fixed_frames, joint_names, robot_description
from barn_sim.config import LocalizationConfig, SimulatorConfig
from barn_sim.sensors.readings import Joints, Sensors
from barn_worlds.base.types import Odometry, Pose2D, Scan
from barn_worlds.messages import encode, topics
from barn_worlds.messages.topics import FRAMES, Frames, Outgoing

ORIGIN = Pose2D(0.0, 0.0, 0.0)


class SimulatorMessages:
    """The messages of one trial.

    scan_period_s: time between two scans, if None that in whole control periods. start: initial pose of the robot
    in the map frame, for the first transforms.
    """

    def __init__(
        self,
        config: SimulatorConfig,
        frames: Frames = FRAMES,
        scan_period_s: float | None = None,
        start: Pose2D = ORIGIN,
    ) -> None:
        self._config, self._frames = config, frames
        self._scan_period_s = (
            config.scan_steps * config.control_period_s
            if scan_period_s is None
            else scan_period_s
        )
        self._odometry = encode.OdometryEncoder(frames.of(topics.ODOM), frames.base)
        self._truth = encode.OdometryEncoder(
            frames.of(topics.GROUND_TRUTH), frames.base
        )
        variances = _variances(config.localisation)
        self._localization = encode.PoseWithCovarianceEncoder(
            frames.of(topics.AMCL_POSE), variances
        )
        self._joints = encode.JointEncoder(joint_names(config.chassis))
        self._transforms = encode.TransformEncoder(
            [(frames.map, frames.odom), (frames.odom, frames.base)]
        )
        self._scan: encode.ScanEncoder | None = None
        self._odom_in_map, self._base_in_odom = start, ORIGIN

    def constant(self) -> Iterator[Outgoing]:
        """Yield what is published once: the robot's description and its fixed frames."""
        lidar, chassis, frames = self._config.lidar, self._config.chassis, self._frames
        yield Outgoing(
            topics.ROBOT_DESCRIPTION,
            encode.encode_text(robot_description(lidar, chassis)),
        )
        names = {FRAMES.lidar: frames.lidar}
        fixed = {
            names.get(child, child): xyz
            for child, xyz in fixed_frames(lidar, chassis).items()
        }
        yaws = {frames.lidar: lidar.mount_yaw_rad}
        yield Outgoing(
            topics.TF_STATIC, encode.encode_fixed_transforms(frames.base, fixed, yaws)
        )

    def sensors(self, sensors: Sensors, stamp_ns: int) -> Iterator[Outgoing]:
        """Yield the messages of an instant whose time is `stamp_ns`: the time first, last the scan if it is of now."""
        yield self.clock(stamp_ns)
        yield self.odometry(sensors.odometry, stamp_ns)
        yield self.truth(sensors.truth, stamp_ns)
        yield self.localization(sensors.localization, sensors.odometry.pose, stamp_ns)
        yield self.transforms(sensors.odometry.pose, stamp_ns)
        yield self.collision(sensors.collision)
        yield self.joints(sensors.joints, stamp_ns)
        if sensors.scan.stamp_ns == sensors.stamp_ns:
            yield self.scan(sensors.scan, stamp_ns)

    def clock(self, stamp_ns: int) -> Outgoing:
        """Return the time."""
        return Outgoing(topics.CLOCK, encode.encode_clock(stamp_ns))

    def odometry(self, odometry: Odometry, stamp_ns: int) -> Outgoing:
        """Return the odometry."""
        return Outgoing(topics.ODOM, self._odometry.encode(odometry, stamp_ns))

    def truth(self, truth: Odometry, stamp_ns: int) -> Outgoing:
        """Return the true pose and velocity."""
        return Outgoing(topics.GROUND_TRUTH, self._truth.encode(truth, stamp_ns))

    def localization(self, pose: Pose2D, odometry: Pose2D, stamp_ns: int) -> Outgoing:
        """Return the estimated pose in the map frame; also given is the pose in the odom frame."""
        self._odom_in_map = pose @ odometry.inverse()
        return Outgoing(topics.AMCL_POSE, self._localization.encode(pose, stamp_ns))

    def transforms(self, odometry: Pose2D, stamp_ns: int) -> Outgoing:
        """Return the transforms from map to odom, after the last localisation, and from odom to base."""
        self._base_in_odom = odometry
        return self.last_transforms(stamp_ns)

    def last_transforms(self, stamp_ns: int) -> Outgoing:
        """Return the last transforms; before the first instant, those of the start."""
        poses = [self._odom_in_map, self._base_in_odom]
        return Outgoing(topics.TF, self._transforms.encode(poses, stamp_ns))

    def collision(self, touched: bool) -> Outgoing:
        """Return whether the robot has touched anything."""
        return Outgoing(topics.COLLISION, encode.encode_bool(touched))

    def joints(self, joints: Joints, stamp_ns: int) -> Outgoing:
        """Return the state of the wheels."""
        return Outgoing(
            topics.JOINT_STATES,
            self._joints.encode((joints.positions, joints.velocities), stamp_ns),
        )

    def scan(self, scan: Scan, stamp_ns: int) -> Outgoing:
        """Return a scan."""
        if self._scan is None:
            self._scan = encode.ScanEncoder(
                scan, self._frames.of(topics.SCAN), self._scan_period_s
            )
        return Outgoing(topics.SCAN, self._scan.encode(scan, stamp_ns))


def _variances(config: LocalizationConfig) -> tuple[float, float, float]:
    """Return the variances of x, y (m2) and yaw (rad2) that the simulator states for its localisation."""
    if config.mode == "exact":
        return 0.0, 0.0, 0.0
    return config.position_std_m**2, config.position_std_m**2, config.yaw_std_rad**2
