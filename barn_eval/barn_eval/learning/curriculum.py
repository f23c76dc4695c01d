"""Worlds of a wanted difficulty (a function of a world), drawn from a data set or generated, by seeds given."""

import math
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import ConfigError, WorldError
from barn_worlds.worlds.dataset import Dataset
from barn_worlds.worlds.generate import TABLE_I, WorldParameters, generate_world
from barn_worlds.worlds.world import World

Difficulty = Callable[[World], float]


@dataclass(frozen=True)
class CurriculumConfig(Checked):
    """How much of a data set is drawn from at first, and when that becomes more."""

    first_level: float = quantity(0.1, "level of the hardest worlds drawn at first", "", 0.0, 1.0)
    step: float = quantity(0.05, "what this level rises by", "", 0.001, 1.0)
    promotion_rate: float = quantity(0.8, "success rate from which it rises", "", 0.0, 1.0)
    window: int = quantity(20, "episodes that this rate is taken over", "", 1, 1_000_000)


class Curriculum:
    """Worlds from easy (level 0) to difficult (level 1), drawn up to a `level` that rises with success."""

    def __init__(self, dataset: Dataset, config: CurriculumConfig | None = None) -> None:
        """Take the worlds in the order of their numbers, which is that of their difficulty in the shipped data sets."""
        self.config = config or CurriculumConfig()
        self.level = self.config.first_level
        self._dataset = dataset
        last = max(1, len(dataset.indices) - 1)
        self._levels = [place / last for place in range(len(dataset.indices))]
        self._recent: deque[bool] = deque(maxlen=self.config.window)

    def between(self, low: float, high: float) -> tuple[int, ...]:
        """Return the numbers of the worlds of these levels, both included, easiest first."""
        return self._dataset.indices[bisect_left(self._levels, low) : bisect_right(self._levels, high)]

    def draw(self, generator: np.random.Generator, low: float = 0.0, high: float | None = None) -> tuple[int, World]:
        """Return number and world of one drawn evenly from levels `low` to `high` (default: `level`), or WorldError."""
        top = self.level if high is None else high
        chosen = self.between(low, top)
        if not chosen:
            count = len(self._dataset.indices)
            raise WorldError(f"{self._dataset.name}: none of {count} worlds has a level of {low:g} to {top:g}")
        index = chosen[int(generator.random() * len(chosen))]
        return index, self._dataset.load(index)

    def record(self, success: bool) -> bool:
        """Take note of an episode's end; raise the level and count anew once enough are successes; tell whether."""
        self._recent.append(success)
        full = len(self._recent) == self.config.window
        if not full or self.level >= 1.0 or sum(self._recent) < self.config.promotion_rate * self.config.window:
            return False
        self.widen()
        return True

    def widen(self) -> None:
        """Raise the level by the configured step, and forget the episodes before."""
        self.level = min(1.0, self.level + self.config.step)
        self._recent.clear()


def sample(
    difficulty: Difficulty,
    wanted: tuple[float, float],
    dataset: Dataset | None,
    count: int,
    seed: int,
    *,
    sets: Sequence[WorldParameters] = TABLE_I,
    attempts: int = 1000,
) -> list[tuple[World, float]]:
    """Return so many worlds whose difficulty lies in `wanted` (both limits included), each with its own.

    They are different ones of the data set, drawn evenly; without one they are generated, each with one of `sets`.
    WorldError, naming the difficulties met, if there are fewer, or none fits in so many attempts.
    """
    low, high = wanted
    if math.isnan(low) or math.isnan(high) or low > high:
        raise ConfigError(f"difficulty must be LOW:HIGH with LOW at most HIGH, got {low:g}:{high:g}")
    generator = np.random.default_rng(seed)

    def generated() -> tuple[World, float]:
        met = []
        for _ in range(attempts):
            world = generate_world(sets[int(generator.random() * len(sets))], generator, "generated")
            met.append(difficulty(world))
            if low <= met[-1] <= high:
                return world, met[-1]
        raise WorldError(
            f"none of {attempts} generated worlds has a difficulty of {low:g} to {high:g};"
            f" they have {min(met):.3g} to {max(met):.3g}"
        )

    if dataset is None:
        return [generated() for _ in range(count)]
    known = {index: difficulty(dataset.load(index)) for index in dataset.indices}
    fitting = [index for index, value in known.items() if low <= value <= high]
    if len(fitting) < count:
        raise WorldError(
            f"{dataset.name}: {len(fitting)} of {len(known)} worlds have a difficulty of {low:g} to {high:g},"
            f" {count} are wanted; all have {min(known.values()):.3g} to {max(known.values()):.3g}"
        )
    shuffled = sorted((float(generator.random()), index) for index in fitting)
    return [(dataset.load(index), known[index]) for index in sorted(index for _, index in shuffled[:count])]
