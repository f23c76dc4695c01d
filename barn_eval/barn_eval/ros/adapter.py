"""From messages to a trial: readings and commands are read off them, tick by tick, and what is recorded is told."""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

from barn_eval.results.bags.decode import decode_planner_status
from barn_eval.ros.sequencer import Message, Tick
from barn_eval.trials.trial import RunningTrial
from barn_worlds.base.errors import MessageError
from barn_worlds.base.types import Odometry, seconds
from barn_worlds.messages import decode


class TrialTopics(NamedTuple):
    """The topics that a trial is judged by, as they are named."""

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
        """Those that only the simulator publishes."""
        return self.clock, self.scan, self.odometry, self.truth, self.collision


class TrialAdapter:
    """Feed a trial, which begins at `origin_ns`, with what of each tick belongs to it.

    What a direct trial does in one loop is here read off the messages: the readings of a tick are judged, then the
    commands that answer them. Times count from the origin. plan_frame: in which plans count.
    """

    def __init__(
        self,
        topics: TrialTopics,
        trial: RunningTrial,
        origin_ns: int,
        command_type: str,
        plan_frame: str = "odom",
    ) -> None:
        self.trial, self.now_ns, self.waited_s = trial, origin_ns, 0.0
        self.response_times_s: list[
            float
        ] = []  # from scans to commands by the wall clock; waited_s is their sum
        self.commands_ns: list[
            int
        ] = []  # when commands came, the clock being at `now_ns`
        self._topics, self._origin_ns = topics, origin_ns
        self._command_type, self._plan_frame = command_type, plan_frame
        self._odometry: Odometry | None = None
        self._truth: Odometry | None = None
        self._collision = False
        self._scan_sent_ns: int | None = None

    def take(self, tick: Tick) -> list[Message]:
        """Feed a tick and return what of it belongs to the trial: nothing that is sent after the verdict."""
        kept: list[Message] = []
        if self.trial.verdict is not None:
            return kept
        self.now_ns = tick.stamp_ns
        for message in tick.messages:
            if message.topic == self._topics.command and self._read():
                continue
            self._take(message)
            kept.append(message)
        self._read()
        return kept

    def _take(self, message: Message) -> None:
        topics = self._topics
        if message.topic == topics.odometry:
            self._odometry = self._from_origin(decode.odometry(message.data))
        elif message.topic == topics.truth:
            self._read()  # two readings in one tick: a clock that ticks less often than the robot is measured
            self._truth = self._from_origin(decode.odometry(message.data))
        elif message.topic == topics.collision:
            self._collision = decode.boolean(message.data) or self._collision
        elif message.topic == topics.scan:
            self._scan_sent_ns = message.sent_ns
        elif message.topic == topics.diagnostics:
            if status := decode_planner_status(message.data):
                self.trial.report(status)
        elif message.topic == topics.plan:
            self._plan(message)
        elif message.topic == topics.command:
            self._command(message)

    def _command(self, message: Message) -> None:
        self.commands_ns.append(self.now_ns)
        if self._scan_sent_ns is not None:
            self.response_times_s.append(
                max(0.0, seconds(message.sent_ns - self._scan_sent_ns))
            )
            self.waited_s += self.response_times_s[-1]
            self._scan_sent_ns = None
        self.trial.command(decode.command(message.data, self._command_type))

    def _plan(self, message: Message) -> None:
        with suppress(MessageError):  # a planner may publish something else there
            header = decode.header(message.data)
            if header.frame.lstrip("/") == self._plan_frame:
                self.trial.plan(
                    decode.path(message.data), header.stamp_ns - self._origin_ns
                )

    def _read(self) -> bool:
        """Hand the reading that has come together to the trial, if there is one; return whether the trial is over."""
        if (
            self._truth is not None
            and self._odometry is not None
            and self.trial.verdict is None
        ):
            truth, collision, self._truth, self._collision = (
                self._truth,
                self._collision,
                None,
                False,
            )
            self.trial.read(self._odometry, truth, collision)
        return self.trial.verdict is not None

    def _from_origin(self, odometry: Odometry) -> Odometry:
        return replace(odometry, stamp_ns=odometry.stamp_ns - self._origin_ns)


def missed_periods(
    commands_ns: Sequence[int], now_ns: int, period_ns: int, silence_ns: int
) -> int:
    """Return how many control periods went by without a command, in simulated time from the first one to now.

    A command is late once it comes more than half a period after its time. A pause of more than `silence_ns`, after
    which the robot stands still, is taken for the planner's will.
    """
    pauses_ns = (later - earlier for earlier, later in pairwise((*commands_ns, now_ns)))
    return sum(
        max(0, math.ceil(pause_ns / period_ns - 0.5) - 1)
        for pause_ns in pauses_ns
        if pause_ns <= silence_ns
    )


def missed_share(
    missed: int, commands_ns: Sequence[int], now_ns: int, period_ns: int
) -> float:
    """Return missed periods as a share of all from the first command to now, 1 at most."""
    periods = (now_ns - commands_ns[0]) / period_ns if commands_ns else 0.0
    return min(1.0, missed / periods) if periods >= 1.0 else 0.0
