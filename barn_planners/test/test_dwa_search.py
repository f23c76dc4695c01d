"""The search that scores only what can be the best, against the one that scores every sample."""

import itertools

import numpy as np
import pytest
from test_dwa_kernels import BODY, COLS, GRID, MOTION, ROWS, STARTS, WEIGHTS, clearance, fields, random_costs, samples

from barn_planners.costmap.costmap import LETHAL
from barn_planners.dwa import kernels
from barn_planners.dwa.search import find_best


def grid_of_samples(seed: int, speeds: int = 5, turns: int = 8) -> np.ndarray:
    """Return samples as the planner makes them: the same turns for every speed, then in place."""
    rng = np.random.default_rng(seed)
    low, rates = rng.uniform(0.1, 0.3), np.sort(rng.uniform(-1.57, 1.57, turns))
    table = np.zeros(((speeds + 1) * turns, kernels.OBSTACLE + 1))
    table[: speeds * turns, kernels.SPEED] = np.repeat(np.linspace(low, 0.5, speeds), turns)
    table[:, kernels.TURN] = np.tile(rates, speeds + 1)
    return table


def found(scene, start, weights, table, drives, allowed, likely, slots):
    full, quick = table.copy(), table.copy()
    arguments = (start, MOTION, weights)
    best = kernels.search(*scene, *arguments, full, drives, allowed, 0.325)
    assert find_best(scene, *arguments, quick, drives, allowed, 0.325, likely, slots) == best
    if best >= 0:
        np.testing.assert_array_equal(quick[best], full[best])
    return best


@pytest.mark.parametrize("weights", [WEIGHTS, (0.0375, 0.05, 0.1), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)])
def test_the_quick_search_finds_the_same_row_with_the_same_figures(weights):
    winners = set()
    for seed, start in itertools.product(range(6), STARTS):
        costs = random_costs(seed, 0.001)
        scene = (costs, clearance(costs), *fields(costs, start[:3], [(30, 30 + k) for k in range(40)])[0], GRID, BODY)
        tables = [(samples(seed=seed), 40), (samples(0, seed=seed), 0), (grid_of_samples(seed), 40)]
        for (table, drives), allowed in itertools.product(tables, itertools.product((True, False), repeat=2)):
            for likely, slots in ((0, 1), (17, 8), (len(table) - 1, 7), (900, 3)):
                best = found(scene, start, weights, table, drives, allowed, likely, slots)
                winners.add("none" if best < 0 else "drive" if best < drives else "turn")
    assert winners == {"none", "drive", "turn"}, "every kind of winner has been met"


def test_the_first_of_equals_wins_wherever_the_search_begins():
    costs = np.zeros((ROWS, COLS), np.uint8)
    scene = (costs, clearance(costs), *fields(costs, (0.0, 0.0, 0.0), [(30, 40), (30, 41)])[0], GRID, BODY)
    table = np.repeat(samples(1, 0), 9, axis=0)
    for likely in range(9):
        assert found(scene, (0.0, 0.0, 0.0, 0.3, 0.0), WEIGHTS, table, 9, (True, True), likely, 4) == 0


def test_the_quick_search_takes_nothing_where_everything_touches():
    costs = np.full((ROWS, COLS), LETHAL, np.uint8)
    scene = (costs, clearance(costs), *fields(costs, (0.0, 0.0, 0.0), [(30, 40), (30, 41)])[0], GRID, BODY)
    assert found(scene, (0.0, 0.0, 0.0, 0.0, 0.0), WEIGHTS, samples(), 40, (True, True), 3, 5) == -1
