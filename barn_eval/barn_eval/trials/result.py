"""The result of one trial: what was run, how it ended, its scores and measures."""

import base64
import binascii
import json
import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any

import numpy as np

from barn_eval.trials.encounters import Encounters
from barn_eval.trials.protocol import Course, Protocol
from barn_eval.trials.system import ObservedTrial
from barn_eval.trials.trajectory import Measures
from barn_worlds.base.config import OPTIONAL, as_dict, from_dict
from barn_worlds.base.errors import ConfigError, ExitCode, format_value
from barn_worlds.base.files import as_mapping, parse_json


class Outcome(str, Enum):
    """The one outcome of a trial."""

    SUCCESS = "success"
    COLLISION = "collision"
    LEFT_WORLD = "left_world"
    TIMEOUT = "timeout"
    NO_FIRST_MOTION = "no_first_motion"
    PLANNER_NOT_READY = "planner_not_ready"
    PLANNER_DIED = "planner_died"
    PLANNER_STALLED = "planner_stalled"
    WRONG_MESSAGE_TYPE = "wrong_message_type"
    INVALID_COMMAND = "invalid_command"
    SIMULATOR_DIED = "simulator_died"
    INTERFERENCE = "interference"
    ENVIRONMENT_FAILED = "environment_failed"
    ROBOT_TIPPED = "robot_tipped"

    @property
    def words(self) -> str:
        """The outcome's value with spaces in place of underscores, for texts."""
        return self.value.replace("_", " ")


# Who failed in a trial that is no success. Only the planner's failures count in its
# score.
PLANNER = "planner"
SIMULATOR = "simulator"
ENVIRONMENT = "environment"
_CULPRITS = {
    Outcome.SIMULATOR_DIED: SIMULATOR,
    Outcome.ENVIRONMENT_FAILED: ENVIRONMENT,
    Outcome.ROBOT_TIPPED: ENVIRONMENT,
}

# The planner did not drive to the end. If no trial of a run has another outcome, the
# command's exit code says so.
UNDRIVEN_OUTCOMES = (
    Outcome.PLANNER_NOT_READY,
    Outcome.PLANNER_DIED,
    Outcome.PLANNER_STALLED,
    Outcome.WRONG_MESSAGE_TYPE,
    Outcome.INVALID_COMMAND,
)


@dataclass(frozen=True, slots=True)
class Verdict:
    """The decision about a trial; times are simulated, from the first reading on."""

    outcome: Outcome
    detail: str
    traversal_time_s: float | None  # on the clock, None if it never started
    duration_s: float  # from the first to the last reading
    contact_s: float  # in contact with an obstacle
    culprit: str = ""  # who failed, where the outcome alone does not say

    @property
    def success_time_s(self) -> float | None:
        """Seconds on the clock of a success, None for any other outcome."""
        return self.traversal_time_s if self.outcome is Outcome.SUCCESS else None

    @property
    def fault(self) -> str:
        """Who failed: planner, simulator or environment; empty after a success."""
        if self.outcome is Outcome.SUCCESS:
            return ""
        return self.culprit or _CULPRITS.get(self.outcome, PLANNER)


# Clips of the traversal time in multiples of the optimal time: those of the BARN
# Challenge since 2024, those of 2022 and 2023, and none, as before 2022-04-05.
CHALLENGE_CLIP = (2.0, 8.0)
CHALLENGE_CLIP_2022 = (4.0, 8.0)
UNCLIPPED = (-math.inf, math.inf)


@dataclass(frozen=True)
class Scores:
    """Figures of one trial that follow from its verdict and course."""

    success: bool
    traversal_time_s: float | None  # on the protocol's clock, None if it never started
    scored_time_s: float  # of a success; of a failure, what the protocol counts
    duration_s: float
    path_length_m: float | None  # arc length of the world's path, None if unknown
    normalised_time_s_per_m: float | None  # scored time over the path's length
    optimal_time_s: float | None
    # Metric with the clip of today, at most 0.5; unclipped under a protocol without
    # clip.
    challenge: float | None
    challenge_2022: float | None  # with the clip of 2022, at most 0.25
    failure_time_s: float  # the most that a failure would count with
    # No time on the clock can be below it (`TrialSpec.least_time_s`); None: not
    # computed.
    least_time_s: float | None = None
    # The least time over the traversal time of a success; 0 for any other outcome.
    efficiency: float | None = None


def score_trial(
    verdict: Verdict,
    course: Course,
    protocol: Protocol,
    least_time_s: float | None = None,
) -> Scores:
    """Return a verdict's scored time, challenge metrics, efficiency and lengths.

    The efficiency of a success is None without `least_time_s`, that of a failure 0.

    Args:
        verdict: How the trial ended.
        course: Start, goal and lengths of its world.
        protocol: Rules that the trial follows.
        least_time_s: Lower bound of the time on the clock, for the efficiency.
    """
    efficiency: float | None = None
    time_s = verdict.success_time_s
    if time_s is None:
        is_timeout = verdict.outcome is Outcome.TIMEOUT
        scored_time_s = (
            protocol.timeout_time_s if is_timeout else protocol.failure_time_s
        )
        efficiency = 0.0
    else:
        scored_time_s = time_s
        if least_time_s is not None:
            # The clock may start at the very reading that shows the arrival.
            efficiency = least_time_s / time_s if time_s > 0.0 else 1.0

    length_m = course.path_length_m
    optimal_s = course.optimal_time_s
    clip = CHALLENGE_CLIP if protocol.clipped else UNCLIPPED
    return Scores(
        success=verdict.outcome is Outcome.SUCCESS,
        traversal_time_s=verdict.traversal_time_s,
        scored_time_s=scored_time_s,
        duration_s=verdict.duration_s,
        path_length_m=length_m,
        normalised_time_s_per_m=None if length_m is None else scored_time_s / length_m,
        optimal_time_s=optimal_s,
        challenge=challenge_metric(verdict, optimal_s, clip),
        challenge_2022=challenge_metric(verdict, optimal_s, CHALLENGE_CLIP_2022),
        failure_time_s=protocol.longest_failure_time_s,
        least_time_s=least_time_s,
        efficiency=efficiency,
    )


def challenge_metric(
    verdict: Verdict,
    optimal_time_s: float | None,
    clip: tuple[float, float] = CHALLENGE_CLIP,
) -> float | None:
    """Return optimal over clipped time; 0 for a failure, None if no optimum is known.

    Args:
        verdict: How the trial ended.
        optimal_time_s: Length of the course at the reference speed, None if unknown.
        clip: Shortest and longest time that count, in multiples of the optimal time.
    """
    time_s = verdict.success_time_s
    if time_s is None:
        return 0.0
    if optimal_time_s is None:
        return None
    shortest, longest = clip
    time_s = max(time_s, shortest * optimal_time_s)
    return optimal_time_s / min(time_s, longest * optimal_time_s)


# Compute modes: what a trial charges for a planner's computing, in simulated time.
DECLARED = "declared"
MEASURED = "measured"
FREE = "free"
REAL_TIME = "real_time"  # all that it takes, as the simulator does not wait

# A planner that declares nothing is charged as declared, too: nothing.
COMPUTE_MODE_LABELS = {
    DECLARED: "computing as declared",
    FREE: "computing as declared",
    MEASURED: "computing as measured",
    REAL_TIME: "computing in real time",
}

# Share of control periods without a command in time, in a trial that is not marked.
MAX_MISSED_SHARE = 0.02

# Of rows and run.json. It rises whenever their keys change, as a test holds. Rows of
# earlier schemas lack some keys of later ones.
SCHEMA_VERSION = 7
READABLE_SCHEMAS = range(2, SCHEMA_VERSION + 1)
_MAX_DELAY_BYTES = 1 << 24


@dataclass(frozen=True)
class WallClock:
    """Wall-clock figures, the only ones of a result that do not repeat."""

    duration_s: float = 0.0
    real_time_factor: float | None = None

    # Time of the planner per cycle, over ROS from scan to command; None without
    # commands.
    compute_p50_ms: float | None = None
    compute_p95_ms: float | None = None
    compute_max_ms: float | None = None

    # By which clock: "processor", or over ROS "wall", which includes waits for the
    # planner and the transport.
    compute_clock: str = ""

    # Over ROS, the rate of a planner that does not answer each scan, and whether it is
    # "declared" or "found" in lockstep.
    planner_rate_hz: float | None = None
    rate_source: str = ""

    # Factor from processor time here to that on the reference computer
    # (`barn_eval.running.direct.pace`); waiting takes equally long on both.
    pace: float | None = None

    # Speed of the computer that the score of a direct trial assumes, if it charges
    # nothing or what is declared: the 95th percentile on the reference computer over
    # the time that a cycle may take. `note` says so if that computer is too slow.
    computer: float | None = None
    note: str = ""

    # Control periods without a command in time over ROS, and their share of all since
    # the first command.
    missed_cycles: int = 0
    missed_share: float = 0.0

    # When (UTC, ISO 8601), where and at which attempt the trial ran, and why each
    # earlier attempt was given up after the robot had been released.
    started_at: str = ""
    worker: str = ""
    attempts: int = 1
    repeated: str = ""

    @classmethod
    def from_answer_times(
        cls,
        duration_s: float,
        real_time_factor: float | None,
        answer_times_s: Sequence[float],
        **fields: Any,
    ) -> "WallClock":
        """Return figures with median, 95% and maximum in ms; None without answers.

        Args:
            duration_s: Wall-clock time that the trial took.
            real_time_factor: Simulated over wall-clock time, if that makes sense.
            answer_times_s: What the planner took for each answer.
            **fields: Fields about the clock, the rate and commands that came late.
        """
        times_ms: list[Any] = [None] * 3
        if answer_times_s:
            percentiles_s = np.percentile(answer_times_s, [50.0, 95.0, 100.0])
            times_ms = (1e3 * percentiles_s).tolist()
        return cls(duration_s, real_time_factor, *times_ms, **fields)

    def with_pace(
        self,
        pace: float,
        reference_times_s: Sequence[float],
        allowed_s: float,
        compute_mode: str,
    ) -> "WallClock":
        """Return a copy with `pace` and, if FREE or DECLARED, the assumed computer.

        The computer needs an answer, too.

        Args:
            pace: Reference seconds per second of this machine.
            reference_times_s: What each cycle takes on the reference computer, which is
                what the mode MEASURED charges.
            allowed_s: Time that a cycle may take.
            compute_mode: How the planner's computing is charged.
        """
        if compute_mode not in (FREE, DECLARED) or not reference_times_s:
            return replace(self, pace=pace)
        computer = float(np.percentile(reference_times_s, 95.0)) / allowed_s
        note = describe_computer(computer)
        return replace(self, pace=pace, computer=computer, note=note)

    @property
    def is_late(self) -> bool:
        """Whether over 2% of control periods over ROS had no command in time."""
        return self.missed_share > MAX_MISSED_SHARE

    @property
    def remark(self) -> str:
        """Text on missed control periods if `is_late`, and the note; may be empty."""
        if not self.is_late:
            return self.note
        missed = (
            f"{self.missed_cycles} control periods ({self.missed_share:.1%}) without a"
            " command in time"
        )
        return f"{missed}; {self.note}" if self.note else missed

    @property
    def retry_note(self) -> str:
        """Text on which attempt this was and why others failed; empty for the first."""
        if self.attempts <= 1:
            return ""
        return f"attempt {self.attempts} ({self.repeated or 'its worker was lost'})"


@dataclass(frozen=True)
class TrialResult:
    """One row of results; rows of earlier versions lack some of the later fields."""

    trial_id: str
    dataset: str
    world: int
    world_name: str
    world_checksum: str  # of the world's grid and path
    planner: str
    preset: str
    protocol: str
    mode: str
    repetition: int
    campaign_seed: int
    simulator_seed: int
    planner_seed: int
    outcome: Outcome
    detail: str
    scores: Scores
    measures: Measures
    recoveries: int | None = None  # times the planner began one, None if not known
    # What the planner's own action says of the trial, None without an action.
    planner_verdict: str | None = None
    task: str = ""  # fingerprint of protocol, simulator and robot
    # Fingerprint of the planner's configuration, or of its command or source; empty for
    # a planner that was started by hand.
    planner_config: str = ""
    metric: str = ""  # the measure that the protocol ranks planners by
    fault: str = (
        ""  # who failed: planner, simulator or environment; empty after a success
    )
    remarks: str = ""  # anything else that matters, such as who subscribed to the truth
    # The highest speed that the robot took from the planner: what that declared, or
    # else the robot's own limit. None if unknown.
    speed_cap_mps: float | None = None
    compute: str = ""  # the compute mode
    # Delays that were measured, as `pack_delays` packs them.
    delays: str = field(default="", metadata=OPTIONAL)
    # Only in rows of worlds in which obstacles move.
    motion: Encounters | None = field(default=None, metadata=OPTIONAL)
    # Only in rows of trials that the suite observed and did not drive.
    observed: ObservedTrial | None = field(default=None, metadata=OPTIONAL)
    wall_clock: WallClock = field(default_factory=WallClock)
    schema_version: int = SCHEMA_VERSION

    @property
    def is_scored(self) -> bool:
        """Whether the row counts: neither simulator nor environment has failed.

        A trial whose row does not count runs again.
        """
        return self.fault not in (SIMULATOR, ENVIRONMENT)

    def repeatable(self) -> dict[str, Any]:
        """Return the row as nested plain data that a rerun repeats: no `wall_clock`."""
        content = as_dict(self)
        del content["wall_clock"]
        return content


Rows = Sequence[TrialResult]
RowsByPlanner = Mapping[str, Rows]


def exit_code(results: Rows) -> int:
    """Return DONE; NOT_SCORED without rows, if one is not scored, or none was driven.

    Args:
        results: All rows of the run.
    """
    is_driven = any(row.outcome not in UNDRIVEN_OUTCOMES for row in results)
    if is_driven and all(row.is_scored for row in results):
        return ExitCode.DONE
    return ExitCode.NOT_SCORED


def describe_computer(computer: float) -> str:
    """Return text on a computer this many times as fast as the reference; empty up to 1.

    A remark in a row says so that its score assumes such a computer.
    """
    if computer <= 1.0:
        return ""
    return f"its score assumes a computer {computer:.2g} times as fast"


def pack_delays(delays_ns: Sequence[int]) -> str:
    """Return delays in ns as base64 text of zlib data, rounded down to microseconds."""
    delays_us = np.array(delays_ns, np.int64) // 1000
    # Differences between neighbors are small numbers, which pack well.
    differences = np.diff(delays_us, prepend=0).astype("<i4")
    return base64.b64encode(zlib.compress(differences.tobytes(), 9)).decode()


def unpack_delays(text: str) -> tuple[int, ...]:
    """Return delays in ns from text of `pack_delays`; ConfigError if it is damaged."""
    try:
        packed = base64.b64decode(text, validate=True)
        # Rows may come from anybody, and a short text may unpack to gigabytes.
        data = zlib.decompressobj().decompress(packed, _MAX_DELAY_BYTES)
        differences = np.frombuffer(data, "<i4")
    except (binascii.Error, zlib.error, ValueError) as error:
        raise ConfigError(f"delays of a row cannot be read: {error}") from None
    return tuple((1000 * np.cumsum(differences, dtype=np.int64)).tolist())


def format_trial_id(planner: str, world_number: int, repetition: int) -> str:
    """Return the name of a trial, such as "dwa_w0012_r00", also of its bag and picture.

    Args:
        planner: Name of the planner.
        world_number: Number of the world in its data set.
        repetition: Number of the trial among those in its world, from 0.
    """
    return f"{planner}_w{world_number:04d}_r{repetition:02d}"


def to_json_line(result: TrialResult) -> str:
    """Return a row as JSON without newline and checksum; ValueError for NaN."""
    return json.dumps(as_dict(result), allow_nan=False, separators=(",", ":"))


def from_json_line(line: str, where: str) -> TrialResult:
    """Return the row in a line of JSON without checksum; ConfigError if it is none.

    Args:
        line: The line without its checksum.
        where: File and line, with which messages begin.

    Raises:
        ConfigError: The line is no result that this version reads.
    """
    return row_from_plain(parse_json(line, where), where)


def row_from_plain(content: Any, where: str) -> TrialResult:
    """Return the row from parsed JSON of a readable schema; ConfigError if it is none.

    Args:
        content: Plain data.
        where: File and line, with which messages begin.

    Raises:
        ConfigError: They are no result that this version reads.
    """
    require_schema(content, where)
    return from_dict(TrialResult, content, where)


def require_schema(content: Any, where: str) -> None:
    """Raise ConfigError unless `schema_version` of a row or run.json can be read.

    Args:
        content: Plain data.
        where: Beginning of the message.
    """
    version = as_mapping(content).get("schema_version")
    if version not in READABLE_SCHEMAS:
        readable = " or ".join(map(str, READABLE_SCHEMAS))
        raise ConfigError(
            f"{where}: schema_version must be {readable}, got {format_value(version)}"
        )
