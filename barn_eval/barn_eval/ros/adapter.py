"""From messages to a trial: readings and commands are read off them, tick by tick, and what is recorded is told."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from barn_eval.bags.decode import planner_status
from barn_eval.ros.sequencer import Message, Tick
from barn_eval.trials.trial import RunningTrial
from barn_worlds.base.types import Odometry, Velocity2D, seconds
from barn_worlds.messages import decode


@dataclass(frozen=True)
class TrialTopics:
    """The topics that a trial is judged by, and how to read their messages."""

    clock: str
    odometry: str
    truth: str
    collision: str
    command: str
    scan: str
    diagnostics: str
    read_command: Callable[[bytes], Velocity2D]
    read_odometry: Callable[[bytes], Odometry] = decode.odometry
    read_collision: Callable[[bytes], bool] = decode.boolean
    read_status: Callable[[bytes], str] = planner_status

    def topics(self) -> list[str]:
        """Return the topics without which there is no judgement."""
        return [self.odometry, self.truth, self.collision, self.scan, self.command]


class Punctuality:
    """Counts the control periods of a planner, in simulated time, that went by without a command.

    A command is late once it comes more than half a period after its time. Periods count from the first command on. A
    pause of more than `silence_ns`, after which the robot stands still, is taken for the planner's will.
    """

    def __init__(self, period_ns: int, silence_ns: int) -> None:
        self._period_ns = period_ns
        self._silence_ns = silence_ns
        self._first_ns: int | None = None
        self._last_ns = self._now_ns = 0
        self._missed = 0

    def command(self, now_ns: int) -> None:
        """Take note of a command."""
        if self._first_ns is None:
            self._first_ns = self._last_ns = now_ns
        self.tick(now_ns)
        self._missed += self._without(now_ns)
        self._last_ns = now_ns

    def tick(self, now_ns: int) -> None:
        """Take note of the time."""
        self._now_ns = now_ns

    @property
    def missed(self) -> int:
        """How many periods had no command, up to now."""
        return self._missed + self._without(self._now_ns) if self._first_ns is not None else 0

    def share_of(self, missed: int) -> float:
        """Return so many periods as a share of all, 1 at most."""
        periods = (self._now_ns - self._first_ns) / self._period_ns if self._first_ns is not None else 0.0
        return min(1.0, missed / periods) if periods >= 1.0 else 0.0

    def _without(self, now_ns: int) -> int:
        pause_ns = now_ns - self._last_ns
        return max(0, round(pause_ns / self._period_ns) - 1) if pause_ns <= self._silence_ns else 0


class TrialAdapter:
    """Feed a trial, which begins at `origin_ns`, with what of each tick belongs to it.

    What a direct trial does in one loop is here read off the messages: the readings of a tick are judged, then the
    commands that answer them. Times count from the origin.

    response_times_s: from each scan to the command that follows it, in wall-clock time, transport included; waited_s is
    their sum. punctuality: of its commands.
    """

    def __init__(self, topics: TrialTopics, trial: RunningTrial, origin_ns: int, punctuality: Punctuality) -> None:
        self.response_times_s: list[float] = []
        self.waited_s = 0.0
        self.punctuality = punctuality
        self._topics = topics
        self.trial = trial
        self._origin_ns = origin_ns
        self._odometry: Odometry | None = None
        self._truth: Odometry | None = None
        self._collision = False
        self._scan_sent_ns: int | None = None

    def take(self, tick: Tick) -> list[Message]:
        """Feed a tick and return what of it belongs to the trial: nothing that is sent after the verdict."""
        if tick.stamp_ns < self._origin_ns or self.trial.over:
            return []
        kept = []
        self.punctuality.tick(tick.stamp_ns)
        for message in tick.messages:
            is_command = message.topic == self._topics.command
            if is_command and self._read():
                continue
            if is_command:
                self.punctuality.command(tick.stamp_ns)
            self._take(message)
            kept.append(message)
        self._read()
        return kept

    def _take(self, message: Message) -> None:
        topics = self._topics
        if message.topic == topics.odometry:
            self._odometry = self._from_origin(topics.read_odometry(message.data))
        elif message.topic == topics.truth:
            self._read()  # two readings in one tick: a clock that ticks less often than the robot is measured
            self._truth = self._from_origin(topics.read_odometry(message.data))
        elif message.topic == topics.collision:
            self._collision = topics.read_collision(message.data) or self._collision
        elif message.topic == topics.scan:
            self._scan_sent_ns = message.sent_ns
        elif message.topic == topics.diagnostics:
            if status := topics.read_status(message.data):
                self.trial.report(status)
        elif message.topic == topics.command:
            if self._scan_sent_ns is not None:
                self.response_times_s.append(seconds(message.sent_ns - self._scan_sent_ns))
                self.waited_s += self.response_times_s[-1]
                self._scan_sent_ns = None
            self.trial.command(topics.read_command(message.data))

    def _read(self) -> bool:
        """Hand the reading that has come together to the trial, if there is one; return whether the trial is over."""
        if self._truth is not None and self._odometry is not None and not self.trial.over:
            truth, collision, self._truth, self._collision = self._truth, self._collision, None, False
            self.trial.read(self._odometry, truth, collision)
        return self.trial.over

    def _from_origin(self, odometry: Odometry) -> Odometry:
        return replace(odometry, stamp_ns=odometry.stamp_ns - self._origin_ns)
