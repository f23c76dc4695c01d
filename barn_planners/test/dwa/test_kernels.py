"""The kernels of the dynamic window approach against plain slow references."""

import itertools
import math
from collections import deque

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from barn_planners.costmap import kernels as costmap_kernels
from barn_planners.costmap.config import rectangle
from barn_planners.costmap.kernels import INSCRIBED, LETHAL, Cell, Grid, Pose
from barn_planners.dwa import kernels
from barn_planners.dwa.kernels import (
    Ground,
    Motion,
    Raster,
    Rules,
    Scene,
    Start,
    Weights,
)
from barn_planners.dwa.search import Choice, find_best

RESOLUTION = 0.05
ROWS = 70
COLS = 90
ORIGIN = (-2.0, -1.5)
GRID = Grid(*ORIGIN, RESOLUTION)
RASTER = Raster(*ORIGIN, 1.0 / RESOLUTION)
JACKAL = rectangle(0.31, 0.265)
PENTAGON = np.array([[0.4, 0.1], [0.1, 0.3], [-0.2, 0.2], [-0.2, -0.2], [0.3, -0.2]])
MOTION = Motion(2.0, 0.02, 0.02, 10.0, 20.0)
WEIGHTS = Weights(0.75, 1.0, 0.1)
SIZE = (ROWS + 2) * (COLS + 2)


def cell_of(x, y):
    row = math.floor((y - ORIGIN[1]) * RASTER.per_m)
    return row, math.floor((x - ORIGIN[0]) * RASTER.per_m)


def padded(cell):
    return kernels.padded(Cell(*cell), COLS + 2)


def random_costs(seed, density=0.01):
    rng = np.random.default_rng(seed)
    costs = np.zeros((ROWS, COLS), np.uint8)
    for row, col in np.argwhere(rng.random(costs.shape) < density):
        costs[max(0, row - 2) : row + 3, max(0, col - 2) : col + 3] = INSCRIBED
    costs[rng.random(costs.shape) < 0.02] = 193
    costs[rng.random(costs.shape) < density / 2] = LETHAL
    return costs


def plain_wavefront(passable, seeds):
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
    corners = costmap_kernels.corners_at(JACKAL, Pose(*pose))
    covered = costmap_kernels.footprint_cells(corners, GRID, (ROWS, COLS))
    kernels.block_cells(costs, state)
    kernels.open_cells(covered, COLS + 2, state)
    passable = costs < INSCRIBED
    passable[covered[:, 0], covered[:, 1]] = True
    return state, passable


def wavefront_from(state, seeds):
    wave = kernels.new_wavefront(ROWS, COLS)
    kernels.start_wavefront(wave, state, np.array([padded(cell) for cell in seeds]))
    return wave


@pytest.mark.parametrize("seed", range(5))
def test_waves_count_the_steps_around_what_blocks(seed):
    costs = random_costs(seed)
    state, passable = prepared(costs, (0.0, 0.0, 0.3))
    seeds = [(40, 60), (40, 61), (12, 20)]
    wave = wavefront_from(state, seeds)
    again = wavefront_from(state, seeds[:1])
    expected = plain_wavefront(passable, seeds)
    cells = list(np.ndindex(ROWS, COLS))
    kernels.start_wavefront(again, state, np.array([padded(cell) for cell in seeds]))
    for result in (wave, again):
        # in whatever order cells are asked for
        np.random.default_rng(seed).shuffle(cells)
        for cell in cells:
            steps = kernels.steps_to(result, padded(cell))
            assert steps == expected.get(cell, kernels.UNREACHED), cell


def test_a_wave_spreads_no_further_than_to_the_cell_asked_for():
    costs = np.zeros((ROWS, COLS), np.uint8)
    costs[32, 20:50] = INSCRIBED
    state, passable = prepared(costs, (0.0, 0.0, 0.0))
    wave = wavefront_from(state, [(30, 40)])
    expected = plain_wavefront(passable, [(30, 40)])
    furthest = max(expected.values())
    for cell in ((31, 40), (33, 40), (45, 60)):
        assert kernels.steps_to(wave, padded(cell)) == expected[cell] < furthest
        within = sum(steps <= expected[cell] + 1 for steps in expected.values())
        assert (wave.state == kernels.REACHED).sum() <= within
    assert kernels.steps_to(wave, padded((32, 30))) == kernels.UNREACHED


def test_plan_cells_follow_the_plan_within_the_grid_without_gaps():
    places = [(-3.0, 0.0), (-1.9, 0.0), (0.5, 0.3), (0.5, 1.0), (9.0, 1.0), (0.0, 0.0)]
    plan = np.array([(x, y, 0.0) for x, y in places])
    cells = np.empty(1000, np.int64)
    count = kernels.plan_cells(plan, GRID, (ROWS, COLS), cells)
    way = np.column_stack(np.divmod(cells[:count], COLS + 2)) - 1
    assert tuple(way[0]) == cell_of(-1.99, 0.0)
    assert tuple(way[-1]) == cell_of(2.49, 1.0)
    assert (np.abs(np.diff(way, axis=0)).max(axis=1) == 1).all()
    assert kernels.plan_cells(plan[:1], GRID, (ROWS, COLS), cells) == 0
    assert kernels.plan_cells(plan, GRID, (ROWS, COLS), cells[:10]) == 10


@pytest.mark.parametrize("outline", [JACKAL, PENTAGON])
def test_edges_cost_what_the_costmap_says(outline):
    rng = np.random.default_rng(3)
    costs = random_costs(1, 0.002)
    costs[:, 60:] = 0
    ground = Ground(costs, RASTER, outline)
    kinds = set()
    for x, y, yaw in rng.uniform([-2.2, -1.7, -4.0], [2.7, 2.2, 4.0], (800, 3)):
        cost = kernels.edges_cost(*ground, x, y, math.cos(yaw), math.sin(yaw))
        assert cost == plain_edge_cost(costs, outline, x, y, yaw)
        kinds.add(min(cost, 1))
    assert kinds == {-1, 0, 1}


def plain_edge_cost(costs, outline, x, y, yaw):
    corners = costmap_kernels.corners_at(outline, Pose(x, y, yaw))
    return costmap_kernels.edge_cost(costs, corners, GRID)


def plain_rollout(costs, path, goal, start, speed, turn, outline=JACKAL):
    """Return (steps to plan, steps to its end, highest cost) of a sample by the rules, or why not; and its end."""
    x, y, yaw, v, w = start
    steps = max(1, int(max(abs(speed) * 2.0 / 0.02, abs(turn) / 0.02) + 0.5))
    dt = 2.0 / steps
    highest = 0
    scored = None
    for _ in range(steps):
        edge = plain_edge_cost(costs, outline, x, y, yaw)
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
    return (path[cell], goal[cell], highest), scored


def plain_cost(terms, weights):
    if not isinstance(terms, tuple):
        return terms
    return sum(weight * part for weight, part in zip(weights, terms, strict=True))


def scene_of(costs, pose, plan_cells):
    """Return a scene, and the steps to the plan and to its end by cell."""
    state, passable = prepared(costs, pose)
    rollouts = []
    plain = []
    for seeds in (plan_cells, plan_cells[-1:]):
        rollouts.append(wavefront_from(state, seeds))
        plain.append(plain_wavefront(passable, seeds))
    return Scene(Ground(costs, RASTER, JACKAL), *rollouts), plain


def samples(drives=40, turns=12, seed=0):
    rng = np.random.default_rng(seed)
    table = np.zeros((drives + turns, kernels.OBSTACLE + 1))
    table[:drives, kernels.SPEED] = rng.uniform(0.1, 0.5, drives)
    table[:drives, kernels.TURN] = rng.uniform(-1.2, 1.2, drives)
    sides = rng.choice([-1.0, 1.0], turns)
    table[drives:, kernels.TURN] = sides * rng.uniform(0.314, 1.57, turns)
    return table


def even_samples(seed):
    """Return samples as the planner makes them: the same turns for every speed, then in place."""
    rng = np.random.default_rng(seed)
    low = rng.uniform(0.1, 0.3)
    rates = np.sort(rng.uniform(-1.57, 1.57, 8))
    table = np.zeros((6 * 8, kernels.OBSTACLE + 1))
    table[: 5 * 8, kernels.SPEED] = np.repeat(np.linspace(low, 0.5, 5), 8)
    table[:, kernels.TURN] = np.tile(rates, 6)
    return table


STARTS = [
    Start(0.0, 0.0, 0.3, 0.4, -0.2),
    Start(-1.0, 0.5, -2.0, 0.0, 0.0),
    Start(1.2, 1.0, 1.6, 0.5, 1.0),
]
PLAN = [(30, 30 + k) for k in range(40)]


def test_rollouts_cost_what_the_rules_say():
    kinds = set()
    ends = [kernels.END_X, kernels.END_Y, kernels.END_YAW]
    for seed, start in itertools.product(range(4), STARTS):
        costs = random_costs(seed, 0.002)
        scene, plain = scene_of(costs, start[:3], PLAN)
        table = samples(seed=seed)
        kernels.score(*scene, Rules(start, MOTION, WEIGHTS), table)
        for row in table:
            sample = (row[kernels.SPEED], row[kernels.TURN])
            terms, end = plain_rollout(costs, *plain, start, *sample)
            cost = plain_cost(terms, WEIGHTS)
            assert row[kernels.COST] == pytest.approx(cost, abs=1e-9)
            kinds.add(min(cost, 0.0))
            if cost >= 0.0:
                assert_allclose(row[ends], end, atol=1e-9)
    # every way a rollout can end has been met
    assert kinds == {0.0, kernels.TOUCHES, kernels.NO_WAY}


def plain_search(rolled, table, weights, choice, plain_goal):
    """Return the best row of a table by the published rules; rolled: `plain_rollout` of each row."""
    best = -1
    best_cost = math.inf
    best_ahead = math.inf
    for k, (terms, end) in enumerate(rolled):
        cost = plain_cost(terms, weights)
        if cost < 0.0:
            continue
        if k < choice.drives:
            if cost < best_cost:
                best = k
                best_cost = cost
            continue
        may_turn = choice.left if table[k, kernels.TURN] > 0.0 else choice.right
        if not may_turn or cost > best_cost:
            continue
        x, y, yaw = end
        x += choice.lookahead_m * math.cos(yaw)
        y += choice.lookahead_m * math.sin(yaw)
        row, col = ahead = cell_of(x, y)
        distance = plain_goal.get(ahead, math.inf)
        is_blocked = distance == math.inf and 0 <= row < ROWS and 0 <= col < COLS
        if choice.past_blocked and is_blocked:
            beside = {(row, col + 1), (row, col - 1), (row + 1, col), (row - 1, col)}
            distance = 1e6 if beside & plain_goal.keys() else 1e6 + 1.0
        if distance < best_ahead:
            best = k
            best_cost = cost
            best_ahead = distance
    return best


def test_the_search_takes_the_sample_of_the_rules():
    winners = set()
    all_weights = [
        WEIGHTS,
        Weights(0.0375, 0.05, 0.1),
        Weights(0.0, 0.0, 0.0),
        Weights(0.0, 0.0, 1.0),
    ]
    sides = (True, False)
    for seed, start in itertools.product(range(6), STARTS):
        costs = random_costs(seed, 0.001)
        scene, plain = scene_of(costs, start[:3], PLAN)
        outline = (JACKAL, PENTAGON)[seed % 2]
        scene = scene._replace(ground=scene.ground._replace(outline=outline))
        for table, drives in (
            (samples(seed=seed), 40),
            (samples(0, seed=seed), 0),
            (even_samples(seed), 40),
        ):
            rolled = [
                plain_rollout(costs, *plain, start, *row[: kernels.COST], outline)
                for row in table
            ]
            last = len(table) - 1
            guesses = ((0, False), (17, True), (last, False), (900, True))
            for weights, left, right in itertools.product(all_weights, sides, sides):
                rules = Rules(start, MOTION, weights)
                full = table.copy()
                kernels.score(*scene, rules, full)
                for likely, past in guesses:
                    quick = table.copy()
                    choice = Choice(drives, left, right, 0.325, past, likely)
                    best = find_best(*scene, rules, quick, choice)
                    expected = plain_search(rolled, table, weights, choice, plain[1])
                    assert best == expected
                    kind = "drive" if best < drives else "turn"
                    winners.add("none" if best < 0 else kind)
                    if best >= 0:
                        assert_array_equal(quick[best], full[best])
    # every kind of winner has been met
    assert winners == {"none", "drive", "turn"}


def test_traces_are_the_rolled_out_poses():
    start = STARTS[0]
    poses = np.empty((kernels.step_count(0.5, 0.8, MOTION), 5))
    kernels.roll_out(start, 0.5, 0.8, MOTION, poses)
    everywhere = dict.fromkeys(np.ndindex(ROWS, COLS), 0)
    free = np.zeros((ROWS, COLS), np.uint8)
    _, end = plain_rollout(free, everywhere, everywhere, start, 0.5, 0.8)
    assert len(poses) == 50
    assert_allclose(poses[-1, :3], end, atol=1e-12)
    traces = kernels.traces(start, np.array([[0.0, 0.8], [0.5, 0.8]]), MOTION, 80)[1]
    assert_array_equal(traces, poses[np.minimum(np.arange(80), 49), :3])
    shorter = np.empty((20, 5))
    kernels.roll_out(start, 0.5, 0.8, MOTION, shorter)
    few = kernels.traces(start, np.array([[0.5, 0.8]]), MOTION, 20)[0]
    assert_array_equal(few, shorter[:, :3])
