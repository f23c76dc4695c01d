"""The global plan: its potential against plain references, its path against the grid."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
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


def plain_value(beside, above, price):
    low, high = sorted((beside, above))
    if high - low >= price:
        return low + price
    q = (high - low) / price
    return low + price * (-0.2301 * q * q + 0.5307 * q + 0.7040)


def sides(cell):
    row, col = cell
    return (row, col - 1), (row, col + 1), (row - 1, col), (row + 1, col)


def plain_rounds(costs, prices, start, goal, limit, step):
    """Return the potential grown in the same order by dictionaries and lists."""
    rows, cols = costs.shape
    potential = np.full((rows, cols), UNREACHED)
    potential[start] = 0.0

    def enterable(cell):
        inside = 0 < cell[0] < rows - 1 and 0 < cell[1] < cols - 1
        return inside and prices[costs[cell]] < math.inf

    current = list(filter(enterable, sides(start)))
    later: list = []
    while current:
        following: list = []
        for index, cell in enumerate(current):
            around = [potential[other] for other in sides(cell)]
            price = prices[costs[cell]]
            value = plain_value(min(around[:2]), min(around[2:]), price)
            if value >= potential[cell]:
                continue
            potential[cell] = value
            target = following if value < limit else later
            for other in sides(cell):
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
    growth = kernels.Growth(254.0, 100.0, 10**9, 50.0, 48.5, 800.0)
    memory = kernels.new_memory(rows, cols, np.float64)
    focus = kernels.Focus(0.0, 0.0, math.inf)
    kernels.grow(terrain, ends_of(start, goal, cols), growth, focus, memory, 1)
    # work space is left as it was found
    assert not memory.pending.reshape(rows, cols)[1:-1, 1:-1].any()
    potential = memory.potentials[1]
    window = memory.windows[1]
    reached = potential.copy().reshape(rows, cols)
    for row, col in (start, goal):
        assert window[0] <= row < window[1] and window[2] <= col < window[3]
    kernels.forget(potential, cols, window)
    assert (potential == UNREACHED).all()
    return reached


def ends_of(start, goal, cols):
    return kernels.Ends(start[0] * cols + start[1], goal[0] * cols + goal[1])


def random_costs(seed):
    rng = np.random.default_rng(seed)
    kinds = np.array([0, 177, 193, 210, 241, INSCRIBED, LETHAL], np.uint8)
    costs = rng.choice(kinds, (40, 50), p=[0.6, 0.1, 0.1, 0.1, 0.1, 0, 0])
    costs[rng.random(costs.shape) < 0.15] = LETHAL
    costs[:3, :3] = costs[-3:, -3:] = 0
    return costs


def grid_of(costs):
    costmap = Costmap(CostmapConfig(), *costs.shape, 0.05, (-1.0, 2.0))
    costmap.costs[:] = costs
    return costmap


def free_grid(rows, cols):
    return grid_of(np.zeros((rows, cols), np.uint8))


def plan_on(costmap, start, goal, **config):
    """Return the plan of a new planner."""
    return GlobalPlanner(GlobalPlanConfig(**config)).plan(costmap, start, goal)


def center(costmap, row, col, yaw=0.0):
    x = costmap.origin_x + (col + 0.5) * costmap.resolution
    y = costmap.origin_y + (row + 0.5) * costmap.resolution
    return Pose2D(x, y, yaw)


def path_length(poses):
    """Return the arc length in meters of points (n, 2 or more)."""
    return float(np.hypot(np.diff(poses[:, 0]), np.diff(poses[:, 1])).sum())


def test_prices_are_navfns():
    prices = cell_prices(GlobalPlanConfig())
    expected = {0: 50.0, 177: 191.0, 241: 242.0, 252: 251.0, 255: 253.0}
    expected |= {INSCRIBED: math.inf, LETHAL: math.inf}
    assert {cost: prices[cost] for cost in expected} == expected


# one on the border is never reached: everything is grown
@pytest.mark.parametrize("goal", [(38, 48), (0, 0)])
@pytest.mark.parametrize("seed", range(4))
def test_the_potential_equals_the_plain_one_in_the_same_order(seed, goal):
    costs = random_costs(seed)
    start = (1, 1)
    prices = cell_prices(GlobalPlanConfig())
    expected = plain_rounds(costs, prices, start, goal, 254.0, 100.0)
    assert_array_equal(grown(costs, start, goal), expected)


def test_leaving_out_far_obstacles_does_not_change_the_plan():
    differing = 0
    planned = 0
    for seed in range(40):
        costmap = grid_of(np.pad(random_costs(seed), ((10, 10), (30, 30))))
        ends = (center(costmap, 11, 31), center(costmap, 47, 77))
        bounded = plan_on(costmap, *ends).poses
        whole = plan_on(costmap, *ends, bounded=False).poses
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
    plan = plan_on(costmap, start, goal)
    free = np.pad(costs[1:-1, 1:-1] < INSCRIBED, 1)
    regions, _ = label(free)
    assert (plan.poses is not None) == (regions[1, 1] == regions[37, 47])
    if plan.poses is None:
        assert plan.reason == "no way to the goal"
        return
    assert tuple(plan.poses[-1]) == goal.numbers
    assert math.dist(plan.poses[0, :2], start.position) < 0.05
    steps = np.diff(plan.poses[:, :2], axis=0)
    assert np.hypot(*steps.T).max() < 0.05 * 1.5 * math.sqrt(2.0) + 1e-9
    for x, y in plan.poses[:, :2]:
        assert costs[costmap.world_to_cell(x, y)] < INSCRIBED


def test_a_plan_on_open_ground_is_nearly_straight():
    costmap = free_grid(200, 200)
    start = center(costmap, 20, 30)
    goal = center(costmap, 170, 110)
    poses = plan_on(costmap, start, goal).poses
    assert path_length(poses) < 1.02 * start.distance(goal)
    assert_allclose(poses[5:-5, 2], math.atan2(150, 80), atol=0.25)


def test_the_quirks_are_half_a_cell_and_no_heading():
    costmap = free_grid(60, 60)
    ends = (center(costmap, 10, 10), center(costmap, 40, 30, yaw=0.7))
    quirks = {"half_cell_offset": False, "zero_intermediate_yaw": True}
    right = plan_on(costmap, *ends).poses
    shifted = plan_on(costmap, *ends, **quirks).poses
    assert_allclose(right[:-1, :2] - shifted[:-1, :2], 0.025, atol=1e-12)
    assert (shifted[:-1, 2] == 0.0).all() and shifted[-1, 2] == 0.7


def test_why_there_is_no_plan_is_said():
    costs = np.zeros((40, 40), np.uint8)
    costs[:, 20] = LETHAL
    costs[10, 30] = INSCRIBED
    costmap = grid_of(costs)
    planner = GlobalPlanner(GlobalPlanConfig())
    start = center(costmap, 10, 10)
    off_the_map = Pose2D(50.0, 0.0, 0.0)
    for goal, reason in (
        (center(costmap, 30, 30), "no way to the goal"),
        (center(costmap, 10, 30), "the goal is inside an obstacle"),
        (off_the_map, "the goal is off the global costmap"),
        (Pose2D(math.nan, 0.0, 0.0), "the goal is off the global costmap"),
    ):
        assert planner.plan(costmap, start, goal).reason == reason
    plan = planner.plan(costmap, off_the_map, start)
    assert plan.reason == "the robot is off the global costmap"
    poses = planner.plan(costmap, start, Pose2D(*start.position, 2.0)).poses
    assert poses.tolist() == [[*start.position, 2.0]]


def test_the_robots_own_cell_counts_as_free():
    costmap = free_grid(40, 40)
    costmap.costs[10, 10] = LETHAL
    plan = plan_on(costmap, center(costmap, 10, 10), center(costmap, 30, 30))
    assert plan.poses is not None


@pytest.mark.parametrize("bounded", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_a_plan_lasts_as_long_as_a_new_one_would_be_equal(seed, bounded):
    costmap = grid_of(np.pad(random_costs(seed), 15))
    ends = (center(costmap, 16, 16), center(costmap, 52, 62))
    planner = GlobalPlanner(GlobalPlanConfig(bounded=bounded))
    rng = np.random.default_rng(seed)
    unchanged = 0
    last = planner.plan(costmap, *ends)
    for _ in range(300):
        cell = (rng.integers(1, 69), rng.integers(1, 79))
        if cell not in ((16, 16), (52, 62)):
            costmap.costs[cell] = rng.choice([0, 177, 193, INSCRIBED, LETHAL])
        plan = planner.plan(costmap, *ends)
        anew = plan_on(costmap, *ends, bounded=bounded)
        assert_array_equal(plan.poses, anew.poses)
        unchanged += plan is last
        last = plan
    assert 10 < unchanged < 290


def test_a_new_goal_start_or_grid_needs_a_new_plan():
    costmap = free_grid(60, 60)
    start = center(costmap, 10, 10)
    goal = center(costmap, 40, 30)
    planner = GlobalPlanner(GlobalPlanConfig())
    plan = planner.plan(costmap, start, goal)
    in_the_same_cell = Pose2D(start.x + 0.01, start.y, 0.3)
    assert planner.plan(costmap, in_the_same_cell, goal) is plan
    turned = planner.plan(costmap, start, Pose2D(*goal.position, 1.0))
    assert turned is not plan
    assert turned.poses[-1, 2] == 1.0
    assert planner.plan(costmap, center(costmap, 10, 11), goal) is not plan
    plan = planner.plan(costmap, start, goal)
    costmap.origin_x += costmap.resolution
    moved = planner.plan(costmap, start, goal)
    assert_allclose(moved.poses[-1], plan.poses[-1])
    assert moved is not plan


f32 = np.float32


def plain_slope(before, here, after):
    """Return how the potential falls along an axis."""
    if here >= UNREACHED:
        if before < UNREACHED:
            return f32(-254.0)
        return f32(254.0 if after < UNREACHED else 0.0)
    falls = [
        f32(lower - higher)
        for lower, higher in ((before, here), (here, after))
        if max(lower, higher) < UNREACHED
    ]
    return f32(sum(falls, f32(0)))


def plain_gradient(potential, row, col):
    if not 1 <= row < potential.shape[0] - 1:
        return f32(0), f32(0)
    here = potential[row, col]
    parts = (
        plain_slope(potential[row, col - 1], here, potential[row, col + 1]),
        plain_slope(potential[row - 1, col], here, potential[row + 1, col]),
    )
    norm = f32(math.hypot(*map(float, parts)))
    if norm == 0.0:
        return f32(0), f32(0)
    share = f32(1.0 / float(norm))
    return tuple(f32(share * part) for part in parts)


def mixed(first, second, share):
    """Return the value between two, as C mixes double and single precision."""
    return f32((1.0 - float(share)) * float(first) + float(f32(share * second)))


def whole_cells(cell, offset):
    """Return a cell and the offset from it, which is at most one."""
    if offset > 1.0:
        return cell + 1, f32(offset - 1)
    if offset < -1.0:
        return cell - 1, f32(offset + 1)
    return cell, offset


def plain_navfn_path(potential, start, goal, most):
    """Return the points (column, row) from the goal to the start and whether they arrive, step by step in float32."""
    (row, col), dx, dy, points = goal, f32(0), f32(0), []
    while len(points) < most:
        down, right = (
            int(math.copysign(math.floor(abs(float(part)) + 0.5), part))
            for part in (dy, dx)
        )
        if potential[row + down, col + right] < 50.0:
            return [*points, (start[1], start[0])], True
        points.append((f32(f32(col) + dx), f32(f32(row) + dy)))
        around = potential[row - 1 : row + 2, col - 1 : col + 2]
        if around.max() >= UNREACHED or (len(points) > 2 and points[-3] == points[-1]):
            here = potential[row, col]
            lowest = math.floor(here) if here < UNREACHED else -(2**31)
            best = (1, 1)
            for cell in np.ndindex(3, 3):
                if around[cell] < lowest:
                    lowest = math.floor(around[cell])
                    best = cell
            row, col, dx, dy = row + best[0] - 1, col + best[1] - 1, f32(0), f32(0)
            if potential[row, col] >= UNREACHED:
                return points, False
            continue
        above, below = (
            zip(
                plain_gradient(potential, line, col),
                plain_gradient(potential, line, col + 1),
                strict=True,
            )
            for line in (row, row + 1)
        )
        way = [
            mixed(mixed(*low, dx), mixed(*high, dx), dy)
            for low, high in zip(above, below, strict=True)
        ]
        if way == [0.0, 0.0]:
            return points, False
        share = f32(f32(0.5) / f32(math.hypot(*map(float, way))))
        col, dx = whole_cells(col, f32(dx + f32(way[0] * share)))
        row, dy = whole_cells(row, f32(dy + f32(way[1] * share)))
    return points, False


@pytest.mark.parametrize("seed", range(12))
def test_navfns_descent_equals_the_plain_one_bit_by_bit(seed):
    costs = random_costs(seed)
    start = (1, 1)
    goal = (37, 47)
    potential = grown(costs, start, (0, 0)).astype(np.float32)
    if potential[goal] >= UNREACHED:
        pytest.skip("there is no way in this world")
    ends = ends_of(start, goal, 50)
    for most in (200, 30):
        points = np.empty((most, 2), np.float32)
        n, arrived = descent.descend_as_navfn(potential.ravel(), 50, ends, 50.0, points)
        expected, expected_arrived = plain_navfn_path(potential, start, goal, most)
        assert arrived == expected_arrived and (most == 200 or not arrived)
        assert_array_equal(points[:n], np.array(expected, np.float32))


@pytest.mark.parametrize("unfinished", [False, True])
def test_as_navfn_an_incomplete_plan_is_optional(unfinished):
    # four columns: sixteen points do not lead along forty rows
    narrow = free_grid(40, 4)
    robot = center(narrow, 2, 1)
    goal = center(narrow, 37, 2)
    plan = plan_on(narrow, robot, goal, as_navfn=True, unfinished_plans=unfinished)
    if unfinished:
        assert len(plan.poses) == 17
        assert math.dist(plan.poses[0, :2], robot.position) > 0.5
    else:
        assert plan.poses is None and plan.reason == "no way to the goal"


def test_as_navfn_the_number_of_rounds_is_bounded():
    costmap = free_grid(21, 21)
    for k in range(2, 19, 2):  # a way of more than 42 cells, to and fro
        costmap.costs[k, 1:-2] = LETHAL
        costmap.costs[k, [1, 19]] = (0, LETHAL) if k % 4 else (LETHAL, 0)
    ends = center(costmap, 1, 10), center(costmap, 19, 10)
    assert plan_on(costmap, *ends).poses is not None
    assert plan_on(costmap, *ends, as_navfn=True).reason == "no way to the goal"


@pytest.mark.parametrize("as_navfn", [False, True])
@pytest.mark.parametrize("place", [(0, 20), (20, 0), (39, 20), (20, 39), (0, 0)])
def test_a_robot_in_the_outermost_cells_is_planned_from(place, as_navfn):
    costmap = free_grid(40, 40)
    start = center(costmap, *place)
    goal = center(costmap, 30, 25)
    poses = plan_on(costmap, start, goal, as_navfn=as_navfn).poses
    if place == (0, 0):
        assert poses is None, "all neighbors of a corner are blocked"
    else:
        assert math.dist(poses[0, :2], start.position) < 0.05
