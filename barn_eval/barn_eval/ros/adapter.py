"""Feeds a trial with the readings and commands in its messages, tick by tick."""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

from barn_eval.results.bags.decode import decode_planner_status
from barn_eval.ros.sequencer import Message, Tick
from barn_eval.trials.trial import RunningTrial
from barn_worlds.base.errors import MessageError
from barn_worlds.base.types import Odometry, seconds
from barn_worlds.messages import decode


class TrialTopics(NamedTuple):
    """The resolved names of the topics that a trial is judged by."""

    clock: str
    odometry: str
    truth: str
    collision: str
    command: str
    scan: str
    diagnostics: str
    plan: str = "/plan"

    @property
    def of_simulator(self) -> tuple[str, ...]:
        """Resolved names of the five topics that only the simulator may publish."""
        return self.clock, self.scan, self.odometry, self.truth, self.collision


@dataclass
class TrialAdapter:
    """Does with messages what a direct trial does in its loop.

    The readings of a tick are judged first, then the commands that answer them.
    """

    topics: TrialTopics

    # Receives readings, commands, plans and the planner's status.
    trial: RunningTrial

    # Simulated time at which the trial begins; its times count from there.
    origin_ns: int

    # ROS type of the commands.
    command_type: str

    # Frame of the plans that count; plans in other frames are ignored.
    plan_frame: str = "odom"

    # Converts a pose of a system that somebody else runs: to the odom frame, and to the
    # map frame, where it stands for the true pose. None for the suite's simulator.
    convert_pose: Callable[[Odometry], tuple[Odometry, Odometry]] | None = None

    def __post_init__(self) -> None:
        """Begin without readings and commands, at the beginning of the trial."""
        # The simulated time now.
        self.now_ns = self.origin_ns
        # Wall-clock times from scans to the commands that answer them, and their sum.
        self.response_times_s: list[float] = []
        self.waited_s = 0.0
        # Simulated times at which commands came.
        self.commands_ns: list[int] = []
        # The reading that is not judged yet.
        self._odometry: Odometry | None = None
        self._truth: Odometry | None = None
        self._collision = False
        self._unanswered_scan_ns: int | None = None

    def touch(self) -> None:
        """Store a contact without a message; it counts at the next reading."""
        self._collision = True

    def take(self, tick: Tick) -> list[Message]:
        """Judge a tick's messages; return those of the trial, none after a verdict.

        Args:
            tick: A complete tick.

        Returns:
            Its messages that belong to the trial: none if a verdict stood before, and no
            command that came after the verdict in its tick.
        """
        trial_messages: list[Message] = []
        if self.trial.verdict is not None:
            return trial_messages

        self.now_ns = tick.stamp_ns
        for message in tick.messages:
            # A command answers the reading before it, which may end the trial.
            if message.topic == self.topics.command and self._judge_reading():
                continue
            self._take_message(message)
            trial_messages.append(message)
        self._judge_reading()
        return trial_messages

    def _take_message(self, message: Message) -> None:
        """Store a reading (judge one before), or give a message to the trial."""
        topics = self.topics
        match message.topic:
            case topics.odometry:
                self._odometry = self._decode_odometry(message)
                if self.convert_pose is not None:
                    stamp_ns = self.now_ns - self.origin_ns
                    odometry = replace(self._odometry, stamp_ns=stamp_ns)
                    self._odometry, self._truth = self.convert_pose(odometry)
            case topics.truth:
                # A tick has two readings where /clock ticks less often than the robot
                # is measured.
                self._judge_reading()
                self._truth = self._decode_odometry(message)
            case topics.collision:
                # A contact stands until it is judged, even if a later message denies
                # it.
                self._collision = decode.boolean(message.data) or self._collision
            case topics.scan:
                self._unanswered_scan_ns = message.sent_ns
            case topics.diagnostics:
                status = decode_planner_status(message.data)
                if status:
                    self.trial.report(status)
            case topics.plan:
                self._take_plan(message)
            case topics.command:
                self._take_command(message)

    def _take_command(self, message: Message) -> None:
        """Store a command's time and wait since its scan; give it to the trial."""
        self.commands_ns.append(self.now_ns)
        if self._unanswered_scan_ns is not None:
            response_s = seconds(message.sent_ns - self._unanswered_scan_ns)
            self.response_times_s.append(max(0.0, response_s))
            self.waited_s += self.response_times_s[-1]
            self._unanswered_scan_ns = None
        self.trial.command(decode.command(message.data, self.command_type))

    def _take_plan(self, message: Message) -> None:
        """Give the trial a nav_msgs/Path in `plan_frame`; ignore anything else."""
        # A planner may publish something other than a path there.
        with suppress(MessageError):
            header = decode.header(message.data)
            # Frames of ROS 1 began with a slash, and some nodes still send it.
            if header.frame.lstrip("/") == self.plan_frame:
                self.trial.plan(
                    decode.path(message.data), header.stamp_ns - self.origin_ns
                )

    def _judge_reading(self) -> bool:
        """Judge and drop a complete reading; return whether a verdict stands."""
        if (
            self._truth is not None
            and self._odometry is not None
            and self.trial.verdict is None
        ):
            self.trial.read(self._odometry, self._truth, self._collision)
            self._truth = None
            self._collision = False
        return self.trial.verdict is not None

    def _decode_odometry(self, message: Message) -> Odometry:
        """Decode nav_msgs/Odometry, its stamp counted from the trial's beginning."""
        odometry = decode.odometry(message.data)
        return replace(odometry, stamp_ns=odometry.stamp_ns - self.origin_ns)


def count_missed_periods(
    commands_ns: Sequence[int], now_ns: int, period_ns: int, silence_ns: int
) -> int:
    """Return how many periods lack a command; pauses over `silence_ns` count none.

    A command is late once it comes more than half a period after its time.

    Args:
        commands_ns: Simulated times of commands, ascending.
        now_ns: Simulated time at the end.
        period_ns: Control period of the planner.
        silence_ns: Pause after which the robot stands still; a longer pause counts as
            intended.

    Returns:
        Number of missed periods.
    """
    missed = 0
    for earlier_ns, later_ns in pairwise((*commands_ns, now_ns)):
        pause_ns = later_ns - earlier_ns
        if pause_ns <= silence_ns:
            # A pause of one period, give or take half of one, misses none.
            missed += max(0, math.ceil(pause_ns / period_ns - 0.5) - 1)
    return missed


def share_of_missed(
    missed: int, commands_ns: Sequence[int], now_ns: int, period_ns: int
) -> float:
    """Return the share of missed periods since the first command, 0 to 1.

    Args:
        missed: Number of missed periods.
        commands_ns: Simulated times of commands, ascending.
        now_ns: Simulated time at the end.
        period_ns: Control period of the planner.

    Returns:
        At most 1; 0 if less than one period has passed.
    """
    if not commands_ns:
        return 0.0
    periods = (now_ns - commands_ns[0]) / period_ns
    if periods < 1.0:
        return 0.0
    return min(1.0, missed / periods)
