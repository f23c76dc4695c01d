"""Read a robot's drive from any bag: poses, scans, commands, contacts and goals."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from barn_eval.results.bags.bagfile import BagFile, RawMessage
from barn_eval.results.bags.decode import (
    TOPICS,
    frame_and_content,
    metadata,
)
from barn_eval.results.bags.sources import Sources, TopicChoice
from barn_eval.trials.stamps import number_clocks
from barn_eval.trials.system import NO_CONTACT
from barn_worlds.base.arrays import Integers
from barn_worlds.base.errors import BagError, MessageError, note
from barn_worlds.messages import topics


class Logged(NamedTuple):
    """A message's content and frame, and the time at which it was logged."""

    log_ns: int
    content: Any
    frame: str = ""


@dataclass
class ObservedDrive:
    """A robot's drive, read from a bag, in the order of the log."""

    path: Path
    pose_source: str
    frame: str = ""  # of the poses
    clock: str = "stamps"  # or "log" if poses have no stamps
    poses: list[Logged] = field(default_factory=list)  # Odometry
    goals: list[Logged] = field(default_factory=list)  # Pose2D
    other_goals: str = ""  # topics that may have more, separated by commas
    contacts: list[Logged] = field(default_factory=list)  # bool
    commands: list[Logged] = field(default_factory=list)  # Velocity2D
    scans: list[Logged] = field(default_factory=list)  # Scan
    contact_source: str = NO_CONTACT
    mounts: list[Logged] = field(default_factory=list)  # links of static transforms
    trial: dict[str, Any] = field(default_factory=dict)  # in bags of the suite
    problem: str = ""  # why the bag could not be read to its end

    @cached_property
    def log_times_ns(self) -> Integers:
        """Times (n,) at which the poses were logged; use it only on a complete drive."""
        return np.array([pose.log_ns for pose in self.poses], np.int64)

    @cached_property
    def clocks(self) -> Integers:
        """Number (n,) of the clock of each pose's stamp, -1 if the stamp is wrong."""
        stamps_ns = np.array([pose.content.stamp_ns for pose in self.poses], np.int64)
        return number_clocks(stamps_ns, self.log_times_ns)

    def index_at(self, log_ns: int) -> int:
        """Return the index of the last pose logged by a time, -1 if there is none."""
        return int(np.searchsorted(self.log_times_ns, log_ns, side="right")) - 1


def read_observed_drive(path: Path, sources: Sources) -> ObservedDrive:
    """Read a robot's drive, up to damage that `problem` names; BagError without poses.

    Raises:
        BagError: If the bag cannot be read, or has no poses of a robot.
    """
    bag = BagFile(path)
    choice = TopicChoice(bag, sources)
    reader = choice.pose_reader()
    drive = ObservedDrive(path, reader.name, other_goals=choice.other_goals)
    for message in bag.messages({*choice.paths, *reader.topics}):
        if message.topic in reader.topics:
            for odometry in reader.read(message):
                drive.poses.append(Logged(message.stamp_ns, odometry))
        _take_message(drive, choice, message)
    drive.problem = bag.problem
    if not drive.poses:
        raise reader.missing_error()
    # A file may be out of order.
    for items in (drive.poses, drive.goals):
        items.sort(key=attrgetter("log_ns"))
    if drive.poses[0].log_ns == drive.poses[-1].log_ns:
        raise BagError(
            f"{path}: all its poses were logged at {drive.poses[0].log_ns} ns, so goals,"
            " scans and contacts cannot be assigned to them; record the bag with times"
        )
    drive.frame = reader.frame
    drive.trial = metadata(bag, "barn.trial", "specification")
    if not any(pose.content.stamp_ns for pose in drive.poses):
        drive.clock = "log"
        drive.poses = [
            Logged(log_ns, replace(pose, stamp_ns=log_ns))
            for log_ns, pose, _ in drive.poses
        ]
    return drive


def _take_message(
    drive: ObservedDrive, choice: TopicChoice, message: RawMessage
) -> None:
    """Add a message's content to a drive; if it cannot be decoded, only note that."""
    topic = choice.paths.get(message.topic, "")
    items = {
        topics.GOAL_POSE.path: drive.goals,
        topics.COLLISION.path: drive.contacts,
        topics.CMD_VEL.path: drive.commands,
        topics.SCAN.path: drive.scans,
        topics.TF_STATIC.path: drive.mounts,
    }
    is_contact = topic == topics.COLLISION.path
    if is_contact and choice.sources.contact == NO_CONTACT:
        return
    if topic not in items or message.type_name not in TOPICS[topic]:
        return
    try:
        frame, content = frame_and_content(topic, message.type_name, message.data)
    except MessageError as error:
        note(f"{drive.path}: {message.topic}: messages are ignored: {error}")
        return
    items[topic].append(Logged(message.stamp_ns, content, frame.lstrip("/")))
    if is_contact:
        drive.contact_source = message.topic.removeprefix(choice.sources.namespace)
