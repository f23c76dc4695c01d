"""How a trial can end, and what that is worth: times, times per metre and the metric of the BARN Challenge."""

import math
from dataclasses import dataclass
from enum import Enum

from barn_eval.trials.protocol import Course, Protocol


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

# A planner that did not drive to the end of a trial; where none did, the command says so by its exit code.
UNDRIVEN_OUTCOMES = (
    Outcome.PLANNER_NOT_READY,
    Outcome.PLANNER_DIED,
    Outcome.PLANNER_STALLED,
    Outcome.WRONG_MESSAGE_TYPE,
    Outcome.INVALID_COMMAND,
)


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
    culprit: str = ""

    @property
    def fault(self) -> str:
        """Who failed, empty after a success."""
        if self.outcome is Outcome.SUCCESS:
            return ""
        return self.culprit or _BLAMED.get(self.outcome, PLANNER)


# Clips of the traversal time in multiples of the optimal time (BARN Challenge rules, since 2024, and in 2022 and 2023).
CHALLENGE_CLIP = (2.0, 8.0)
CHALLENGE_CLIP_2022 = (4.0, 8.0)
UNCLIPPED = (-math.inf, math.inf)  # as before 2022-04-05


@dataclass(frozen=True)
class Scores:
    """Figures of one trial that follow from its verdict and course."""

    success: bool
    traversal_time_s: float | None  # on the protocol's clock, None if it never started
    scored_time_s: (
        float  # the same for a success, what the protocol counts for anything else
    )
    duration_s: float
    path_length_m: float  # arc length
    normalised_time_s_per_m: float  # scored time by the path's length
    optimal_time_s: float
    challenge: float  # metric with the clip of today, at most 0.5; with none under a protocol that is not `clipped`
    challenge_2022: float  # with the clip of 2022, at most 0.25
    failure_time_s: float  # the most that a failure would count with
    least_time_s: float | None = (
        None  # below which no time on the clock can be (`barn_eval.trials.spec`), if computed
    )
    efficiency: float | None = (
        None  # that by the traversal time of a success, 0 for anything else
    )


def score_trial(
    verdict: Verdict,
    course: Course,
    protocol: Protocol,
    least_time_s: float | None = None,
) -> Scores:
    """Return the scores of a trial; the efficiency of a success where the least time is given."""
    scored_s, success_s = scored_time_s(verdict, protocol), _success_s(verdict)
    efficiency = 0.0 if success_s is None else None
    if success_s is not None and least_time_s is not None:
        efficiency = least_time_s / success_s if success_s > 0.0 else 1.0
    return Scores(
        success=verdict.outcome is Outcome.SUCCESS,
        traversal_time_s=verdict.traversal_time_s,
        scored_time_s=scored_s,
        duration_s=verdict.duration_s,
        path_length_m=course.path_length_m,
        normalised_time_s_per_m=scored_s / course.path_length_m,
        optimal_time_s=course.optimal_time_s,
        challenge=challenge_metric(
            verdict,
            course.optimal_time_s,
            CHALLENGE_CLIP if protocol.clipped else UNCLIPPED,
        ),
        challenge_2022=challenge_metric(
            verdict, course.optimal_time_s, CHALLENGE_CLIP_2022
        ),
        failure_time_s=max(protocol.failure_time_s, protocol.timeout_time_s),
        least_time_s=least_time_s,
        efficiency=efficiency,
    )


def _success_s(verdict: Verdict) -> float | None:
    return verdict.traversal_time_s if verdict.outcome is Outcome.SUCCESS else None


def scored_time_s(verdict: Verdict, protocol: Protocol) -> float:
    """Return the time that a trial counts with under a protocol."""
    if (success_s := _success_s(verdict)) is not None:
        return success_s
    return (
        protocol.timeout_time_s
        if verdict.outcome is Outcome.TIMEOUT
        else protocol.failure_time_s
    )


def challenge_metric(
    verdict: Verdict, optimal_time_s: float, clip: tuple[float, float] = CHALLENGE_CLIP
) -> float:
    """Return optimal time / traversal time clipped to multiples of the optimal time; 0 for anything but a success."""
    if (success_s := _success_s(verdict)) is None:
        return 0.0
    return optimal_time_s / min(
        max(success_s, clip[0] * optimal_time_s), clip[1] * optimal_time_s
    )
