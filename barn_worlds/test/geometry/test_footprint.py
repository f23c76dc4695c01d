"""Distances and times to contact of footprints, against plain references."""

import math

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from barn_worlds.geometry.bodies import shape_rows
from barn_worlds.geometry.footprint import Footprint, Rectangle
from barn_worlds.geometry.kernels import distance_to_line
from barn_worlds.robots.contact import contact_footprint
from barn_worlds.robots.files import STANDARD_ROBOT, load_robot

POLYGON = Footprint(
    np.array([[0.5, 0.0], [0.2, 0.3], [-0.3, 0.2], [-0.3, -0.25], [0.1, -0.3]])
)
DISC = Footprint(np.array([[0.3, 0.3], [-0.3, 0.3], [-0.3, -0.3], [0.3, -0.3]]), 0.25)
BOX = Rectangle([-0.3, -0.2, 0.5, 0.25])
OUTLINES = {"polygon": POLYGON, "disc": DISC, "box": BOX}


@pytest.fixture(params=OUTLINES.values(), ids=OUTLINES.keys())
def outline(request):
    return request.param


def boundary(outline):
    """Return dense points (n, 2) of an outline's edge."""
    if outline.radius_m:
        angles = np.linspace(0.0, 2.0 * math.pi, 4000, endpoint=False)
        return outline.radius_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    corners = outline.corners_m
    return np.concatenate(
        [
            np.linspace(a, b, 1000)
            for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)
        ]
    )


def inside(outline, point):
    if outline.radius_m:
        return math.hypot(*point) < outline.radius_m
    corners = outline.corners_m
    after = np.roll(outline.corners_m, -1, axis=0)
    sides = after - corners
    away = np.asarray(point) - corners
    cross = sides[:, 0] * away[:, 1] - sides[:, 1] * away[:, 0]
    return (cross > 0.0).all()


def test_point_distances_are_to_the_nearest_edge_point(outline):
    edge = boundary(outline)
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.9, 0.9, (200, 2))
    is_inside = [inside(outline, point) for point in points]
    nearest_m = cdist(points, edge).min(axis=1)
    expected = np.where(is_inside, -nearest_m, nearest_m)
    assert outline.distances(*points.T.copy()) == pytest.approx(expected, abs=1e-3)
    for point, distance in zip(points, expected, strict=True):
        away = math.dist(outline.nearest(*point), point)
        assert away == (pytest.approx(distance, abs=1e-3) if distance > 0.0 else 0.0)
    assert sum(is_inside) > 5


def some_shapes(rng, count=60):
    box = np.arange(count) % 2 == 1
    sizes = np.where(box[:, None], rng.uniform(0.1, 0.8, (count, 2)), 0.0)
    radii = np.where(box, 0.0, rng.uniform(0.05, 0.3, count))
    return shape_rows(
        rng.uniform(-1.5, 1.5, (count, 2)), radii, sizes, rng.uniform(-3.0, 3.0, count)
    )


def points_of(shape):
    """Return dense points (n, 2) on the edge and inside of a shape."""
    if shape[2] > 0.0:
        angles, radii = np.meshgrid(
            np.linspace(0.0, 2.0 * math.pi, 200), np.linspace(0.0, shape[2], 12)
        )
        along = radii * np.cos(angles)
        across = radii * np.sin(angles)
    else:
        along, across = np.meshgrid(
            np.linspace(-shape[3], shape[3], 60), np.linspace(-shape[4], shape[4], 60)
        )
    turn = np.array([[shape[5], shape[6]], [-shape[6], shape[5]]])
    return shape[:2] + np.column_stack([along.ravel(), across.ravel()]) @ turn


def test_gaps_are_those_of_a_search(outline):
    shapes = some_shapes(np.random.default_rng(1))
    x = 0.2
    y = -0.1
    yaw = 0.8
    gaps = outline.gaps(shapes, x, y, yaw)
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    for gap, shape in zip(gaps, shapes, strict=True):
        local = (points_of(shape) - (x, y)) @ turn
        distance = outline.distances(*local.T.copy()).min()
        assert gap == pytest.approx(max(distance, 0.0), abs=0.02)
    assert (gaps == 0.0).any()
    assert (gaps > 0.5).any()


@pytest.mark.parametrize("yaw, speed", [(0.8, 0.4), (-0.7, 1.5), (2.0, -0.8)])
def test_times_to_contact_are_those_of_a_search(outline, yaw, speed):
    rng = np.random.default_rng(2)
    shapes = some_shapes(rng, 40)
    velocities = rng.uniform(-1.0, 1.0, (40, 2))
    discs = shapes.copy()
    discs[:, 2] += np.hypot(shapes[:, 3], shapes[:, 4])  # around boxes
    discs[:, 3:5] = 0.0
    x = 0.2
    y = -0.1
    times = outline.times_to_contact(shapes, velocities, x, y, yaw, speed)

    def gaps(time_s):
        later_discs = discs.copy()
        later_discs[:, :2] += time_s * velocities
        return outline.gaps(
            later_discs,
            x + time_s * speed * math.cos(yaw),
            y + time_s * speed * math.sin(yaw),
            yaw,
        )

    expected = np.full(40, math.inf)
    for time_s in np.arange(0.0, 4.0, 0.005)[::-1]:  # the first contact is written last
        expected[gaps(time_s) == 0.0] = time_s
    within = np.isfinite(expected) | (times < 3.9)
    assert times[within] == pytest.approx(expected[within], abs=0.02)
    assert max(gaps(times[i])[i] for i in np.flatnonzero(np.isfinite(times))) < 1e-6
    assert (times <= expected + 1e-9).all()
    assert np.isfinite(times).sum() > 5
    assert np.isinf(times).any()


def test_what_can_touch_of_robots():
    jackal, husky, round_one = (
        contact_footprint(load_robot(name).chassis)
        for name in ("jackal", "husky", "turtlebot4")
    )
    assert (contact_footprint(STANDARD_ROBOT.chassis).extent_m == jackal.extent_m).all()
    assert jackal.extent_m == pytest.approx(
        [-0.229, -0.207795, 0.229, 0.207795]
    )  # the wheels, without the bumpers
    assert husky.extent_m == pytest.approx(load_robot("husky").chassis.extent_m)
    assert isinstance(jackal, Rectangle) and isinstance(husky, Rectangle)
    assert round_one.radius_m == 0.171
    assert round_one.extent_m == pytest.approx([-0.171, -0.171, 0.171, 0.171])


@pytest.mark.parametrize("seed", range(5))
def test_the_distance_from_a_line_is_that_of_its_nearest_point(seed):
    rng = np.random.default_rng(seed)
    line = rng.uniform(-1.0, 1.0, (6, 2))
    x, y = point = rng.uniform(-2.0, 2.0, 2)
    line[3] = line[2]
    dense = np.linspace(line[:-1], line[1:], 2001).reshape(-1, 2)
    nearest_m = np.linalg.norm(dense - point, axis=1).min()
    assert distance_to_line(line, x, y) == pytest.approx(nearest_m, abs=2e-3)
    assert distance_to_line(line[:1], x, y) == pytest.approx(math.dist(line[0], point))
    straight = np.array([[0.0, 0.0], [4.0, 0.0]])
    assert distance_to_line(straight, -1.0, 0.0) == 1.0
