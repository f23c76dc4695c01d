"""The elastic band's kernels against plain recursive references on lists of bubbles."""

import math
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

from barn_planners.costmap.config import CostmapConfig
from barn_planners.costmap.inflation import costs_by_square, inflate, new_layers
from barn_planners.costmap.kernels import Grid, Pose, Window
from barn_planners.eband import kernels
from barn_planners.eband.forces import relax, renew
from barn_planners.eband.planner import bubble_radii

GAINS = kernels.BandGains(0.0, 0.7, 0.01, 1.0, 2.0, 0.75, 0.15, 4, 3, False)
ORIGINAL = GAINS._replace(metres_per_rad=0.408, weighs_x_twice=True)
CAPACITY = 1024
RESOLUTION = 0.05
SIDE = 120
RADII = bubble_radii(10.0)


def grid_with(*cells):
    """Return a costmap with obstacles in some cells, as the kernels take it."""
    layers = new_layers(SIDE, SIDE, costs_by_square(CostmapConfig(), RESOLUTION))
    for cell in cells:
        layers.marks.cells[cell] = 1
    inflate(layers, Window(0, SIDE, 0, SIDE))
    return kernels.Clearance(layers.costs, Grid(0.0, 0.0, RESOLUTION), RADII)


def turned(angle):
    """Return an angle in (-pi, pi]."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


class ReferenceBand:
    """The method on plain lists, with true recursion; bubbles are (x, y, radius, yaw)."""

    def __init__(self, grid, gains):
        self.grid = grid
        self.gains = gains

    class Broken(Exception):
        pass

    def radius(self, x, y):
        costs, (ox, oy, resolution), radii = self.grid
        row = math.floor((y - oy) / resolution)
        col = math.floor((x - ox) / resolution)
        inside = 0 <= row < costs.shape[0] and 0 <= col < costs.shape[1]
        return float(radii[costs[row, col] if inside else 0])

    @staticmethod
    def overlap(a, b):
        return math.dist(a[:2], b[:2]) < GAINS.min_overlap * (a[2] + b[2])

    def fill(self, a, b):
        """Return the bubbles strictly between a and b."""
        if self.overlap(a, b):
            return []
        x = 0.5 * (a[0] + b[0])
        y = 0.5 * (a[1] + b[1])
        radius = self.radius(x, y)
        if radius <= self.gains.tiny_bubble_m:
            raise self.Broken
        middle = (x, y, radius, turned(a[3] + 0.5 * turned(b[3] - a[3])))
        return [*self.fill(a, middle), middle, *self.fill(middle, b)]

    def refine(self, band):
        if len(band) < 2:
            raise self.Broken
        first = band[0]
        last = band[-1]
        if self.overlap(first, last):
            return [first, last]
        if len(band) == 2:
            return [first, *self.fill(first, last), last]
        half = (len(band) - 1) // 2
        left = self.refine(band[: half + 1])
        right = self.refine(band[half:])
        if self.overlap(left[-2], right[1]):
            return left[:-1] + right[1:]
        return left[:-1] + right

    def between(self, bubble, other):
        """Return the way to another bubble, a turn counted in meters."""
        turn = self.gains.metres_per_rad * turned(other[3] - bubble[3])
        return np.array([other[0] - bubble[0], other[1] - bubble[1], turn])

    def force(self, band, i, bubble):
        x, y, radius, _ = bubble
        force = np.zeros(3)
        for other in (band[i - 1], band[i + 1]):
            way = self.between(bubble, other)
            length = math.hypot(way[0], way[1])
            if length > 0.01:
                force += self.gains.internal_gain * way / length
        across = 2.0 * max(radius, self.gains.tiny_bubble_m)
        wider_x = self.radius(x + radius, y) - self.radius(x - radius, y)
        wider_y = self.radius(x, y + radius) - self.radius(x, y - radius)
        force[0] += self.gains.external_gain * wider_x / across
        force[1] += self.gains.external_gain * wider_y / across
        line = self.between(band[i + 1], band[i - 1])
        return force - (force @ line) / max(float(line @ line), 1e-12) * line

    def overshoots(self, old, new):
        """Tell whether the force has turned, and whether it is still strong."""
        weighed = old[[0, 0, 2]] if self.gains.weighs_x_twice else old
        share = self.gains.overshoot * np.linalg.norm(weighed)
        limit = max(share, self.gains.significant_force)
        return old @ new < 0.0, np.linalg.norm(new) > limit

    def moved(self, bubble, jump):
        x = bubble[0] + jump[0]
        y = bubble[1] + jump[1]
        return (x, y, self.radius(x, y), turned(bubble[3] + jump[2]))

    def holds(self, a, b):
        try:
            self.fill(a, b)
        except self.Broken:
            return False
        return True

    def balance(self, band, i, bubble, force, jump, depth):
        """Walk by a jump, and on or back by half of it each, until the force is balanced; None if it is blocked."""
        new = self.moved(bubble, jump)
        if new[2] <= 0.0:
            return None
        if depth == self.gains.halvings:
            return new
        new_force = self.force(band, i, new)
        reversed_, strong = self.overshoots(force, new_force)
        if reversed_ and not strong:
            return new
        half = (-0.5 if reversed_ else 0.5) * jump
        return self.balance(band, i, new, new_force, half, depth + 1) or new

    def move(self, band, i):
        bubble = band[i]
        force = self.force(band, i, bubble)
        jump = bubble[2] * force
        scale = self.gains.metres_per_rad
        jump[2] = turned(jump[2] / scale) if scale else 0.0
        new = self.moved(bubble, jump)
        if new[2] <= self.gains.tiny_bubble_m:
            return
        if all(self.overshoots(force, self.force(band, i, new))):
            new = self.balance(band, i, bubble, force, 0.5 * jump, 0) or new
        if self.holds(band[i - 1], new) and self.holds(new, band[i + 1]):
            band[i] = new

    def optimize(self, band, sweeps):
        band = [(x, y, self.radius(x, y), yaw) for x, y, _, yaw in band]
        if any(radius <= 0.0 for _, _, radius, _ in band):
            raise self.Broken
        band = self.refine(band)
        for _ in range(sweeps):
            inner = list(range(1, len(band) - 1))
            for i in [*inner, *reversed(inner)]:
                self.move(band, i)
            band = self.refine(band)
        return band


def optimize(band, n, grid, gains, work, sweeps):
    context = kernels.Context(grid, gains._replace(sweeps=sweeps), work)
    n = renew(band, n, context)
    return n if n < 0 else relax(band, n, context)


def random_case(seed):
    """Return a cluttered grid and a wavy chain of points across it that keeps off the inscribed cells where it can."""
    rng = np.random.default_rng(seed)
    cells = rng.integers(0, SIDE, (int(rng.integers(4, 30)), 2))
    grid = grid_with(*map(tuple, cells))
    along = np.linspace(0.4, 5.6, int(rng.integers(2, 160)))
    wave = 3.0 + rng.uniform(0.0, 1.0) * np.sin(along * rng.uniform(0.5, 3.0))
    reference = ReferenceBand(grid, GAINS)
    points = [
        point
        for point in zip(along, wave, strict=True)
        if reference.radius(*point) > 0.0
    ]
    return grid, points


def as_band(points):
    band = np.zeros((CAPACITY, 4))
    band[: len(points), :2] = points
    return band


def measured(along, *cells):
    """Return a band at y = 3 m with its radii, and the context with obstacles in some cells."""
    grid = grid_with(*cells)
    band = as_band([(x, 3.0) for x in along])
    kernels.measure(band, len(along), grid)
    return band, kernels.Context(grid, GAINS, kernels.new_band_work(CAPACITY))


WALL = [(row, 60) for row in range(SIDE)]


@pytest.mark.parametrize("gains", [GAINS, ORIGINAL, ORIGINAL._replace(halvings=0)])
@pytest.mark.parametrize("sweeps", [0, 1, 3])
def test_optimise_equals_reference(sweeps, gains):
    work = kernels.new_band_work(CAPACITY)
    outcomes = []
    for seed in range(60):
        grid, points = random_case(seed)
        band = as_band(points)
        if gains.metres_per_rad > 0.0:  # as of a plan: no heading but at its ends
            band[0, kernels.YAW] = 2.5 - 0.1 * seed
            band[len(points) - 1, kernels.YAW] = 1.57
        reference = ReferenceBand(grid, gains)
        start = [tuple(bubble) for bubble in band[: len(points)].tolist()]
        n = optimize(band, len(points), grid, gains, work, sweeps)
        try:
            expected = reference.optimize(start, sweeps)
        except ReferenceBand.Broken:
            assert n < 0, seed
            outcomes.append(False)
            continue
        assert n == len(expected), seed
        assert_allclose(band[:n], expected, atol=1e-9)
        assert all(reference.overlap(a, b) for a, b in pairwise(band[:n]))
        outcomes.append(True)
    assert 10 <= sum(outcomes) <= 50


@pytest.mark.parametrize(
    "cells, points, capacity, failure",
    [
        (WALL, [(1.0, 3.0), (5.0, 3.0)], CAPACITY, kernels.GAP),
        (WALL, [(1.0, 3.0), (3.0, 3.0)], CAPACITY, kernels.IN_COLLISION),
        ([], [(0.5, 3.0), (5.5, 3.0)], 4, kernels.FULL),
    ],
    ids=["gap", "collision", "full"],
)
def test_failures_are_told_apart(cells, points, capacity, failure):
    band = as_band(points)[:capacity]
    work = kernels.new_band_work(capacity)
    assert optimize(band, 2, grid_with(*cells), GAINS, work, 3) == failure


def test_connect_front_drops_what_the_robot_has_passed():
    band, context = measured((1.0, 1.5, 2.0, 3.0))
    n = kernels.connect_front(band, 4, Pose(1.4, 3.1, 0.3), context)
    assert_allclose(band[:n, :2], [(1.4, 3.1), (2.0, 3.0), (3.0, 3.0)])


@pytest.mark.parametrize("distance", [0.5, 2.0])
def test_connect_front_reaches_a_band_further_ahead(distance):
    band, context = measured((3.0, 3.7))
    n = kernels.connect_front(band, 2, Pose(3.0 - distance, 3.0, 0.3), context)
    steps = np.diff(band[:n, 0])
    assert band[[0, n - 1], 0].tolist() == [3.0 - distance, 3.7]
    assert ((steps > 0.0) & (steps < 0.7 * 2 * 0.553)).all()


def test_connect_front_fails_inside_an_obstacle():
    band, context = measured((1.0, 1.5), (60, 60))
    failure = kernels.connect_front(band, 2, Pose(3.0, 3.0, 0.3), context)
    assert failure == kernels.IN_COLLISION


@pytest.mark.parametrize("start", [2.0, 4.0])
def test_append_back_continues_the_band(start):
    band, context = measured((1.0, 1.6, 2.2))
    points = np.array([(start + 0.1 * k, 3.0, 0.0) for k in range(15)])
    n = kernels.append_back(band, 3, points, context)
    back = band[n - 15 : n, [kernels.X, kernels.Y, kernels.YAW]]
    assert_allclose(back, points)
    assert kernels.refine(band, n, context) > 0
    steps = np.diff(band[: n - 14, :2], axis=0)
    assert np.hypot(*steps.T).max() < 0.7 * 2 * 0.553
