"""How a trial can end, and what that is worth: times, and the challenge metric."""

import math
from dataclasses import dataclass
from enum import Enum

from barn_eval.trials.protocol import Course, Protocol


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
    normalised_time_s_per_m: float | None  # scored time by the path's length
    optimal_time_s: float | None
    # Metric with the clip of today, at most 0.5; unclipped under a protocol without
    # clip.
    challenge: float | None
    challenge_2022: float | None  # with the clip of 2022, at most 0.25
    failure_time_s: float  # the most that a failure would count with
    # No time on the clock can be below it (`TrialSpec.least_time_s`); None: not
    # computed.
    least_time_s: float | None = None
    # The least time by the traversal time of a success, 0 for any other outcome.
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
    """Return the optimal over the clipped traversal time; 0 for anything but a success.

    None for a success where the optimal time is unknown.

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
