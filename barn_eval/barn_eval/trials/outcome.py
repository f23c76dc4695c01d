"""How a trial can end."""

from dataclasses import dataclass
from enum import Enum


class Outcome(str, Enum):
    """The one outcome of a trial."""

    SUCCESS = "success"
    COLLISION = "collision"
    TIMEOUT = "timeout"
    NO_FIRST_MOTION = "no_first_motion"
    PLANNER_NOT_READY = "planner_not_ready"
    PLANNER_DIED = "planner_died"
    PLANNER_STALLED = "planner_stalled"
    WRONG_MESSAGE_TYPE = "wrong_message_type"
    INVALID_COMMAND = "invalid_command"
    SIMULATOR_DIED = "simulator_died"


@dataclass(frozen=True, slots=True)
class Verdict:
    """The judgement on a trial; times are simulated and counted from the trial's first reading.

    traversal_time_s: time on the protocol's clock, None if the clock never started.
    duration_s: time from the first to the last reading. contact_s: time in contact with an obstacle.
    """

    outcome: Outcome
    detail: str
    traversal_time_s: float | None
    duration_s: float
    contact_s: float
