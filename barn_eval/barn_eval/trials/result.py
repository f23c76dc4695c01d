"""The result of one trial: a flat record of what was run, how it ended and how it scored."""

import base64
import binascii
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from barn_eval.trials.outcome import ENVIRONMENT, SIMULATOR, Outcome, Scores
from barn_eval.trials.trajectory import Encounters, Measures
from barn_worlds.base.config import OPTIONAL, as_dict, from_dict
from barn_worlds.base.errors import ConfigError, format_value
from barn_worlds.base.text_files import parse_json

# What a trial charges for a planner's computing, in simulated time: what it declares; what is measured; nothing; or,
# where the simulator does not wait, all that it takes.
DECLARED, MEASURED, FREE, REAL_TIME = "declared", "measured", "free", "real_time"
# The same in words.
COMPUTE_MODE_LABELS = dict.fromkeys(
    (DECLARED, FREE), "computing as declared"
)  # which is nothing for the latter
COMPUTE_MODE_LABELS |= {
    MEASURED: "computing as measured",
    REAL_TIME: "computing in real time",
}
MAX_MISSED_SHARE = 0.02  # share of control periods without a command in time, in a trial that is not marked
SCHEMA_VERSION = 2
_MOST_DELAY_BYTES = 1 << 24


@dataclass(frozen=True)
class WallClock:
    """Wall-clock figures, the only ones of a result that do not repeat.

    compute_*_ms: time a planner took per cycle, over ROS from scan to command; None where there was no command.
    pace: of the machine, by which these become times on the reference computer (`barn_eval.running.direct.pace`).
    computer: of a direct trial that charges nothing or what is declared, the 95th percentile there by the control
    period, or by the declared delay if that is longer: how fast a computer its score assumes; note: the same in words,
    where the planner does not fit.
    missed_cycles: control periods without a command in time (ros mode); missed_share: of all since the first command.
    started_at, worker, attempts: of a campaign's trial: when (UTC, ISO 8601), where, and at which attempt it ran.
    repeated: why each attempt before that one had to be given up after the robot had been released.
    """

    duration_s: float = 0.0
    real_time_factor: float | None = None
    compute_p50_ms: float | None = None
    compute_p95_ms: float | None = None
    compute_max_ms: float | None = None
    pace: float | None = None
    computer: float | None = None
    note: str = ""
    missed_cycles: int = 0
    missed_share: float = 0.0
    started_at: str = ""
    worker: str = ""
    attempts: int = 1
    repeated: str = ""

    @classmethod
    def from_answer_times(
        cls,
        duration_s: float,
        factor: float | None,
        answer_times_s: Sequence[float],
        **missed: Any,
    ) -> "WallClock":
        """Return the figures of a trial whose planner took these times to answer; none of its own without any."""
        shares = [50.0, 95.0, 100.0]
        times_ms = (
            (1e3 * np.percentile(answer_times_s, shares)).tolist()
            if answer_times_s
            else [None] * 3
        )
        return cls(duration_s, factor, *times_ms, **missed)

    def with_pace(self, pace: float, allowed_s: float, mode: str) -> "WallClock":
        """Return the figures of a machine of that pace, which say whether cycles fit the time that they may take."""
        if mode not in (FREE, DECLARED) or self.compute_p95_ms is None:
            return replace(self, pace=pace)
        computer = 1e-3 * self.compute_p95_ms * pace / allowed_s
        return replace(
            self, pace=pace, computer=computer, note=describe_computer(computer)
        )

    @property
    def is_late(self) -> bool:
        """Whether so many commands were late that the score tells of the machine as well as of the planner."""
        return self.missed_share > MAX_MISSED_SHARE

    @property
    def remark(self) -> str:
        """How late commands were, in words; an empty text if the trial is not marked for it."""
        missed = f"{self.missed_cycles} control periods ({self.missed_share:.1%}) without a command in time"
        return "; ".join(filter(None, (missed if self.is_late else "", self.note)))

    @property
    def retry_note(self) -> str:
        """At which attempt the trial was made and why not at the first, in words; empty for the first."""
        return (
            f"attempt {self.attempts} ({self.repeated or 'its worker was lost'})"
            if self.attempts > 1
            else ""
        )


@dataclass(frozen=True)
class TrialResult:
    """One row of results.

    world_checksum: of the world's grid and path. recoveries: times the planner began a recovery (None: not known).
    planner_verdict: what the planner itself said of the trial, as the result of its action (None: it was not asked).
    task: fingerprint of protocol, simulator and robot. planner_config: that of the planner's configuration, or of its
    command or source (`barn_eval.trials.identity`), empty for a planner started by hand. metric: the measure that the
    protocol ranks planners by. fault: who failed: planner, simulator or environment; empty after a success. remarks:
    what else is to be known, such as who subscribed to the truth. motion: of worlds in which obstacles move, whose rows
    alone have it. speed_cap_mps: the highest speed that the robot took from the planner: what that declared, or else
    the robot's own limit. compute: what was charged for the planner's computing: "declared", "measured", "free" or
    "real_time". delays: those that were measured, packed by `pack_delays`. Older rows lack some of these.
    """

    trial_id: str
    dataset: str
    world: int
    world_name: str
    world_checksum: str
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
    recoveries: int | None = None
    planner_verdict: str | None = None
    task: str = ""
    planner_config: str = ""
    metric: str = ""
    fault: str = ""
    remarks: str = ""
    speed_cap_mps: float | None = None
    compute: str = ""
    delays: str = field(default="", metadata=OPTIONAL)
    motion: Encounters | None = field(default=None, metadata=OPTIONAL)
    wall_clock: WallClock = field(default_factory=WallClock)
    schema_version: int = SCHEMA_VERSION

    @property
    def is_scored(self) -> bool:
        """Whether the planner is answerable for how the trial ended; if not, it is to be run again."""
        return self.fault not in (SIMULATOR, ENVIRONMENT)

    def repeatable(self) -> dict[str, Any]:
        """Return the result as plain data without its wall-clock figures."""
        content = as_dict(self)
        del content["wall_clock"]
        return content


Rows = Sequence[TrialResult]
RowsByPlanner = Mapping[str, Rows]  # by planner


def describe_computer(computer: float) -> str:
    """Return in words what kind of computer a score assumes, empty where the reference computer will do."""
    return (
        f"its score assumes a computer {computer:.2g} times as fast"
        if computer > 1.0
        else ""
    )


def pack_delays(delays_ns: Sequence[int]) -> str:
    """Return delays in whole microseconds as a text."""
    whole = np.diff(np.array(delays_ns, np.int64) // 1000, prepend=0).astype("<i4")
    return base64.b64encode(zlib.compress(whole.tobytes(), 9)).decode()


def unpack_delays(text: str) -> tuple[int, ...]:
    """Return delays in ns of a text; ConfigError where it holds none."""
    try:
        stream = zlib.decompressobj()
        data = stream.decompress(
            base64.b64decode(text, validate=True), _MOST_DELAY_BYTES
        )
        return tuple(
            (1000 * np.cumsum(np.frombuffer(data, "<i4"), dtype=np.int64)).tolist()
        )
    except (binascii.Error, zlib.error, ValueError) as error:
        raise ConfigError(f"delays of a row cannot be read: {error}") from None


def format_trial_id(planner: str, world: int, repetition: int) -> str:
    """Return the name of a trial, which is also that of its bag and picture."""
    return f"{planner}_w{world:04d}_r{repetition:02d}"


def to_json_line(result: TrialResult) -> str:
    """Return a result as one line of JSON without the line's end."""
    return json.dumps(as_dict(result), allow_nan=False, separators=(",", ":"))


def from_json_line(line: str, where: str) -> TrialResult:
    """Return the result of a line of JSON; ConfigError, beginning with `where`, if it is not one."""
    content = parse_json(line, where)
    version = content.get("schema_version") if isinstance(content, dict) else None
    if version != SCHEMA_VERSION:
        raise ConfigError(
            f"{where}: schema_version must be {SCHEMA_VERSION}, got {format_value(version)}"
        )
    return from_dict(TrialResult, content, where)
