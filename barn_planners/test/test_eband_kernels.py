"""The elastic band's kernels against plain recursive references on lists of bubbles."""

import math
from itertools import pairwise

import numpy as np
import pytest

from barn_planners.eband import kernels
from barn_planners.eband.forces import optimise

GAINS = kernels.BandGains(0.7, 0.01, 1.0, 2.0, 0.75, 0.15, 4)
CAPACITY = 1024
RESOLUTION = 0.05
SIDE = 120


def radii_by_cost():
    radii = np.array([-math.log(max(cost, 1) / 252.0) / 10.0 for cost in range(256)])
    radii[253:255] = 0.0
    radii[255] = radii[0]
    return radii


RADII = radii_by_cost()


def grid_with(obstacle_cells):
    """Inflate obstacle cells (n, 2) as costmap_2d does, cell by cell."""
    costs = np.zeros((SIDE, SIDE), np.uint8)
    for row, col in obstacle_cells:
        for i in range(max(0, row - 6), min(SIDE, row + 7)):
            for j in range(max(0, col - 6), min(SIDE, col + 7)):
                distance = math.hypot(i - row, j - col) * RESOLUTION
                if distance == 0.0:
                    cost = 254
                elif distance <= 0.265:
                    cost = 253
                else:
                    cost = int(252 * math.exp(-10.0 * (distance - 0.265))) if distance <= 0.3 + 1e-9 else 0
                costs[i, j] = max(costs[i, j], cost)
    return (costs, 0.0, 0.0, RESOLUTION, RADII)


class ReferenceBand:
    """The method on plain lists, with true recursion; bubbles are (x, y, radius)."""

    def __init__(self, grid):
        self.grid = grid

    class Broken(Exception):
        pass

    def radius(self, x, y):
        costs, ox, oy, resolution, radii = self.grid
        row, col = math.floor((y - oy) / resolution), math.floor((x - ox) / resolution)
        inside = 0 <= row < costs.shape[0] and 0 <= col < costs.shape[1]
        return float(radii[costs[row, col] if inside else 0])

    @staticmethod
    def overlap(a, b):
        return math.hypot(a[0] - b[0], a[1] - b[1]) < GAINS.overlap * (a[2] + b[2])

    def fill(self, a, b):
        """Return the bubbles strictly between a and b."""
        if self.overlap(a, b):
            return []
        x, y = 0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])
        radius = self.radius(x, y)
        if radius <= GAINS.tiny_m:
            raise self.Broken
        middle = (x, y, radius)
        return [*self.fill(a, middle), middle, *self.fill(middle, b)]

    def refine(self, band):
        if len(band) < 2:
            raise self.Broken
        first, last = band[0], band[-1]
        if self.overlap(first, last):
            return [first, last]
        if len(band) == 2:
            return [first, *self.fill(first, last), last]
        half = (len(band) - 1) // 2
        left, right = self.refine(band[: half + 1]), self.refine(band[half:])
        if self.overlap(left[-2], right[1]):
            return left[:-1] + right[1:]
        return left[:-1] + right

    def force(self, band, i, bubble):
        x, y, radius = bubble
        fx = fy = 0.0
        for other in (band[i - 1], band[i + 1]):
            distance = math.hypot(other[0] - x, other[1] - y)
            if distance > 0.01:
                fx += GAINS.internal * (other[0] - x) / distance
                fy += GAINS.internal * (other[1] - y) / distance
        r = max(radius, GAINS.tiny_m)
        fx += GAINS.external * (self.radius(x + r, y) - self.radius(x - r, y)) / (2 * r)
        fy += GAINS.external * (self.radius(x, y + r) - self.radius(x, y - r)) / (2 * r)
        line = np.subtract(band[i - 1][:2], band[i + 1][:2])
        along = (fx * line[0] + fy * line[1]) / max(float(line @ line), 1e-12)
        return np.array([fx, fy]) - along * line

    def holds(self, a, b):
        try:
            self.fill(a, b)
        except self.Broken:
            return False
        return True

    def balance(self, band, i, bubble, force, step, depth):
        """Halve the step until the force is weak or has turned without overshooting; None if no step was possible."""
        if depth == GAINS.halvings:
            return None
        x, y = bubble[0] + step * bubble[2] * force[0], bubble[1] + step * bubble[2] * force[1]
        radius = self.radius(x, y)
        if radius <= GAINS.tiny_m:
            return None
        new = (x, y, radius)
        new_force = self.force(band, i, new)
        strength, turned = np.linalg.norm(new_force), force @ new_force < 0.0
        if strength < GAINS.significant or (turned and strength <= GAINS.overshoot * np.linalg.norm(force)):
            return new
        further = (
            self.balance(band, i, bubble, force, step / 2, depth + 1)
            if turned
            else self.balance(band, i, new, new_force, step / 2, depth + 1)
        )
        return further or new

    def move(self, band, i):
        force = self.force(band, i, band[i])
        x, y, radius = band[i]
        new = (x + radius * force[0], y + radius * force[1])
        new = (*new, self.radius(*new))
        if new[2] <= GAINS.tiny_m:
            return
        new_force = self.force(band, i, new)
        strength = np.linalg.norm(new_force)
        significant = strength >= GAINS.significant and strength > GAINS.overshoot * np.linalg.norm(force)
        if force @ new_force < 0.0 and significant:
            new = self.balance(band, i, band[i], force, 0.5, 0)
        if new and self.holds(band[i - 1], new) and self.holds(new, band[i + 1]):
            band[i] = new

    def optimise(self, band, sweeps):
        band = [(x, y, self.radius(x, y)) for x, y, _ in band]
        if any(radius <= 0.0 for *_, radius in band):
            raise self.Broken
        band = self.refine(band)
        for _ in range(sweeps):
            inner = list(range(1, len(band) - 1))
            for i in [*inner, *reversed(inner)]:
                self.move(band, i)
            band = self.refine(band)
        return band


def random_case(seed):
    """Return a cluttered grid and a wavy chain of points across it that keeps off the inscribed cells where it can."""
    rng = np.random.default_rng(seed)
    grid = grid_with(rng.integers(0, SIDE, (int(rng.integers(4, 30)), 2)))
    along = np.linspace(0.4, 5.6, int(rng.integers(2, 160)))
    wave = 3.0 + rng.uniform(0.0, 1.0) * np.sin(along * rng.uniform(0.5, 3.0))
    points = [(x, y) for x, y in zip(along, wave, strict=True) if ReferenceBand(grid).radius(x, y) > 0.0]
    return grid, points


def as_band(points):
    band = np.zeros((CAPACITY, 3))
    band[: len(points), :2] = points
    return band


@pytest.mark.parametrize("sweeps", [0, 1, 3])
def test_optimise_equals_reference(sweeps):
    work = kernels.band_work(CAPACITY)
    outcomes = []
    for seed in range(60):
        grid, points = random_case(seed)
        band = as_band(points)
        n = optimise(band, len(points), grid, GAINS, work, sweeps)
        reference = ReferenceBand(grid)
        try:
            expected = reference.optimise([(x, y, 0.0) for x, y in points], sweeps)
        except ReferenceBand.Broken:
            assert n < 0, seed
            outcomes.append(False)
            continue
        assert n == len(expected), seed
        np.testing.assert_allclose(band[:n], expected, atol=1e-12)
        assert all(reference.overlap(a, b) for a, b in pairwise(band[:n]))
        outcomes.append(True)
    assert 10 <= sum(outcomes) <= 50


def test_refined_band_in_the_open_is_sparse_and_straight():
    band = as_band([(x, 3.0) for x in np.linspace(0.5, 5.5, 200)])
    n = optimise(band, 200, grid_with([]), GAINS, kernels.band_work(CAPACITY), 3)
    assert 8 <= n <= 10
    np.testing.assert_allclose(band[:n, 1], 3.0, atol=1e-12)
    np.testing.assert_allclose(band[:n, 2], 0.5529, atol=1e-4)


def test_relaxing_contracts_a_detour_and_keeps_clear_of_obstacles():
    obstacle = [(60, col) for col in range(56, 65)]
    detour = [(x, 3.0 + 1.4 * math.sin(math.pi * (x - 1.0) / 4.0)) for x in np.linspace(1.0, 5.0, 120)]
    grid = grid_with(obstacle)
    work, band = kernels.band_work(CAPACITY), as_band(detour)
    n = optimise(band, 120, grid, GAINS, work, 0)
    length_before = np.hypot(*np.diff(band[:n, :2], axis=0).T).sum()
    n = optimise(band, n, grid, GAINS, work, 30)
    length_after = np.hypot(*np.diff(band[:n, :2], axis=0).T).sum()
    assert n > 2
    assert length_after < length_before - 0.2
    assert band[:n, 2].min() > 0.0
    assert band[:n, 1].max() > 3.3


def test_failures_are_told_apart():
    work = kernels.band_work(CAPACITY)
    wall = grid_with([(row, 60) for row in range(SIDE)])
    band = as_band([(1.0, 3.0), (5.0, 3.0)])
    assert optimise(band, 2, wall, GAINS, work, 3) == kernels.GAP
    band = as_band([(1.0, 3.0), (3.0, 3.0)])
    assert optimise(band, 2, wall, GAINS, work, 3) == kernels.IN_COLLISION
    small = kernels.band_work(4)
    band = np.zeros((4, 3))
    band[:2, :2] = (0.5, 3.0), (5.5, 3.0)
    assert optimise(band, 2, grid_with([]), GAINS, small, 3) == kernels.FULL


def test_connect_front_drops_what_the_robot_has_passed():
    work, grid = kernels.band_work(CAPACITY), grid_with([])
    band = as_band([(x, 3.0) for x in (1.0, 1.5, 2.0, 3.0)])
    kernels.measure(band, 4, grid)
    n = kernels.connect_front(band, 4, 1.4, 3.1, grid, GAINS, work)
    np.testing.assert_allclose(band[:n, :2], [(1.4, 3.1), (2.0, 3.0), (3.0, 3.0)])


@pytest.mark.parametrize("distance", [0.5, 2.0])
def test_connect_front_reaches_a_band_further_ahead(distance):
    work, grid = kernels.band_work(CAPACITY), grid_with([])
    band = as_band([(3.0, 3.0), (3.7, 3.0)])
    kernels.measure(band, 2, grid)
    n = kernels.connect_front(band, 2, 3.0 - distance, 3.0, grid, GAINS, work)
    steps = np.diff(band[:n, 0])
    assert band[0, 0] == 3.0 - distance
    assert band[n - 1, 0] == 3.7
    assert (steps > 0.0).all()
    assert (steps < 0.7 * 2 * 0.553).all()


def test_connect_front_fails_inside_an_obstacle():
    grid = grid_with([(60, 60)])
    band = as_band([(1.0, 3.0), (1.5, 3.0)])
    kernels.measure(band, 2, grid)
    assert kernels.connect_front(band, 2, 3.0, 3.0, grid, GAINS, kernels.band_work(CAPACITY)) == kernels.IN_COLLISION


@pytest.mark.parametrize("start", [2.0, 4.0])
def test_append_back_continues_the_band(start):
    work, grid = kernels.band_work(CAPACITY), grid_with([])
    band = as_band([(x, 3.0) for x in (1.0, 1.6, 2.2)])
    kernels.measure(band, 3, grid)
    points = np.array([(start + 0.1 * k, 3.0) for k in range(15)])
    n = kernels.append_back(band, 3, points, grid, GAINS, work)
    np.testing.assert_allclose(band[n - 15 : n, :2], points)
    assert kernels.refine(band, n, grid, GAINS, work) > 0
    assert np.hypot(*np.diff(band[: n - 14, :2], axis=0).T).max() < 0.7 * 2 * 0.553
