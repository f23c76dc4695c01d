"""The difficulty model: inputs, and the network along strips of routes."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from barn_metrics.metrics import METRIC_NAMES
from barn_metrics.model.inputs import STRIPS, input_names, inputs_of, summary_names
from barn_metrics.model.predictor import RouteNetwork, _convolve
from barn_metrics.model.route import (
    CHANNELS,
    HEADING,
    PRESENT,
    SAMPLES,
    TURN,
    cheapest_route,
    clearance_map,
    mirror_strips,
    route_strip,
)
from barn_worlds.worlds.world import World


def test_inputs_are_named_finite_and_begin_with_the_papers_five(worlds):
    empty = World("empty", np.zeros((30, 30), np.bool_), STRAIGHT)
    inputs = inputs_of([*worlds.values(), empty])
    names = input_names()
    assert inputs.shape == (len(worlds) + 1, len(names))
    assert np.isfinite(inputs).all()
    assert names[:5] == METRIC_NAMES
    assert len(set(names)) == len(names)


STRAIGHT = np.column_stack([np.full(30, 15), np.arange(30)])


def corridor(gap_cells):
    """Return a world with a wall across, open for some cells about row 15."""
    grid = np.zeros((30, 30), np.bool_)
    grid[[0, -1]] = True
    grid[:, 15] = True
    low = 15 - gap_cells // 2
    grid[low : low + gap_cells, 15] = False
    return World("corridor", grid, STRAIGHT)


def shortest_route(where):
    return cheapest_route(where, np.ones_like(where.clearance_m))


def test_routes_know_how_wide_the_gap_is():
    widths = []
    for gap in (5, 7, 9):
        route = shortest_route(clearance_map(corridor(gap)))
        widths.append(route.width_m.min())
        # From the squares of the wall; the original conversion sets start and goal a cell beside the gap's middle.
        half_m = (gap * 0.15 + 0.05) / 2.0
        assert route.clearance_m.min() == pytest.approx(half_m - 0.15, abs=0.08)
        assert route.length_m == pytest.approx(9.73 - 4.075, abs=0.15)
        assert np.abs(route.heading_rad).max() < 0.3
        # The widest place within reach of the gap's middle lies beside the wall, so this is an upper limit.
        assert gap * 0.15 <= widths[-1] < gap * 0.15 + 0.4
    assert widths[0] < widths[1] < widths[2]


def test_a_route_goes_round_what_costs_more_than_the_detour():
    where = clearance_map(corridor(7))
    cost = np.ones_like(where.clearance_m)
    middle = where.start[0]
    cost[middle - 3 : middle + 4, cost.shape[1] // 3] = 50.0
    direct = shortest_route(where)
    round_it = cheapest_route(where, cost)
    assert direct.cost_m == pytest.approx(direct.length_m)
    assert direct.length_m < round_it.length_m < direct.length_m + 0.5
    assert round_it.cost_m < direct.length_m + 1.0


SUMMED_UP = len(summary_names())
MIDDLE = HEADING // 2


def make_network(seed=4):
    draw = np.random.default_rng(seed).standard_normal
    sizes = [len(STRIPS) * CHANNELS, 6, 5, 4]
    filters = tuple((draw((3, a, b)) / a**0.5, draw(b)) for a, b in pairwise(sizes))
    layers = tuple((draw((a, b)), draw(b)) for a, b in pairwise([8 + SUMMED_UP, 7, 2]))
    return RouteNetwork(np.zeros(SUMMED_UP), np.ones(SUMMED_UP), filters, layers)


def strip_of_corridor():
    where = clearance_map(corridor(9))
    route = shortest_route(where)
    return where, route, route_strip(where, route)


def test_a_strip_shows_the_clearance_along_and_beside_the_route():
    where, route, strip = strip_of_corridor()
    count = len(route.points)
    assert strip[:count, PRESENT].all()
    assert not strip[count:].any()
    last_cell = np.array(where.clearance_m.shape) - 1
    cells = np.clip(np.round(route.points).astype(int), 0, last_cell)
    clearance_m = np.minimum(where.clearance_m[tuple(cells.T)], 0.8)
    middle = strip[:count, MIDDLE]
    assert 0.4 * (middle + 1.0) == pytest.approx(clearance_m, abs=0.06)
    # In the gap there is less room to both sides than on the route.
    in_gap = strip[middle.argmin()]
    assert in_gap[0] < in_gap[MIDDLE] > in_gap[HEADING - 1]


def test_mirrored_strips_are_those_of_the_mirrored_world(worlds):
    where = clearance_map(worlds[150])
    route = cheapest_route(where, 1.0 / np.clip(where.clearance_m, 0.05, 1.0))
    last = len(where.clearance_m) - 1
    turned = replace(where, clearance_m=where.clearance_m[::-1])
    other = replace(route, points=[last, 0] + route.points * [-1, 1])
    strip = route_strip(where, route)
    assert np.abs(strip[:, TURN]).max() > 0.1
    mirrored = mirror_strips(strip)
    assert mirrored == pytest.approx(route_strip(turned, other), abs=1e-9)
    assert (mirror_strips(mirrored) == strip).all()


def test_convolution_is_that_of_plain_loops():
    generator = np.random.default_rng(0)
    values = generator.standard_normal((2, 11, 3))
    weights = generator.standard_normal((5, 3, 4))
    for dilation in (1, 2):
        expected = np.zeros((2, 11, 4))
        for n, at, shift in np.ndindex(2, 11, 5):
            position = at + (shift - 2) * dilation
            if 0 <= position < 11:
                expected[n, at] += values[n, position] @ weights[shift]
        assert _convolve(values, weights, dilation) == pytest.approx(expected)


def test_a_worlds_output_depends_on_that_world_alone(worlds):
    network = make_network()
    inputs = inputs_of(list(worlds.values())[::2])
    together = network(inputs)
    alone = np.concatenate([network(row[None]) for row in inputs])
    assert alone == pytest.approx(together, rel=1e-9)
    strips = inputs[:, SUMMED_UP:]
    mirrored = mirror_strips(strips.reshape(-1, CHANNELS)).reshape(strips.shape)
    turned = np.hstack([inputs[:, :SUMMED_UP], mirrored])
    assert network(turned) == pytest.approx(together, rel=1e-9)
    assert network(inputs[:0]).shape == (0, 2)
    nothing = np.zeros_like(inputs[:1])
    assert np.isfinite(network(nothing)).all()


def test_a_route_longer_than_a_strip_is_cut_off():
    where, route, _ = strip_of_corridor()
    longer = np.concatenate([route.points] * 4)
    strip = route_strip(where, replace(route, points=longer))
    assert strip.shape == (SAMPLES, CHANNELS)
    assert strip[:, PRESENT].all()
