"""The kernels of the dynamic window approach against plain slow references."""

import itertools
import math
from collections import deque

import numpy as np
import pytest

from barn_planners.costmap import kernels as costmap_kernels
from barn_planners.costmap.costmap import INSCRIBED, LETHAL
from barn_planners.dwa import kernels, waves

RESOLUTION = 0.05
ROWS, COLS = 70, 90
ORIGIN = (-2.0, -1.5)
GRID = (*ORIGIN, 1.0 / RESOLUTION)
BODY = (0.31, 0.265)
MOTION = (2.0, 0.02, 0.02, 10.0, 20.0)
WEIGHTS = (0.75, 1.0, 0.1)
SIZE = (ROWS + 2) * (COLS + 2)


def cell_of(x: float, y: float) -> tuple[int, int]:
    return math.floor((y - ORIGIN[1]) * GRID[2]), math.floor((x - ORIGIN[0]) * GRID[2])


def padded(cell) -> int:
    return (cell[0] + 1) * (COLS + 2) + cell[1] + 1


def random_costs(seed: int, density: float = 0.01) -> np.ndarray:
    rng = np.random.default_rng(seed)
    costs = np.zeros((ROWS, COLS), np.uint8)
    for row, col in np.argwhere(rng.random(costs.shape) < density):
        costs[max(0, row - 2) : row + 3, max(0, col - 2) : col + 3] = INSCRIBED
    costs[rng.random(costs.shape) < 0.02] = 193
    costs[rng.random(costs.shape) < density / 2] = LETHAL
    return costs


def plain_wavefront(passable: np.ndarray, seeds: list[tuple[int, int]]) -> dict[tuple[int, int], int]:
    distance = dict.fromkeys(seeds, 0)
    queue = deque(distance)
    while queue:
        row, col = queue.popleft()
        for other in ((row, col - 1), (row, col + 1), (row - 1, col), (row + 1, col)):
            inside = 0 <= other[0] < ROWS and 0 <= other[1] < COLS
            if inside and passable[other] and other not in distance:
                distance[other] = distance[row, col] + 1
                queue.append(other)
    return distance


def prepared(costs, pose):
    state = np.empty(SIZE, np.uint8)
    corners = costmap_kernels.footprint_corners(*pose, *BODY)
    first, spans = costmap_kernels.footprint_spans(corners, *ORIGIN, RESOLUTION)
    waves.blocked(costs, first, spans, state)
    passable = costs < INSCRIBED
    for k, (low, high) in enumerate(spans):
        passable[max(0, low) : high + 1, first + k] = True
    return state, passable


def wave_from(state, seeds):
    wave = waves.new_wave(ROWS, COLS)
    waves.begin(wave, state, np.array([padded(cell) for cell in seeds]))
    return wave


@pytest.mark.parametrize("seed", range(5))
def test_waves_count_the_steps_around_what_blocks(seed):
    costs = random_costs(seed)
    state, passable = prepared(costs, (0.0, 0.0, 0.3))
    seeds = [(40, 60), (40, 61), (12, 20)]
    wave, again = wave_from(state, seeds), wave_from(state, seeds[:1])
    expected = plain_wavefront(passable, seeds)
    cells = list(np.ndindex(ROWS, COLS))
    waves.begin(again, state, np.array([padded(cell) for cell in seeds]))
    for one in (wave, again):
        np.random.default_rng(seed).shuffle(cells)  # in whatever order cells are asked for
        for cell in cells:
            assert waves.steps_to(one, padded(cell)) == expected.get(cell, waves.UNREACHED), cell


def test_a_wave_spreads_no_further_than_to_the_cell_asked_for():
    costs = np.zeros((ROWS, COLS), np.uint8)
    costs[32, 20:50] = INSCRIBED
    state, passable = prepared(costs, (0.0, 0.0, 0.0))
    wave = wave_from(state, [(30, 40)])
    expected = plain_wavefront(passable, [(30, 40)])
    furthest = max(expected.values())
    for cell in ((31, 40), (33, 40), (45, 60)):
        assert waves.steps_to(wave, padded(cell)) == expected[cell] < furthest
        assert (wave[1] == waves.REACHED).sum() <= sum(steps <= expected[cell] + 1 for steps in expected.values())
    assert waves.steps_to(wave, padded((32, 30))) == waves.UNREACHED


def test_the_robots_own_cells_stay_passable():
    costs = np.full((ROWS, COLS), INSCRIBED, np.uint8)
    state, passable = prepared(costs, (0.2, 0.1, 1.0))
    open_cells = {cell for cell in np.ndindex(ROWS, COLS) if state[padded(cell)] != waves.BLOCKED}
    assert open_cells == {tuple(cell) for cell in np.argwhere(passable)} and len(open_cells) > 100


def test_plan_cells_follow_the_plan_within_the_grid_without_gaps():
    plan = np.array(
        [[-3.0, 0.0, 0.0], [-1.9, 0.0, 0.0], [0.5, 0.3, 0.0], [0.5, 1.0, 0.0], [9.0, 1.0, 0.0], [0.0, 0.0, 0.0]]
    )
    cells = np.empty(1000, np.int64)
    count = waves.plan_cells(plan, *ORIGIN, RESOLUTION, ROWS, COLS, cells)
    found = [(int(cell) // (COLS + 2) - 1, int(cell) % (COLS + 2) - 1) for cell in cells[:count]]
    assert found[0] == cell_of(-1.99, 0.0) and found[-1] == cell_of(2.49, 1.0)
    for one, other in itertools.pairwise(found):
        assert max(abs(one[0] - other[0]), abs(one[1] - other[1])) == 1
    assert waves.plan_cells(plan[:1], *ORIGIN, RESOLUTION, ROWS, COLS, cells) == 0
    assert waves.plan_cells(plan, *ORIGIN, RESOLUTION, ROWS, COLS, cells[:10]) == 10


@pytest.mark.parametrize("seed", range(3))
def test_edges_cost_the_same_with_and_without_an_array_of_corners(seed):
    rng = np.random.default_rng(seed)
    costs = random_costs(seed, 0.002)
    costs[:, 60:] = 0
    clear, seen = clearance(costs, (5, 65, 10, 80)), set()
    for _ in range(300):
        x, y, yaw = rng.uniform(-2.2, 2.7), rng.uniform(-1.7, 2.2), rng.uniform(-4, 4)
        corners = costmap_kernels.footprint_corners(x, y, yaw, *BODY)
        expected = costmap_kernels.edge_cost(costs, corners, *ORIGIN, RESOLUTION)
        assert kernels.rectangle_cost(costs, clear, GRID, BODY, x, y, math.cos(yaw), math.sin(yaw)) == expected
        seen.add(min(expected, 1))
    assert seen == {-1, 0, 1}


def clearance(costs, window=(0, ROWS, 0, COLS)) -> np.ndarray:
    clear = np.empty(costs.shape, np.int16)
    kernels.open_around(costs, window, clear)
    return clear


def test_open_ground_is_measured_to_the_next_cost_or_to_the_edge_of_the_window():
    costs = random_costs(3, 0.0005)
    window = (4, 60, 10, 85)
    found = clearance(costs, window)
    used = np.ones((ROWS, COLS), bool)
    used[5:59, 11:84] = costs[5:59, 11:84] > 0
    nonzero = np.argwhere(used)
    expected = np.zeros((ROWS, COLS), int)
    for row, col in np.argwhere(~used):
        expected[row, col] = np.abs(nonzero - [row, col]).max(axis=1).min()
    np.testing.assert_array_equal(found, expected)
    assert expected.max() >= 6


def plain_rollout(costs, path, goal, start, speed, turn, weights=WEIGHTS):
    """Return (cost, end pose) of a sample by the published rules."""
    x, y, yaw, v, w = start
    steps = max(1, int(max(abs(speed) * 2.0 / 0.02, abs(turn) / 0.02) + 0.5))
    dt = 2.0 / steps
    highest, scored = 0, None
    for _ in range(steps):
        corners = costmap_kernels.footprint_corners(x, y, yaw, *BODY)
        edge = costmap_kernels.edge_cost(costs, corners, *ORIGIN, RESOLUTION)
        if edge < 0:
            return kernels.TOUCHES, scored
        cell = cell_of(x, y)
        if cell not in path or cell not in goal:
            return kernels.NO_WAY, scored
        highest = max(highest, edge)
        scored = (x, y, yaw)
        v += max(-10.0 * dt, min(10.0 * dt, speed - v))
        w += max(-20.0 * dt, min(20.0 * dt, turn - w))
        x, y, yaw = x + v * math.cos(yaw) * dt, y + v * math.sin(yaw) * dt, yaw + w * dt
    cell = cell_of(*scored[:2])
    return weights[0] * path[cell] + weights[1] * goal[cell] + weights[2] * highest, scored


def fields(costs, pose, plan_cells):
    state, passable = prepared(costs, pose)
    found, plain = [], []
    for seeds in (plan_cells, plan_cells[-1:]):
        found.append(wave_from(state, seeds))
        plain.append(plain_wavefront(passable, seeds))
    return found, plain


def samples(drives: int = 40, turns: int = 12, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    table = np.zeros((drives + turns, kernels.OBSTACLE + 1))
    table[:drives, kernels.SPEED] = rng.uniform(0.1, 0.5, drives)
    table[:drives, kernels.TURN] = rng.uniform(-1.2, 1.2, drives)
    table[drives:, kernels.TURN] = rng.choice([-1.0, 1.0], turns) * rng.uniform(0.314, 1.57, turns)
    return table


STARTS = [(0.0, 0.0, 0.3, 0.4, -0.2), (-1.0, 0.5, -2.0, 0.0, 0.0), (1.2, 1.0, 1.6, 0.5, 1.0)]


def test_rollouts_cost_what_the_rules_say():
    kinds = set()
    for seed, start in itertools.product(range(4), STARTS):
        costs = random_costs(seed, 0.002)
        (path, goal), (plain_path, plain_goal) = fields(costs, start[:3], [(30, 30 + k) for k in range(40)])
        clear = clearance(costs)
        for row in samples(seed=seed):
            kernels.rollout(costs, clear, path, goal, GRID, BODY, start, MOTION, WEIGHTS, row)
            speed, turn = row[kernels.SPEED], row[kernels.TURN]
            cost, end = plain_rollout(costs, plain_path, plain_goal, start, speed, turn)
            assert row[kernels.COST] == pytest.approx(cost, abs=1e-9)
            kinds.add(min(cost, 0.0))
            if cost >= 0.0:
                np.testing.assert_allclose(row[[kernels.END_X, kernels.END_Y, kernels.END_YAW]], end, atol=1e-9)
    assert kinds == {0.0, kernels.TOUCHES, kernels.NO_WAY}, "every way a rollout can end has been met"


def plain_search(costs, plain_path, plain_goal, start, table, drives, turns, lookahead):
    best, best_cost, best_ahead = -1, math.inf, math.inf
    for k, row in enumerate(table):
        speed, turn = row[kernels.SPEED], row[kernels.TURN]
        cost, end = plain_rollout(costs, plain_path, plain_goal, start, speed, turn)
        if cost < 0.0:
            continue
        if k < drives:
            if cost < best_cost:
                best, best_cost = k, cost
            continue
        if not turns[0 if turn > 0.0 else 1] or cost > best_cost:
            continue
        ahead = cell_of(end[0] + lookahead * math.cos(end[2]), end[1] + lookahead * math.sin(end[2]))
        distance = plain_goal.get(ahead, math.inf)
        if distance < best_ahead:
            best, best_cost, best_ahead = k, cost, distance
    return best


def test_the_search_takes_the_sample_that_the_rules_take():
    winners = set()
    for seed, start in itertools.product(range(6), STARTS):
        costs = random_costs(seed, 0.001)
        found, plain = fields(costs, start[:3], [(30, 30 + k) for k in range(40)])
        for drives, turns in itertools.product((40, 0), ((True, True), (True, False), (False, True), (False, False))):
            table = samples(drives, seed=seed)
            best = kernels.search(
                costs, clearance(costs), *found, GRID, BODY, start, MOTION, WEIGHTS, table, drives, turns, 0.325
            )
            assert best == plain_search(costs, *plain, start, table, drives, turns, 0.325)
            winners.add("none" if best < 0 else "drive" if best < drives else "turn")
    assert winners == {"none", "drive", "turn"}, "every kind of winner has been met"


def test_nothing_is_taken_where_everything_touches():
    costs = np.full((ROWS, COLS), LETHAL, np.uint8)
    found, _ = fields(costs, (0.0, 0.0, 0.0), [(30, 40), (30, 41)])
    table = samples()
    start = (0.0, 0.0, 0.0, 0.0, 0.0)
    best = kernels.search(
        costs, clearance(costs), *found, GRID, BODY, start, MOTION, WEIGHTS, table, 40, (True, True), 0.325
    )
    assert best == -1 and (table[:, kernels.COST] == kernels.TOUCHES).all()


def test_traces_are_the_rolled_out_poses():
    start = (0.0, 0.0, 0.3, 0.4, -0.2)
    points = np.empty((80, 3))
    count = kernels.trace(start, 0.5, 0.8, MOTION, points)
    everywhere = dict.fromkeys(np.ndindex(ROWS, COLS), 0)
    _, end = plain_rollout(np.zeros((ROWS, COLS), np.uint8), everywhere, everywhere, start, 0.5, 0.8)
    assert count == 50
    np.testing.assert_allclose(points[count - 1], end, atol=1e-12)
    assert (points[count:] == points[count - 1]).all()
