"""The global plan: its potential against plain references, its path against the grid."""

import math

import numpy as np
import pytest
from scipy.ndimage import label

from barn_planners.costmap.config import CostmapConfig
from barn_planners.costmap.costmap import Costmap
from barn_planners.costmap.kernels import INSCRIBED, LETHAL
from barn_planners.global_plan import descent, kernels
from barn_planners.global_plan.planner import (
    GlobalPlanConfig,
    GlobalPlanner,
    cell_prices,
)
from barn_worlds.base.types import Pose2D

UNREACHED = kernels.UNREACHED


def plain_value(low, high, price):
    low, high = min(low, high), max(low, high)
    if high - low >= price:
        return low + price
    q = (high - low) / price
    return low + price * (-0.2301 * q * q + 0.5307 * q + 0.7040)


def plain_rounds(costs, prices, start, goal, limit, step):
    """Return the potential grown in the same order by dictionaries and lists."""
    rows, cols = costs.shape
    potential = np.full((rows, cols), UNREACHED)
    potential[start] = 0.0
    sides = ((0, -1), (0, 1), (-1, 0), (1, 0))

    def enterable(cell):
        return (
            0 < cell[0] < rows - 1
            and 0 < cell[1] < cols - 1
            and prices[costs[cell]] < math.inf
        )

    current = [
        c
        for dr, dc in ((0, -1), (0, 1), (-1, 0), (1, 0))
        if enterable(c := (start[0] + dr, start[1] + dc))
    ]
    later: list = []
    while current:
        following: list = []
        for index, (r, c) in enumerate(current):
            around = [potential[r + dr, c + dc] for dr, dc in sides]
            value = plain_value(min(around[:2]), min(around[2:]), prices[costs[r, c]])
            if value >= potential[r, c]:
                continue
            potential[r, c] = value
            target = following if value < limit else later
            for dr, dc in sides:
                other = (r + dr, c + dc)
                if not enterable(other) or other in following or other in later:
                    continue
                if potential[other] > value + math.sqrt(0.5) * prices[costs[other]]:
                    target.append(other)
            assert index < rows * cols
        current = following
        if not current:
            limit += step
            current, later = later, []
        if potential[goal] < UNREACHED:
            break
    return potential


def grown(costs, start, goal):
    rows, cols = costs.shape
    prices = cell_prices(GlobalPlanConfig())
    terrain = kernels.Terrain(costs.ravel(), cols, prices, math.sqrt(0.5) * prices)
    ends = kernels.Ends(start[0] * cols + start[1], goal[0] * cols + goal[1])
    growth = kernels.Growth(254.0, 100.0, 10**9, 50.0, 48.5, 800.0)
    memory = kernels.new_memory(rows, cols, np.float64)
    pending = memory.pending.reshape(rows, cols)
    kernels.grow(terrain, ends, growth, kernels.Focus(0.0, 0.0, math.inf), memory, 1)
    assert pending[1:-1, 1:-1].sum() == 0, "work space is left as it was found"
    potential = memory.potentials[1]
    window = memory.windows[1]
    reached = potential.copy().reshape(rows, cols)
    assert all(
        window[0] <= row < window[1] and window[2] <= col < window[3]
        for row, col in (start, goal)
    )
    kernels.forget(potential, cols, window)
    assert (potential == UNREACHED).all()
    return reached


def random_costs(seed, shape=(40, 50)):
    rng = np.random.default_rng(seed)
    costs = rng.choice(
        np.array([0, 177, 193, 210, 241, INSCRIBED, LETHAL], np.uint8),
        shape,
        p=[0.6, *[0.1] * 4, 0, 0],
    )
    costs[rng.random(shape) < 0.15] = LETHAL
    costs[:3, :3] = costs[-3:, -3:] = 0
    return costs


def grid_of(costs, resolution=0.05):
    costmap = Costmap(CostmapConfig(), *costs.shape, resolution, (-1.0, 2.0))
    costmap.costs[:] = costs
    return costmap


def center(costmap, row, col, yaw=0.0):
    x = costmap.origin_x + (col + 0.5) * costmap.resolution
    y = costmap.origin_y + (row + 0.5) * costmap.resolution
    return Pose2D(x, y, yaw)


def path_length(poses):
    """Return the arc length in meters of points (n, 2 or more)."""
    return float(np.hypot(np.diff(poses[:, 0]), np.diff(poses[:, 1])).sum())


def test_prices_are_navfns():
    prices = cell_prices(GlobalPlanConfig())
    assert (
        prices[0] == 50.0
        and prices[177] == 191.0
        and prices[241] == 242.0
        and prices[252] == 251.0
    )
    assert prices[INSCRIBED] == prices[LETHAL] == math.inf and prices[255] == 253.0


@pytest.mark.parametrize(
    "goal", [(38, 48), (0, 0)]
)  # one on the border is never reached: everything is grown
@pytest.mark.parametrize("seed", range(4))
def test_the_potential_equals_the_plain_one_in_the_same_order(seed, goal):
    costs = random_costs(seed)
    start = (1, 1)
    expected = plain_rounds(
        costs, cell_prices(GlobalPlanConfig()), start, goal, 254.0, 100.0
    )
    np.testing.assert_array_equal(grown(costs, start, goal), expected)


def test_leaving_out_far_obstacles_does_not_change_the_plan():
    differing = 0
    planned = 0
    for seed in range(40):
        costs = np.pad(random_costs(seed), ((10, 10), (30, 30)))
        costmap = grid_of(costs)
        ends = (center(costmap, 11, 31), center(costmap, 47, 77))
        bounded = GlobalPlanner(GlobalPlanConfig()).plan(costmap, *ends).poses
        whole = (
            GlobalPlanner(GlobalPlanConfig(bounded=False)).plan(costmap, *ends).poses
        )
        assert (bounded is None) == (whole is None)
        if whole is not None:
            planned += 1
            same = bounded.shape == whole.shape and np.abs(bounded - whole).max() < 1e-6
            differing += not same
            assert path_length(bounded) <= 1.02 * path_length(whole)
    assert planned > 30 and differing <= 2


@pytest.mark.parametrize("seed", range(6))
def test_a_plan_leads_from_robot_to_goal_through_free_cells(seed):
    costs = random_costs(seed)
    costmap = grid_of(costs)
    start = center(costmap, 1, 1)
    goal = center(costmap, 37, 47, yaw=1.2)
    plan = GlobalPlanner(GlobalPlanConfig()).plan(costmap, start, goal)
    regions, _ = label(np.pad(costs[1:-1, 1:-1] < INSCRIBED, 1))
    assert (plan.poses is not None) == (regions[1, 1] == regions[37, 47])
    if plan.poses is None:
        assert plan.reason == "no way to the goal"
        return
    assert tuple(plan.poses[-1]) == (goal.x, goal.y, goal.yaw)
    assert math.dist(plan.poses[0, :2], (start.x, start.y)) < 0.05
    steps = np.hypot(*np.diff(plan.poses[:, :2], axis=0).T)
    assert steps.max() < 0.05 * 1.5 * math.sqrt(2.0) + 1e-9
    for x, y in plan.poses[:, :2]:
        assert costs[costmap.world_to_cell(x, y)] < INSCRIBED


def test_a_plan_on_open_ground_is_nearly_straight():
    costmap = grid_of(np.zeros((200, 200), np.uint8))
    start = center(costmap, 20, 30)
    goal = center(costmap, 170, 110)
    plan = GlobalPlanner(GlobalPlanConfig()).plan(costmap, start, goal)
    assert path_length(plan.poses) < 1.02 * start.distance(goal)
    np.testing.assert_allclose(plan.poses[5:-5, 2], math.atan2(150, 80), atol=0.25)


def test_the_quirks_are_half_a_cell_and_no_heading():
    costmap = grid_of(np.zeros((60, 60), np.uint8))
    start = center(costmap, 10, 10)
    goal = center(costmap, 40, 30, yaw=0.7)
    right = GlobalPlanner(GlobalPlanConfig()).plan(costmap, start, goal).poses
    quirky = GlobalPlanner(
        GlobalPlanConfig(half_cell_offset=False, zero_intermediate_yaw=True)
    )
    shifted = quirky.plan(costmap, start, goal).poses
    np.testing.assert_allclose(right[:-1, :2] - shifted[:-1, :2], 0.025, atol=1e-12)
    assert (shifted[:-1, 2] == 0.0).all() and shifted[-1, 2] == 0.7


def test_why_there_is_no_plan_is_said():
    costs = np.zeros((40, 40), np.uint8)
    costs[:, 20] = LETHAL
    costs[10, 30] = INSCRIBED
    costmap = grid_of(costs)
    planner = GlobalPlanner(GlobalPlanConfig())
    start = center(costmap, 10, 10)
    assert (
        planner.plan(costmap, start, center(costmap, 30, 30)).reason
        == "no way to the goal"
    )
    assert (
        planner.plan(costmap, start, center(costmap, 10, 30)).reason
        == "the goal is inside an obstacle"
    )
    assert (
        planner.plan(costmap, start, Pose2D(50.0, 0.0, 0.0)).reason
        == "the goal is off the global costmap"
    )
    assert (
        planner.plan(costmap, start, Pose2D(math.nan, 0.0, 0.0)).reason
        == "the goal is off the global costmap"
    )
    assert (
        planner.plan(costmap, Pose2D(50.0, 0.0, 0.0), start).reason
        == "the robot is off the global costmap"
    )
    poses = planner.plan(costmap, start, Pose2D(start.x, start.y, 2.0)).poses
    assert poses.tolist() == [[start.x, start.y, 2.0]]


def test_the_robots_own_cell_counts_as_free():
    costs = np.zeros((40, 40), np.uint8)
    costs[10, 10] = LETHAL
    costmap = grid_of(costs)
    plan = GlobalPlanner(GlobalPlanConfig()).plan(
        costmap, center(costmap, 10, 10), center(costmap, 30, 30)
    )
    assert plan.poses is not None


@pytest.mark.parametrize("bounded", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_a_plan_lasts_as_long_as_a_new_one_would_be_equal(seed, bounded):
    config = GlobalPlanConfig(bounded=bounded)
    costmap = grid_of(np.pad(random_costs(seed), 15))
    ends = (center(costmap, 16, 16), center(costmap, 52, 62))
    planner = GlobalPlanner(config)
    rng = np.random.default_rng(seed)
    unchanged = changed = 0
    last = planner.plan(costmap, *ends)
    for _ in range(300):
        row = rng.integers(1, 69)
        col = rng.integers(1, 79)
        if (row, col) not in ((16, 16), (52, 62)):
            costmap.costs[row, col] = rng.choice([0, 177, 193, INSCRIBED, LETHAL])
        plan = planner.plan(costmap, *ends)
        anew = GlobalPlanner(config).plan(costmap, *ends)
        np.testing.assert_array_equal(plan.poses, anew.poses)
        unchanged += plan is last
        changed += plan is not last
        last = plan
    assert changed > 10 and unchanged > 10


def test_a_new_goal_start_or_grid_needs_a_new_plan():
    costmap = grid_of(np.zeros((60, 60), np.uint8))
    start = center(costmap, 10, 10)
    goal = center(costmap, 40, 30)
    planner = GlobalPlanner(GlobalPlanConfig())
    plan = planner.plan(costmap, start, goal)
    assert planner.plan(costmap, Pose2D(start.x + 0.01, start.y, 0.3), goal) is plan, (
        "in the same cell"
    )
    turned = planner.plan(costmap, start, Pose2D(goal.x, goal.y, 1.0))
    assert turned is not plan and turned.poses[-1, 2] == 1.0
    assert planner.plan(costmap, center(costmap, 10, 11), goal) is not plan
    plan = planner.plan(costmap, start, goal)
    costmap.origin_x += costmap.resolution
    moved = planner.plan(costmap, start, goal)
    np.testing.assert_allclose(moved.poses[-1], plan.poses[-1])
    assert moved is not plan


f32 = np.float32


def plain_gradient(potential, row, col):
    if not 1 <= row < potential.shape[0] - 1:
        return f32(0), f32(0)
    potential_at_cell = potential[row, col]
    parts = []
    for before, after in (
        (potential[row, col - 1], potential[row, col + 1]),
        (potential[row - 1, col], potential[row + 1, col]),
    ):
        if potential_at_cell >= UNREACHED:
            parts.append(
                f32(
                    -254.0
                    if before < UNREACHED
                    else 254.0
                    if after < UNREACHED
                    else 0.0
                )
            )
        else:
            falls = [
                f32(lower - other)
                for lower, other in (
                    (before, potential_at_cell),
                    (potential_at_cell, after),
                )
                if max(lower, other) < UNREACHED
            ]
            parts.append(f32(sum(falls, f32(0))))
    norm = f32(math.hypot(*map(float, parts)))
    return (
        (f32(0), f32(0))
        if norm == 0.0
        else tuple(f32(f32(1.0 / float(norm)) * part) for part in parts)
    )


def plain_navfn_path(potential, start, goal, most):
    """Return the points (column, row) from the goal to the start and whether they arrive, step by step in float32."""
    (row, col), dx, dy, points = goal, f32(0), f32(0), []
    while len(points) < most:
        rounded = [
            int(math.copysign(math.floor(abs(float(part)) + 0.5), part))
            for part in (dy, dx)
        ]
        if potential[row + rounded[0], col + rounded[1]] < 50.0:
            return [*points, (start[1], start[0])], True
        points.append((f32(f32(col) + dx), f32(f32(row) + dy)))
        around = potential[row - 1 : row + 2, col - 1 : col + 2]
        if around.max() >= UNREACHED or (len(points) > 2 and points[-3] == points[-1]):
            lowest = (
                math.floor(potential[row, col])
                if potential[row, col] < UNREACHED
                else -(2**31)
            )
            best = (1, 1)
            for cell in np.ndindex(3, 3):
                if around[cell] < lowest:
                    lowest = math.floor(around[cell])
                    best = cell
            row, col, dx, dy = row + best[0] - 1, col + best[1] - 1, f32(0), f32(0)
            if potential[row, col] >= UNREACHED:
                return points, False
            continue
        corners = [
            plain_gradient(potential, row + i, col + j) for i in (0, 1) for j in (0, 1)
        ]
        way = []
        for k in (0, 1):
            low, high = (
                f32((1.0 - float(dx)) * float(lower[k]) + float(f32(dx * other[k])))
                for lower, other in (corners[:2], corners[2:])
            )
            way.append(f32((1.0 - float(dy)) * float(low) + float(f32(dy * high))))
        if way == [0.0, 0.0]:
            return points, False
        share = f32(f32(0.5) / f32(math.hypot(float(way[0]), float(way[1]))))
        dx, dy = f32(dx + f32(way[0] * share)), f32(dy + f32(way[1] * share))
        col, dx = (
            (col + 1, f32(dx - 1))
            if dx > 1.0
            else (col - 1, f32(dx + 1))
            if dx < -1.0
            else (col, dx)
        )
        row, dy = (
            (row + 1, f32(dy - 1))
            if dy > 1.0
            else (row - 1, f32(dy + 1))
            if dy < -1.0
            else (row, dy)
        )
    return points, False


@pytest.mark.parametrize("seed", range(12))
def test_navfns_descent_equals_the_plain_one_bit_by_bit(
    seed,
):
    costs = random_costs(seed)
    start = (1, 1)
    goal = (37, 47)
    potential = grown(costs, start, (0, 0)).astype(np.float32)
    if potential[goal] >= UNREACHED:
        pytest.skip("there is no way in this world")
    for most in (200, 30):
        points = np.empty((most, 2), np.float32)
        ends = kernels.Ends(start[0] * 50 + start[1], goal[0] * 50 + goal[1])
        n, arrived = descent.descend_as_navfn(
            potential.ravel(), 50, ends, 50.0, 254.0, points
        )
        expected, expected_arrived = plain_navfn_path(potential, start, goal, most)
        assert arrived == expected_arrived and (most == 200 or not arrived)
        np.testing.assert_array_equal(points[:n], np.array(expected, np.float32))


@pytest.mark.parametrize("unfinished", [False, True])
def test_as_navfn_an_incomplete_plan_is_optional(unfinished):
    narrow = grid_of(
        np.zeros((40, 4), np.uint8)
    )  # four columns: sixteen points do not lead along forty rows
    robot = center(narrow, 2, 1)
    goal = center(narrow, 37, 2)
    plan = GlobalPlanner(
        GlobalPlanConfig(as_navfn=True, unfinished_plans=unfinished)
    ).plan(narrow, robot, goal)
    if unfinished:
        assert (
            len(plan.poses) == 17
            and math.dist(plan.poses[0, :2], (robot.x, robot.y)) > 0.5
        )
    else:
        assert plan.poses is None and plan.reason == "no way to the goal"


def test_as_navfn_the_number_of_rounds_is_bounded():
    costs = np.zeros((21, 21), np.uint8)
    for k in range(2, 19, 2):  # a way of more than 42 cells, to and fro
        costs[k, 1:-2] = LETHAL
        costs[k, [1, 19]] = (0, LETHAL) if k % 4 else (LETHAL, 0)
    costmap = grid_of(costs)
    ends = center(costmap, 1, 10), center(costmap, 19, 10)
    assert GlobalPlanner(GlobalPlanConfig()).plan(costmap, *ends).poses is not None
    assert (
        GlobalPlanner(GlobalPlanConfig(as_navfn=True)).plan(costmap, *ends).reason
        == "no way to the goal"
    )


@pytest.mark.parametrize("as_navfn", [False, True])
@pytest.mark.parametrize("place", [(0, 20), (20, 0), (39, 20), (20, 39), (0, 0)])
def test_a_robot_in_the_outermost_cells_is_planned_from(place, as_navfn):
    costmap = grid_of(np.zeros((40, 40), np.uint8))
    start = center(costmap, *place)
    plan = (
        GlobalPlanner(GlobalPlanConfig(as_navfn=as_navfn))
        .plan(costmap, start, center(costmap, 30, 25))
        .poses
    )
    if place == (0, 0):
        assert plan is None, "all neighbors of a corner are blocked"
    else:
        assert math.dist(plan[0, :2], (start.x, start.y)) < 0.05
