"""The messages of a simulated robot, which are sent or recorded."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from barn_sim.body.model import fixed_frames, joint_names, robot_description
from barn_sim.config import LocalizationConfig, SimulatorConfig
from barn_sim.sensors.readings import Joints, Sensors
from barn_worlds.base.types import (
    NANOSECONDS_PER_SECOND,
    ORIGIN,
    Odometry,
    Pose2D,
    Scan,
)
from barn_worlds.messages import encode, topics
from barn_worlds.messages.cdr import Layout
from barn_worlds.messages.topics import FRAMES, Frames, OutgoingMessage, Topic


class SimulatorMessages:
    """Encodes the readings of one trial as messages."""

    def __init__(
        self,
        config: SimulatorConfig,
        frames: Frames = FRAMES,
        scan_period_s: float | None = None,
        start: Pose2D = ORIGIN,
    ):
        """Prepare the encoders of all topics.

        Args:
            config: Configuration of the simulator.
            frames: Names of the coordinate frames.
            scan_period_s: Time between two scans, by default that in whole control
                periods.
            start: Start pose in the map frame, for transforms before the first instant.
        """
        self._config = config
        self._frames = frames
        if scan_period_s is None:
            # A scan comes with the readings of a control step, however fast the lidar
            # turns.
            scan_period_s = config.scan_steps * config.control_period_s
        self._scan_period_s = scan_period_s

        odom_frame = frames.of(topics.ODOM)
        truth_frame = frames.of(topics.GROUND_TRUTH)
        pose_frame = frames.of(topics.AMCL_POSE)
        self._odometry = encode.OdometryEncoder(odom_frame, frames.base)
        self._truth = encode.OdometryEncoder(truth_frame, frames.base)
        self._localization = encode.PoseWithCovarianceEncoder(
            pose_frame, _variances(config.localisation)
        )
        self._joints = encode.JointEncoder(joint_names(config.chassis))
        self._transforms = encode.TransformEncoder(
            [(frames.map, frames.odom), (frames.odom, frames.base)]
        )
        # Made for the first scan, since its template holds the geometry of the beams.
        self._scan: encode.ScanEncoder | None = None
        self._odom_in_map = start
        self._base_in_odom = ORIGIN

    def constant(self) -> Iterator[OutgoingMessage]:
        """Yield the messages published once: robot_description (URDF), tf_static."""
        lidar = self._config.lidar
        chassis = self._config.chassis
        description = encode.encode_text(robot_description(lidar, chassis))
        yield OutgoingMessage(topics.ROBOT_DESCRIPTION, description)

        # A URDF names the lidar's frame itself; the configuration may call it
        # otherwise.
        names = {FRAMES.lidar: self._frames.lidar}
        positions = {}
        for name, position in fixed_frames(lidar, chassis).items():
            positions[names.get(name, name)] = position
        yaws = {self._frames.lidar: lidar.mount_yaw_rad}
        transforms = encode.encode_fixed_transforms(self._frames.base, positions, yaws)
        yield OutgoingMessage(topics.TF_STATIC, transforms)

    def layouts(self) -> list[tuple[Topic, Layout]]:
        """Return topics and layouts of an instant's messages but the scan, in order."""
        return [
            (topics.CLOCK, encode.CLOCK_LAYOUT),
            (topics.ODOM, self._odometry.layout),
            (topics.GROUND_TRUTH, self._truth.layout),
            (topics.AMCL_POSE, self._localization.layout),
            (topics.TF, self._transforms.layout),
            (topics.COLLISION, encode.BOOL_LAYOUT),
            (topics.JOINT_STATES, self._joints.layout),
        ]

    def rows(self, sensors: Sensors, stamp_ns: int) -> Iterable[Sequence[Any]]:
        """Return the values of `layouts`, and keep the poses for the next transforms.

        Args:
            sensors: Readings of the instant.
            stamp_ns: Time of the instant on the clock.
        """
        pose = sensors.odometry.pose
        # As amcl does (REP-105): the localization corrects map to odom, which leaves
        # odom to base smooth.
        self._odom_in_map = sensors.localization @ pose.inverse()
        self._base_in_odom = pose
        joints = sensors.joints
        return (
            divmod(stamp_ns, NANOSECONDS_PER_SECOND),
            self._odometry.row(sensors.odometry, stamp_ns),
            self._truth.row(sensors.truth, stamp_ns),
            self._localization.row(sensors.localization, stamp_ns),
            self._transforms.row((self._odom_in_map, pose), stamp_ns),
            (sensors.collision,),
            self._joints.row((joints.positions, joints.velocities), stamp_ns),
        )

    def sensors(self, sensors: Sensors, stamp_ns: int) -> Iterator[OutgoingMessage]:
        """Yield an instant's serialized messages: clock first, last the scan if new.

        Args:
            sensors: Readings; an older scan is left out.
            stamp_ns: Time of the instant on the clock.
        """
        # The time first, so that nobody receives readings from their future. The scan
        # last: planners answer it and need everything else before.
        rows = self.rows(sensors, stamp_ns)
        for (topic, layout), row in zip(self.layouts(), rows, strict=True):
            yield OutgoingMessage(topic, layout.fill(*row))
        if sensors.scan.stamp_ns == sensors.stamp_ns:
            yield self.scan(sensors.scan, stamp_ns)

    def clock(self, stamp_ns: int) -> OutgoingMessage:
        """Return the serialized clock message of a time in ns."""
        return OutgoingMessage(topics.CLOCK, encode.encode_clock(stamp_ns))

    def odometry(self, odometry: Odometry, stamp_ns: int) -> OutgoingMessage:
        """Return the serialized odom message.

        Args:
            odometry: Pose and velocity in the odom frame.
            stamp_ns: Time on the clock.
        """
        return OutgoingMessage(topics.ODOM, self._odometry.encode(odometry, stamp_ns))

    def truth(self, truth: Odometry, stamp_ns: int) -> OutgoingMessage:
        """Return the serialized ground-truth message.

        Args:
            truth: Pose in the map frame and velocity.
            stamp_ns: Time on the clock.
        """
        return OutgoingMessage(topics.GROUND_TRUTH, self._truth.encode(truth, stamp_ns))

    def localization(
        self, pose: Pose2D, odometry: Pose2D, stamp_ns: int
    ) -> OutgoingMessage:
        """Return the amcl_pose message, and keep map to odom for the next transforms.

        Args:
            pose: Estimate in the map frame.
            odometry: Pose in the odom frame at the same time.
            stamp_ns: Time on the clock.
        """
        self._odom_in_map = pose @ odometry.inverse()
        return OutgoingMessage(
            topics.AMCL_POSE, self._localization.encode(pose, stamp_ns)
        )

    def transforms(self, odometry: Pose2D, stamp_ns: int) -> OutgoingMessage:
        """Keep odom to base; return tf with it and map to odom as last localized.

        Args:
            odometry: Pose in the odom frame.
            stamp_ns: Time on the clock.
        """
        self._base_in_odom = odometry
        return self.last_transforms(stamp_ns)

    def last_transforms(self, stamp_ns: int) -> OutgoingMessage:
        """Return a tf message of the last poses, at first those of the start."""
        poses = [self._odom_in_map, self._base_in_odom]
        return OutgoingMessage(topics.TF, self._transforms.encode(poses, stamp_ns))

    def collision(self, touched: bool) -> OutgoingMessage:
        """Return the collision message: whether the robot has touched anything."""
        return OutgoingMessage(topics.COLLISION, encode.encode_bool(touched))

    def joints(self, joints: Joints, stamp_ns: int) -> OutgoingMessage:
        """Return the serialized joint_states message of the wheels.

        Args:
            joints: Angles and speeds of the wheels.
            stamp_ns: Time on the clock.
        """
        state = (joints.positions, joints.velocities)
        return OutgoingMessage(
            topics.JOINT_STATES, self._joints.encode(state, stamp_ns)
        )

    def scan(self, scan: Scan, stamp_ns: int) -> OutgoingMessage:
        """Return the scan message; the first one fixes the beams of all later ones.

        Args:
            scan: Scan of a lidar whose beams never change.
            stamp_ns: Time on the clock.
        """
        if self._scan is None:
            frame = self._frames.of(topics.SCAN)
            self._scan = encode.ScanEncoder(scan, frame, self._scan_period_s)
        return OutgoingMessage(topics.SCAN, self._scan.encode(scan, stamp_ns))


def _variances(config: LocalizationConfig) -> tuple[float, float, float]:
    """Return the variances of x, y (m2), yaw (rad2) in amcl_pose; 0 in mode exact."""
    # Only the filter of mode amcl has exactly these deviations; of the particles they
    # are what its real counterpart typically states.
    if config.mode == "exact":
        return 0.0, 0.0, 0.0
    position = config.position_std_m**2
    return position, position, config.yaw_std_rad**2
