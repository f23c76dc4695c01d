"""The costmap against plain slow references and against the rules it follows."""

import math
from operator import itemgetter

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.ndimage import distance_transform_edt, shift

from barn_planners.costmap import inflation, kernels
from barn_planners.costmap.config import CostmapConfig, GlobalCostmapConfig, rectangle
from barn_planners.costmap.costmap import Costmap, RollingCostmap, global_costmap
from barn_planners.costmap.inflation import costs_by_square
from barn_planners.costmap.kernels import INSCRIBED, LETHAL, Pose, Window
from barn_worlds.base.types import ORIGIN, OccupancyMap, Pose2D, Scan

AHEAD = Pose2D(10.0, 0.0, 0.0)


def scan_of(ranges, angle_min=-2.3, increment=None):
    ranges = np.asarray(ranges, np.float32)
    step = increment if increment is not None else 4.6 / max(1, len(ranges) - 1)
    return Scan(0, ranges, angle_min, step, 0.1, 30.0)


AT_1_M = scan_of([1.0], angle_min=0.0)
NOTHING = scan_of([np.inf])


def lethal_count(costmap):
    return (costmap.costs == LETHAL).sum()


def plain_cost(distance_cells, config, resolution):
    d = distance_cells * resolution
    if distance_cells == 0:
        return LETHAL
    if d <= config.inscribed_m + 1e-9:
        return INSCRIBED
    reach = math.ceil(config.inflation_radius_m / resolution - 1e-9)
    if config.soft_costs and distance_cells <= reach:
        beyond_m = d - config.inscribed_m
        return int(252.0 * math.exp(-config.cost_scaling_per_m * beyond_m))
    return 0


def plain_inflation(lethal, config, resolution):
    if not lethal.any():
        return np.zeros(lethal.shape, np.uint8)
    distances = distance_transform_edt(lethal == 0)
    return np.vectorize(plain_cost, [np.uint8])(distances, config, resolution)


def plain_line(row, col, end_row, end_col):
    """Return the cells of a line: along its longer axis one cell per step, the other coordinate to the nearest cell."""
    down = end_row - row
    right = end_col - col
    n = max(abs(down), abs(right))
    if n == 0:
        return [(row, col)]
    cells = []
    for k in range(n + 1):
        # The nearest whole number, away from the start at a tie after half of an even step count.
        offset_row = (abs(down) * k + n // 2) // n
        offset_col = (abs(right) * k + n // 2) // n
        at = offset_row if down >= 0 else -offset_row
        beside = offset_col if right >= 0 else -offset_col
        cells.append((row + at, col + beside))
    return cells


def plain_outline(corners):
    """Return the cells of the sides of a polygon whose corners are cells."""
    ends = zip(corners, [*corners[1:], corners[0]], strict=True)
    return [cell for first, last in ends for cell in plain_line(*first, *last)]


def plain_update(costmap, lethal, pose, scan, lidar):
    """Return the lethal cells after a scan, by sets of cells and plain loops."""
    config, rows, cols = costmap.config, *lethal.shape
    sensor = pose @ lidar
    cleared = set()
    marked = set()

    def seen(distance, angle):
        """Return the cell at a distance and an angle."""
        x = sensor.x + distance * math.cos(angle)
        return costmap.cell(x, sensor.y + distance * math.sin(angle))

    for k, reading in enumerate(scan.ranges):
        r = float(reading)
        if not scan.range_min <= r < scan.range_max:
            continue
        angle = sensor.yaw + scan.angle_min + k * scan.angle_increment
        tip = seen(min(r, config.raytrace_range_m), angle)
        cleared |= set(plain_line(*costmap.cell(*sensor.position), *tip))
        if r < config.obstacle_range_m:
            marked.add(seen(r, angle))
    after = lethal.copy()
    footprint = plain_footprint(costmap, pose)
    for cells, value in ((cleared, False), (marked, True), (footprint, False)):
        for row, col in cells:
            if 0 <= row < rows and 0 <= col < cols:
                after[row, col] = value
    return after


def plain_footprint(costmap, pose):
    """Return outline and inside of the padded footprint: in every column all cells between two of the outline."""
    a, b = costmap.outline[0]
    places = [pose @ Pose2D(x, y, 0.0) for x, y in ((a, b), (-a, b), (-a, -b), (a, -b))]
    outline = plain_outline([costmap.cell(*place.position) for place in places])
    cells = set()
    for col in {col for _, col in outline}:
        rows = [row for row, other in outline if other == col]
        cells |= {(row, col) for row in range(min(rows), max(rows) + 1)}
    return cells


def test_costs_beside_a_lethal_cell_are_the_published_ones():
    costs = costs_by_square(CostmapConfig(), 0.05)
    assert set(costs.tolist()) == {0, 177, 193, 210, 241, INSCRIBED, LETHAL}
    assert [costs[k * k] for k in range(8)] == [254, 253, 253, 253, 253, 253, 177, 0]
    squares = [2**2 + 5**2, 4**2 + 4**2, 3**2 + 5**2]
    assert costs[squares].tolist() == [241, 210, 193]


@pytest.mark.parametrize(
    "config, share",
    [
        (CostmapConfig(), 0.02),
        (CostmapConfig(footprint_padding_m=0.03, soft_costs=False), 0.02),
        (CostmapConfig(inflation_radius_m=10.0, cost_scaling_per_m=0.4), 0.001),
    ],
)
def test_inflation_of_a_window_equals_the_plain_one(config, share):
    rng = np.random.default_rng(1)
    lethal = (rng.random((40, 50)) < share).astype(np.uint8)
    expected = rng.integers(0, 255, lethal.shape).astype(np.uint8)
    layers = layers_of(lethal, config)
    layers.costs[:] = expected
    inflation.inflate(layers, Window(7, 31, 0, 44))
    expected[7:31, :44] = plain_inflation(lethal, config, 0.05)[7:31, :44]
    assert_array_equal(layers.costs, expected)


def layers_of(lethal, config):
    layers = inflation.new_layers(*lethal.shape, costs_by_square(config, 0.05))
    layers.marks.cells[:] = lethal
    return layers


@pytest.mark.parametrize("seed", range(3))
def test_marks_and_costs_equal_the_plain_ones(seed):
    """Marks stay where they are in the world; those that have left the grid are forgotten."""
    config = CostmapConfig(
        size_m=4.0, resolution_m=0.1, obstacle_range_m=3.5, raytrace_range_m=3.6
    )
    costmap = RollingCostmap(config)
    rng = np.random.default_rng(seed)
    pose = ORIGIN
    lidar = Pose2D(0.12, -0.2, 0.3)
    lethal = np.zeros((40, 40), bool)
    corner = None
    for step in range(15):
        ranges = rng.uniform(0.05, 5.0, 90)
        ranges[rng.random(90) < 0.2] = rng.choice([np.inf, -np.inf, 30.0, 10.0])
        ranges[step] = np.nan
        scan = scan_of(ranges)
        before = corner
        costmap.update(pose, scan, lidar)
        assert costmap.cell(*pose.position) == (20, 20)
        assert costmap.cost_at(pose.x + 2.1, pose.y) is None
        corner = np.rint(np.array([costmap.origin_y, costmap.origin_x]) / 0.1)
        if before is not None:
            lethal = shift(lethal, before - corner, order=0)
        lethal = plain_update(costmap, lethal, pose, scan, lidar)
        assert_array_equal(costmap.costs == LETHAL, lethal)
        expected = plain_inflation(lethal, config, 0.1)
        assert_array_equal(costmap.costs, expected)
        x, y = rng.uniform(-1.0, 1.0, 2) ** 3 * rng.choice([1.0, 5.0])
        pose = Pose2D(pose.x + x, pose.y + y, rng.uniform(-3.0, 3.0))


def test_the_map_stays_whatever_the_lidar_sees_and_forgets():
    static_map = OccupancyMap(np.zeros((20, 20), np.int8), 0.15, -1.5, -1.5)
    static_map.data[10, 15] = 100
    costmap = global_costmap(GlobalCostmapConfig(), static_map, AHEAD)
    assert costmap.costs.shape == (60, 60) and lethal_count(costmap) == 9
    costmap.update(Pose2D(0.0, 0.05, 0.0), scan_of([2.0], angle_min=0.0), ORIGIN)
    costmap.update(Pose2D(0.8, 0.05, 0.0), NOTHING, ORIGIN)
    costmap.reset()
    assert lethal_count(costmap) == 9
    coarse = global_costmap(GlobalCostmapConfig(map_resolution=True), static_map, AHEAD)
    assert coarse.costs.shape == (20, 20) and coarse.resolution == pytest.approx(0.15)
    bare = global_costmap(GlobalCostmapConfig(lidar_marks=False), static_map, AHEAD)
    bare.update(Pose2D(-1.0, -1.0, 0.0), AT_1_M, ORIGIN)
    assert lethal_count(bare) == 9


def test_clearing_keeps_a_square_about_the_robot():
    costmap = RollingCostmap(CostmapConfig(clear_footprint=False))
    two = scan_of([1.0, 2.3], angle_min=0.0, increment=math.pi / 2)
    costmap.update(ORIGIN, two, ORIGIN)
    assert lethal_count(costmap) == 2
    costmap.clear_outside(ORIGIN, 3.0)
    assert costmap.cost_at(1.01, 0.01) == LETHAL and lethal_count(costmap) == 1
    costmap.reset()
    assert not costmap.costs.any()


def test_the_highest_cost_along_the_edges_looks_at_edges_only():
    costmap = Costmap(CostmapConfig(), 60, 60, 0.05, (0.0, 0.0))
    costs = costmap.costs
    corners = kernels.corners_at(rectangle(0.31, 0.265), Pose(1.5, 1.5, 0.4))
    grid = kernels.Grid(0.0, 0.0, 0.05)
    outline = set(plain_outline([costmap.cell(*corner) for corner in corners]))
    costs[30, 30] = LETHAL
    assert (30, 30) not in outline and kernels.edge_cost(costs, corners, grid) == 0
    for value, expected in ((177, 177), (INSCRIBED, INSCRIBED), (LETHAL, -1)):
        for cell in outline:
            costs[cell] = value
            assert kernels.edge_cost(costs, corners, grid) == expected
            costs[cell] = 0
    off = kernels.corners_at(rectangle(0.31, 0.265), Pose(0.2, 1.5, 0.0))
    assert kernels.edge_cost(costs, off, grid) == -1


def test_costmaps_as_maps_tell_free_inscribed_and_lethal():
    costmap = RollingCostmap(CostmapConfig(clear_footprint=False))
    costmap.update(ORIGIN, AT_1_M, ORIGIN)
    grid_map = costmap.as_map()
    data = grid_map.data
    costs = costmap.costs
    assert data.dtype == np.int8 and grid_map.resolution == 0.05
    assert (data == 100).sum() == 1
    assert (data == 99).sum() == (costs == INSCRIBED).sum()
    is_soft = (costs > 0) & (costs < INSCRIBED)
    assert ((data > 0) & (data < 99)).sum() == is_soft.sum()


def test_a_goal_lies_on_the_global_costmap_however_far_it_is():
    config = GlobalCostmapConfig()
    costmap = global_costmap(config, None, AHEAD)
    assert costmap.costs.shape == RollingCostmap(config).costs.shape
    for goal in (Pose2D(20.0, 0.0, 0.0), Pose2D(-3.0, -60.0, 0.0)):
        costmap = global_costmap(config, None, goal)
        costmap.update(ORIGIN, NOTHING, ORIGIN)
        assert costmap.cost_at(*goal.position) is not None
    for far in (1e6, math.inf, math.nan):  # planners say that it is off the costmap
        costmap = global_costmap(config, None, Pose2D(far, 0.0, 0.0))
        assert costmap.config == config


def plain_points(pose, scan, lidar_x):
    """Return the lidar's place and the points (n, 2) that it sees, each number rounded to single precision."""
    f = np.float32
    sensor = pose @ Pose2D(lidar_x, 0.0, 0.0)
    z = f(math.sin(0.5 * sensor.yaw))
    w = f(math.cos(0.5 * sensor.yaw))
    cos = f(f(1.0) - f(f(2.0 * z) * z))
    sin = f(f(2.0 * z) * w)
    points = []
    for r, angle in zip(scan.ranges, scan.angles(), strict=True):
        if scan.range_min <= r < scan.range_max:
            x = f(float(r) * math.cos(angle))
            y = f(float(r) * math.sin(angle))
            along = f(f(cos * x) - f(sin * y))
            across = f(f(sin * x) + f(cos * y))
            points.append((f(along + f(sensor.x)), f(across + f(sensor.y))))
    return sensor.position, np.array(points, np.float64).reshape(-1, 2)


def plain_ray(costmap, sensor, point):
    """Return the cells that the ray to a point clears, where that is pulled in to the grid's edges."""
    rows, cols = costmap.costs.shape
    x0 = costmap.origin_x
    y0 = costmap.origin_y
    sx, sy = sensor
    x, y = point
    a = x - sx
    b = y - sy
    x1 = x0 + cols * costmap.resolution
    y1 = y0 + rows * costmap.resolution
    if x < x0:
        x = x0
        y = sy + b * (x0 - sx) / a
    if y < y0:
        x = sx + a * (y0 - sy) / b
        y = y0
    if x > x1:
        x = x1 - 0.001
        y = sy + b * (x1 - sx) / a
    if y > y1:
        x = sx + a * (y1 - sy) / b
        y = y1 - 0.001
    cell = costmap.world_to_cell(x, y)
    if cell is None:
        return []
    first = costmap.cell(sx, sy)
    line = plain_line(*first, *cell)
    length = math.dist(first, cell)
    if not length:
        return line
    most = math.ceil(costmap.config.raytrace_range_m / costmap.resolution)
    share = min(1.0, most / length)
    return line[: 1 + int(share * (len(line) - 1))]


def filled_footprint(costmap, pose):
    """Return the cells that costmap_2d clears of a footprint: none if a corner is off the grid.

    Cells of the outline, from the rear right corner on, are sorted by column; each column takes its first two for its
    own, even where the second one is of the next column.
    """
    a, b = costmap.outline[0]
    places = [pose @ Pose2D(x, y, 0.0) for x, y in ((-a, -b), (-a, b), (a, b), (a, -b))]
    if not all(costmap.world_to_cell(*place.position) for place in places):
        return set()
    outline = plain_outline([costmap.cell(*place.position) for place in places])
    cells = set(outline)
    waiting = sorted(outline, key=itemgetter(1))
    for col in range(waiting[0][1], waiting[-1][1] + 1):
        if len(waiting) < 2:
            break
        current, waiting = waiting[:2], waiting[2:]
        while waiting and waiting[0][1] == col:
            current.append(waiting.pop(0))
        rows = [row for row, _ in current]
        cells |= {(row, col) for row in range(min(rows), max(rows))}
    return cells


def test_as_costmap_2d_marks_equal_the_plain_ones():
    config = CostmapConfig(size_m=8.0, resolution_m=0.1, as_costmap_2d=True)
    costmap = Costmap(config, 50, 60, 0.1, (-3.0, -2.5))
    rng = np.random.default_rng(2)
    lethal = np.zeros(costmap.costs.shape, bool)
    for step in range(40):
        pose = Pose2D(*rng.uniform(-2.0, 2.0, 2), rng.uniform(-4.0, 4.0))
        if step % 5 == 0:
            pose = Pose2D(-2.95 if step % 10 else -3.2, 2.3, pose.yaw)
        ranges = rng.uniform(0.05, 6.0, 60)
        ranges[rng.random(60) < 0.2] = np.inf
        scan = scan_of(ranges)
        costmap.update(pose, scan, Pose2D(0.12, 0.0, 0.0))
        sensor, points = plain_points(pose, scan, 0.12)
        if costmap.world_to_cell(*sensor):
            for point in points:
                for cell in plain_ray(costmap, sensor, point):
                    lethal[cell] = False
        for point in points:
            cell = costmap.world_to_cell(*point)
            if cell and math.dist(point, sensor) < config.obstacle_range_m:
                lethal[cell] = True
        for cell in filled_footprint(costmap, pose):
            lethal[cell] = False
        assert_array_equal(costmap.costs == LETHAL, lethal)
        expected = plain_inflation(lethal, config, 0.1)
        assert_array_equal(costmap.costs, expected)


def test_as_costmap_2d_the_window_follows_by_whole_cells():
    costmap = RollingCostmap(CostmapConfig(size_m=4.0, as_costmap_2d=True))
    origin = 0.0
    places = []
    for x in (0.0, 0.04, 0.07, 0.03, -0.02, -0.06, 0.3, 0.31):
        costmap.update(Pose2D(x, 0.0, 0.0), NOTHING, ORIGIN)
        origin += math.trunc((x - 0.5 * 79.5 * 0.05 - origin) / 0.05) * 0.05
        assert costmap.origin_x == origin
        places.append(round(origin / 0.05))
    assert len(set(places)) > 2 and places[1] == places[2] == places[3]


def plain_front(lethal, by_square, reach):
    """Return the costs by a front that spreads from lethal cells, in bins of equal distance, the first one first."""
    bins = {square: [] for square in range(reach * reach + 1)}
    bins[0] = [(cell, cell) for cell in map(tuple, np.argwhere(lethal))]
    costs = np.zeros(lethal.shape, np.uint8)
    cells = set(np.ndindex(lethal.shape))
    for square, waiting in bins.items():
        for (row, col), source in waiting:  # which may grow meanwhile
            if (row, col) not in cells:
                continue
            cells.remove((row, col))
            costs[row, col] = by_square[square]
            beside = [(row, col - 1), (row - 1, col), (row, col + 1), (row + 1, col)]
            for other in beside:
                away = (other[0] - source[0]) ** 2 + (other[1] - source[1]) ** 2
                if away in bins:
                    bins[away].append((other, source))
    return costs


@pytest.mark.parametrize("seed", range(4))
def test_inflation_by_a_front_equals_the_plain_one(seed):
    config = CostmapConfig(footprint_padding_m=0.04)
    lethal = (np.random.default_rng(seed).random((60, 70)) < 0.03).astype(np.uint8)
    layers = layers_of(lethal, config)
    inflation.inflate_by_front(layers, Window(0, 60, 0, 70))
    costs = layers.costs
    by_square = costs_by_square(config, 0.05)
    assert_array_equal(costs, plain_front(lethal, by_square, 6))
    exact = plain_inflation(lethal, config, 0.05)
    assert (costs != exact).sum() < 40
    assert (costs <= exact).all()
