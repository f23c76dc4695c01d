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
    INTERFERENCE = "interference"
    ENVIRONMENT_FAILED = "environment_failed"


# Who failed where a trial is no success. Only what the planner is answerable for counts in its score.
PLANNER, SIMULATOR, ENVIRONMENT = "planner", "simulator", "environment"
_BLAMED = {Outcome.SIMULATOR_DIED: SIMULATOR, Outcome.ENVIRONMENT_FAILED: ENVIRONMENT}


@dataclass(frozen=True, slots=True)
class Verdict:
    """The judgement on a trial; times are simulated and counted from the trial's first reading.

    traversal_time_s: time on the protocol's clock, None if the clock never started.
    duration_s: time from the first to the last reading. contact_s: time in contact with an obstacle. blamed: who
    failed, where the outcome alone does not say.
    """

    outcome: Outcome
    detail: str
    traversal_time_s: float | None
    duration_s: float
    contact_s: float
    blamed: str = ""

    @property
    def fault(self) -> str:
        """Who failed, empty after a success."""
        if self.outcome is Outcome.SUCCESS:
            return ""
        return self.blamed or _BLAMED.get(self.outcome, PLANNER)
