"""Simulated trials with the shape of real ones.

Worlds differ, trials of a world are alike, and failures have a value of their own.
Times resemble DWA's under the paper's protocol, scores the challenge's at 0.5 m/s.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from barn_eval.analysis.statistics import TrialValues
from barn_worlds.base.arrays import Floats, Integers

REPETITIONS = 3
FAILURE_SHARE = 0.07
# Correlation of failures within a world.
CORRELATION = 0.67
# Times per meter [s/m]: geometric mean, spread of their logarithm over worlds and
# within a world, and the value of a failure.
TIME_S_PER_M = 2.9
TIME_WORLD_SPREAD = 0.2
TIME_TRIAL_SPREAD = 0.1
FAILURE_S_PER_M = 10.0
# Scores: mean, spread over worlds and within a world, and the best possible one.
SCORE = 0.28
SCORE_WORLD_SPREAD = 0.04
SCORE_TRIAL_SPREAD = 0.02
BEST_SCORE = 0.5


def draw_failure_chances(
    share: float, correlation: float, worlds: int, generator: np.random.Generator
) -> Floats:
    """Draw a chance of failure for each world (beta-binomial trials).

    Args:
        share: Mean of the chances.
        correlation: Of two trials of a world.
        worlds: Number of worlds.
        generator: Source of randomness.

    Returns:
        Chances (worlds,).
    """
    size = 1.0 / correlation - 1.0
    return generator.beta(share * size, (1.0 - share) * size, worlds)


def draw_trials(
    repetitions: int,
    failure_chances: Floats,
    draw_values: Callable[[Integers], Floats],
    generator: np.random.Generator,
    failure_value: float,
    best_value: float = 0.0,
) -> TrialValues:
    """Draw trials in each world.

    Args:
        repetitions: Trials in each world.
        failure_chances: Chance of each world (worlds,).
        draw_values: Draws values of successes for the worlds of trials (trials,).
        generator: Source of randomness.
        failure_value: What a failure counts.
        best_value: Best possible value.

    Returns:
        The trials, world by world.
    """
    worlds = np.repeat(np.arange(len(failure_chances)), repetitions)
    repetition = np.tile(np.arange(repetitions), len(failure_chances))
    values = draw_values(worlds)
    failed = generator.random(len(worlds)) < failure_chances[worlds]
    return TrialValues(
        np.where(failed, failure_value, values),
        worlds,
        repetition,
        failed.astype(np.int64),
        np.full(len(worlds), failure_value),
        best_value,
    )


def draw_equal_planners(
    count: int, worlds: int, generator: np.random.Generator
) -> list[TrialValues]:
    """Draw times per meter of planners that are alike in each world.

    Args:
        count: Number of planners.
        worlds: Number of worlds.
        generator: Source of randomness.

    Returns:
        Trials of each planner: the same chances of failure and mean times of successes,
        and draws of its own.
    """
    failure_chances = draw_failure_chances(
        FAILURE_SHARE, CORRELATION, worlds, generator
    )
    log_means = np.log(TIME_S_PER_M) + generator.normal(0.0, TIME_WORLD_SPREAD, worlds)

    def draw_times(world: Integers) -> Floats:
        deviations = generator.normal(0.0, TIME_TRIAL_SPREAD, len(world))
        times_s_per_m: Floats = np.exp(log_means[world] + deviations)
        return times_s_per_m

    return [
        draw_trials(
            REPETITIONS, failure_chances, draw_times, generator, FAILURE_S_PER_M
        )
        for _ in range(count)
    ]


def draw_scores(
    failure_percent: float,
    scale: float,
    world_effects: Floats,
    repetitions: int,
    generator: np.random.Generator,
) -> TrialValues:
    """Draw scores of a planner, which are 0 for failures.

    Args:
        failure_percent: Share of failures [%], 0 for none.
        scale: Factor on the scores of successes.
        world_effects: Effect of each world on its scores (worlds,).
        repetitions: Trials in each world.
        generator: Source of randomness.

    Returns:
        Trials whose mean is `SCORE` times scale times the share of successes.
    """
    worlds = len(world_effects)
    failure_chances = np.zeros(worlds)
    if failure_percent:
        share = failure_percent / 100.0
        failure_chances = draw_failure_chances(share, CORRELATION, worlds, generator)

    def draw_values(world: Integers) -> Floats:
        noise = generator.normal(0.0, SCORE_TRIAL_SPREAD, len(world))
        return scale * (SCORE + world_effects[world]) + noise

    return draw_trials(
        repetitions, failure_chances, draw_values, generator, 0.0, BEST_SCORE
    )


def draw_planner(
    worlds: int,
    repetitions: int,
    failure_percent: float,
    generator: np.random.Generator,
) -> TrialValues:
    """Draw scores of a planner in worlds of random effects.

    Args:
        worlds: Number of worlds.
        repetitions: Trials in each world.
        failure_percent: Share of failures [%].
        generator: Source of randomness.

    Returns:
        The trials.
    """
    effects = generator.normal(0.0, SCORE_WORLD_SPREAD, worlds)
    return draw_scores(failure_percent, 1.0, effects, repetitions, generator)


def draw_pair(
    worlds: int,
    repetitions: int,
    failure_percents: tuple[float, float],
    ratio: float,
    generator: np.random.Generator,
) -> tuple[TrialValues, TrialValues]:
    """Draw scores of two planners in the same worlds.

    Args:
        worlds: Number of worlds.
        repetitions: Trials in each world.
        failure_percents: Shares of failures [%].
        ratio: Mean of the second planner by that of the first.
        generator: Source of randomness.

    Returns:
        Trials of both planners.
    """
    effects = generator.normal(0.0, SCORE_WORLD_SPREAD, worlds)
    first_successes = 1.0 - failure_percents[0] / 100.0
    second_successes = 1.0 - failure_percents[1] / 100.0
    scale = ratio * first_successes / second_successes
    first = draw_scores(failure_percents[0], 1.0, effects, repetitions, generator)
    second = draw_scores(failure_percents[1], scale, effects, repetitions, generator)
    return first, second


def draw_slow_pair(
    worlds: int,
    repetitions: int,
    slow_percent: float,
    factor: float,
    generator: np.random.Generator,
) -> list[TrialValues]:
    """Draw times per meter of two planners of equal mean that never fail.

    Args:
        worlds: Number of worlds.
        repetitions: Trials in each world.
        slow_percent: Share of slow trials of the second planner [%].
        factor: How many times as long these take.
        generator: Source of randomness.

    Returns:
        Trials of both planners.
    """
    log_means = np.log(TIME_S_PER_M) + generator.normal(0.0, TIME_WORLD_SPREAD, worlds)

    def draw_times(world: Integers, share: float) -> Floats:
        deviations = generator.normal(0.0, TIME_TRIAL_SPREAD, len(world))
        is_slow = generator.random(len(world)) < share
        mean_factor = 1.0 + share * (factor - 1.0)
        factors = np.where(is_slow, factor, 1.0) / mean_factor
        times_s_per_m: Floats = np.exp(log_means[world] + deviations) * factors
        return times_s_per_m

    return [
        draw_trials(
            repetitions,
            np.zeros(worlds),
            partial(draw_times, share=share),
            generator,
            FAILURE_S_PER_M,
        )
        for share in (0.0, slow_percent / 100.0)
    ]
