"""The sampled trajectories of a planner that are shown, and their colours; few, so that bags stay small."""

from typing import NamedTuple

import numpy as np

from barn_planners.interface import FloatArray

MOST_SHOWN = 20
MOST_POINTS = 8
# Red, green, blue, opacity of the cheapest and the costliest valid trajectory, and of rejected ones.
CHEAPEST, DEAREST, REJECTED = (0.0, 0.25, 0.5, 0.9), (0.55, 0.8, 0.95, 0.7), (0.55, 0.55, 0.55, 0.5)


class ShownCandidates(NamedTuple):
    """Trajectories (k, n, 2) in metres and their colours (k, 4): red, green, blue, opacity."""

    points: FloatArray
    colours: FloatArray


def shown_candidates(candidates: FloatArray, costs: FloatArray | None) -> ShownCandidates:
    """Choose from trajectories (k, n, 2), m, with costs (k,), which are +inf where rejected.

    At most `MOST_SHOWN`, evenly spaced in their order and always with the cheapest; each has at most `MOST_POINTS`
    points, always with both ends. Without costs all have the colour of the costliest.
    """
    worth = np.zeros(len(candidates)) if costs is None else np.where(np.isnan(costs), np.inf, costs)
    chosen = _spread(len(candidates), MOST_SHOWN)
    if costs is not None and np.isfinite(worth).any():
        cheapest = int(np.argmin(worth))
        chosen[np.argmin(np.abs(chosen - cheapest))] = cheapest
    points = candidates[chosen][:, _spread(candidates.shape[1], MOST_POINTS)]
    return ShownCandidates(np.asarray(points, np.float64), _colours(worth[chosen], costs is not None))


def _colours(costs: FloatArray, graded: bool) -> FloatArray:
    free = np.isfinite(costs)
    low, high = (float(costs[free].min()), float(costs[free].max())) if free.any() else (0.0, 0.0)
    share = (np.where(free, costs, high) - low) / (high - low) if high > low else np.zeros(len(costs))
    share = share if graded else np.ones(len(costs))
    graded_colours = np.array(CHEAPEST) + share[:, None] * (np.array(DEAREST) - np.array(CHEAPEST))
    return np.where(free[:, None], graded_colours, np.array(REJECTED))


def _spread(count: int, most: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return at most `most` of the numbers from 0 to count - 1, evenly spaced, with both ends."""
    spread: np.ndarray[tuple[int], np.dtype[np.int64]] = np.linspace(0, count - 1, min(count, most)).round().astype(int)
    return spread
