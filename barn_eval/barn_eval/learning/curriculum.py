"""Worlds of a wanted difficulty, for training: drawn from a data set, or generated until they have it.

What difficulty is, is passed in as a function of a world, such as the prediction of a difficulty model. All randomness
comes from generators that are passed in.
"""

import math
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

    first_level: float = quantity(0.1, "level of the hardest worlds drawn at first", minimum=0.0, maximum=1.0)
    step: float = quantity(0.05, "what this level rises by", minimum=0.001, maximum=1.0)
    promotion_rate: float = quantity(0.8, "success rate from which it rises", minimum=0.0, maximum=1.0)
    window: int = quantity(20, "episodes that this rate is taken over", minimum=1, maximum=1_000_000)


class Curriculum:
    """Worlds of a data set from easy to difficult, drawn up to a level that rises with success.

    The level of a world is its place in that order, from 0 for the easiest to 1 for the most difficult. `level` is that
    up to which worlds are drawn; `record` or `widen` raise it, never beyond 1.
    """

    def __init__(
        self, dataset: Dataset, difficulty: Difficulty | None = None, config: CurriculumConfig | None = None
    ) -> None:
        """Order the worlds by a difficulty, ties by their number; without one by their number.

        Raises WorldError for a world that cannot be read or whose difficulty is not finite.
        """
        self.config = config or CurriculumConfig()
        self.level = self.config.first_level
        self.order = tuple(dataset.indices) if difficulty is None else _ordered(dataset, difficulty)
        self._dataset = dataset
        self._asked: tuple[float, float] | None = None
        self._between: tuple[int, ...] = ()
        self._recent: deque[bool] = deque(maxlen=self.config.window)

    def between(self, low: float, high: float) -> tuple[int, ...]:
        """Return the numbers of the worlds of these levels, both included, easiest first."""
        if self._asked != (low, high):  # every episode asks, and the levels seldom change
            last = max(1, len(self.order) - 1)
            self._between = tuple(index for place, index in enumerate(self.order) if low <= place / last <= high)
            self._asked = (low, high)
        return self._between

    def draw(self, generator: np.random.Generator, low: float = 0.0, high: float | None = None) -> tuple[int, World]:
        """Return number and world of one drawn evenly from those of a level from `low` to `high` (default: `level`).

        Raises WorldError where there are none.
        """
        top = self.level if high is None else high
        chosen = self.between(low, top)
        if not chosen:
            count = len(self.order)
            raise WorldError(f"{self._dataset.name}: none of {count} worlds has a level of {low:g} to {top:g}")
        index = chosen[int(generator.random() * len(chosen))]
        return index, self._dataset.load(index)

    def record(self, success: bool) -> bool:
        """Take note of an episode's end; raise the level, and count anew, once enough of them were successes.

        Returns whether the level has risen.
        """
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


def generate_world_of(
    difficulty: Difficulty,
    wanted: tuple[float, float],
    generator: np.random.Generator,
    *,
    sets: Sequence[WorldParameters] = TABLE_I,
    attempts: int = 1000,
) -> tuple[World, float]:
    """Return a newly generated world whose difficulty lies in `wanted` (both limits included), and its difficulty.

    Worlds are generated, each with one of `sets` drawn evenly, until one fits. WorldError, naming the difficulties met,
    if none of so many `attempts` does.
    """
    low, high = _checked(wanted)
    met = []
    for _ in range(attempts):
        parameters = sets[int(generator.random() * len(sets))]
        world = generate_world(parameters, generator, "generated")
        found = difficulty(world)
        if low <= found <= high:
            return world, found
        met.append(found)
    raise WorldError(
        f"none of {attempts} generated worlds has a difficulty of {low:g} to {high:g};"
        f" they have {min(met):.3g} to {max(met):.3g}"
    )


def draw_worlds_of(
    dataset: Dataset, difficulty: Difficulty, wanted: tuple[float, float], count: int, generator: np.random.Generator
) -> dict[int, float]:
    """Return the numbers, ascending, of different worlds of a wanted difficulty, each with its difficulty.

    Raises WorldError if the data set has fewer such worlds.
    """
    low, high = _checked(wanted)
    known = {index: difficulty(dataset.load(index)) for index in dataset.indices}
    fitting = [index for index, value in known.items() if low <= value <= high]
    if len(fitting) < count:
        raise WorldError(
            f"{dataset.name}: {len(fitting)} of {len(known)} worlds have a difficulty of {low:g} to {high:g},"
            f" {count} are wanted; all have {min(known.values()):.3g} to {max(known.values()):.3g}"
        )
    shuffled = sorted((float(generator.random()), index) for index in fitting)
    return {index: known[index] for index in sorted(index for _, index in shuffled[:count])}


def sample(
    difficulty: Difficulty, wanted: tuple[float, float], dataset: Dataset | None, count: int, seed: int
) -> list[tuple[World, float]]:
    """Return so many worlds of a wanted difficulty, each with its own; without a data set, newly generated ones."""
    generator = np.random.default_rng(seed)
    if dataset is None:
        return [generate_world_of(difficulty, wanted, generator) for _ in range(count)]
    drawn = draw_worlds_of(dataset, difficulty, wanted, count, generator)
    return [(dataset.load(index), value) for index, value in drawn.items()]


def _checked(wanted: tuple[float, float]) -> tuple[float, float]:
    """Return a range of difficulties; ConfigError if it is none."""
    low, high = wanted
    if math.isnan(low) or math.isnan(high) or low > high:
        raise ConfigError(f"difficulty must be LOW:HIGH with LOW at most HIGH, got {low:g}:{high:g}")
    return low, high


def _ordered(dataset: Dataset, difficulty: Difficulty) -> tuple[int, ...]:
    known = {}
    for index in dataset.indices:
        known[index] = difficulty(dataset.load(index))
        if not math.isfinite(known[index]):
            raise WorldError(f"{dataset.name}: the difficulty of world {index} must be finite, got {known[index]}")
    return tuple(sorted(known, key=lambda index: (known[index], index)))
