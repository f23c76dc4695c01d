"""Trials that a difficulty model is trained and judged on: which world, which planner, and the time per metre."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from barn_metrics.model.errors import ModelError
from barn_worlds.errors import suggest

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Trials:
    """Trials in any order, each array (n,).

    worlds: number of the world; planners: name of the planner; normalised_s_per_m: time as it counts, failures
    included, by the path's arc length (the paper's normalised time, Sec. IV); succeeded: the goal was reached.
    Raises ModelError for arrays of different lengths, or times that are not finite and above zero.
    """

    worlds: Integers
    planners: tuple[str, ...]
    normalised_s_per_m: Floats
    succeeded: npt.NDArray[np.bool_]

    def __post_init__(self) -> None:
        sizes = {len(self.worlds), len(self.planners), len(self.normalised_s_per_m), len(self.succeeded)}
        if sizes == {0} or len(sizes) > 1:
            raise ModelError(f"trials must be at least one and their columns equally long, got lengths {sorted(sizes)}")
        times = self.normalised_s_per_m
        wrong = ~(np.isfinite(times) & (times > 0.0))
        if wrong.any():
            first = int(np.flatnonzero(wrong)[0])
            raise ModelError(f"world {self.worlds[first]}: time per metre must be above 0, got {times[first]}")

    def __len__(self) -> int:
        return len(self.worlds)

    @cached_property
    def planner_names(self) -> tuple[str, ...]:
        """The planners, sorted by name."""
        return tuple(sorted(set(self.planners)))

    @cached_property
    def world_numbers(self) -> tuple[int, ...]:
        """Numbers of the worlds that every planner has trials in, ascending: those that difficulty is known of."""
        mine = [set(self.worlds[self._is(planner)].tolist()) for planner in self.planner_names]
        return tuple(sorted(set.intersection(*mine)))

    def of(self, planner: str) -> Trials:
        """Return the trials of one planner; ModelError for one that has none."""
        if planner not in self.planner_names:
            raise ModelError(f"no trials of planner {planner!r}{suggest(planner, self.planner_names)}")
        return self._where(self._is(planner))

    def only(self, worlds: Collection[int]) -> Trials:
        """Return the trials in some of the worlds."""
        return self._where(np.isin(self.worlds, sorted(worlds)))

    def successes(self) -> Trials | None:
        """Return the successful trials alone, None where there is none."""
        return self._where(self.succeeded) if self.succeeded.any() else None

    def difficulty(self) -> Floats:
        """Return the normalised time in seconds per metre of each of `world_numbers`, (w,).

        It is the mean over repetitions, then over planners, so that each planner weighs the same.
        """
        mean: Floats = np.mean([self.means(planner) for planner in self.planner_names], axis=0)
        return mean

    def means(self, planner: str) -> Floats:
        """Return one planner's mean time per metre in each of `world_numbers`, (w,)."""
        mine = self.of(planner)
        return mean_by(mine.worlds, mine.normalised_s_per_m, self.world_numbers)

    def _is(self, planner: str) -> npt.NDArray[np.bool_]:
        return np.array([name == planner for name in self.planners])

    def _where(self, kept: npt.NDArray[np.bool_]) -> Trials:
        planners = tuple(name for name, keep in zip(self.planners, kept, strict=True) if keep)
        return Trials(self.worlds[kept], planners, self.normalised_s_per_m[kept], self.succeeded[kept])


def mean_by(worlds: Integers, values: Floats, wanted: Collection[int]) -> Floats:
    """Return the mean of the values (n,) of each wanted world, (w,), NaN where there is none; worlds (n,): whose."""
    position = {world: index for index, world in enumerate(wanted)}
    at = np.array([position.get(int(world), -1) for world in worlds], np.int64)
    known = at >= 0
    sums = np.bincount(at[known], values[known], minlength=len(position))
    counts = np.bincount(at[known], minlength=len(position))
    with np.errstate(invalid="ignore"):
        means: Floats = sums / counts
    return means
