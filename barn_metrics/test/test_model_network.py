"""The network along strips of routes: what a strip shows, and what the network gives in numpy."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from test_model import corridor

from barn_metrics.model.inputs import STRIPS, inputs_of, summary_names
from barn_metrics.model.predictor import RouteNetwork, _convolved
from barn_metrics.model.route import (
    CHANNELS,
    HEADING,
    PRESENT,
    SAMPLES,
    TURN,
    cheapest_route,
    clearance_map,
    mirrored,
    route_strip,
)

SUMMED_UP = len(summary_names())
MIDDLE = HEADING // 2


def made_network(outputs=2, seed=4):
    drawn = np.random.default_rng(seed).standard_normal
    sizes = [len(STRIPS) * CHANNELS, 6, 5, 4]
    filters = tuple((drawn((3, a, b)) / a**0.5, drawn(b)) for a, b in pairwise(sizes))
    layers = ((drawn((8 + SUMMED_UP, 7)), drawn(7)), (drawn((7, outputs)), drawn(outputs)))
    return RouteNetwork(np.zeros(SUMMED_UP), np.ones(SUMMED_UP), filters, layers)


def strip_of(world):
    where = clearance_map(world)
    route = cheapest_route(where, np.ones_like(where.clearance_m))
    return where, route, route_strip(where, route)


def test_a_strip_shows_the_clearance_along_and_beside_the_route():
    where, route, strip = strip_of(corridor(9))
    count = len(route.points)
    assert strip[:count, PRESENT].all() and not strip[count:].any()
    row, column = where.at(np.round(route.points).astype(int)).T
    on_it = 0.4 * (strip[:count, MIDDLE] + 1.0)
    assert on_it == pytest.approx(np.minimum(where.clearance_m[row, column], 0.8), abs=0.06)
    # In the gap there is less room to both sides than on the route.
    gap = int(strip[:count, MIDDLE].argmin())
    assert strip[gap, 0] < strip[gap, MIDDLE] > strip[gap, HEADING - 1]


def test_mirrored_strips_are_those_of_the_mirrored_world(worlds):
    where = clearance_map(worlds[150])
    route = cheapest_route(where, 1.0 / np.clip(where.clearance_m, 0.05, 1.0))
    turned = replace(where, clearance_m=where.clearance_m[::-1])
    other = replace(route, points=[len(where.clearance_m) - 1, 0] + route.points * [-1, 1])
    strip = route_strip(where, route)
    assert np.abs(strip[:, TURN]).max() > 0.1
    assert mirrored(strip) == pytest.approx(route_strip(turned, other), abs=1e-9)
    assert (mirrored(mirrored(strip)) == strip).all()


def test_convolution_is_that_of_plain_loops():
    generator = np.random.default_rng(0)
    values, weights = generator.standard_normal((2, 11, 3)), generator.standard_normal((5, 3, 4))
    for dilation in (1, 2):
        expected = np.zeros((2, 11, 4))
        for n, at, shift in np.ndindex(2, 11, 5):
            seen = at + (shift - 2) * dilation
            if 0 <= seen < 11:
                expected[n, at] += values[n, seen] @ weights[shift]
        assert _convolved(values, weights, dilation) == pytest.approx(expected)


def test_the_output_for_a_world_depends_on_that_world_alone_and_not_on_its_side(worlds):
    network, inputs = made_network(), inputs_of(list(worlds.values())[::2])
    together = network(inputs)
    assert np.concatenate([network(row[None]) for row in inputs]) == pytest.approx(together, rel=1e-9)
    turned = inputs.copy()
    turned[:, SUMMED_UP:] = mirrored(inputs[:, SUMMED_UP:].reshape(-1, CHANNELS)).reshape(len(inputs), -1)
    assert network(turned) == pytest.approx(together, rel=1e-9)
    assert network(inputs[:0]).shape == (0, 2)
    nothing = np.zeros_like(inputs[:1])
    assert np.isfinite(network(nothing)).all()


def test_a_route_longer_than_a_strip_is_cut_off():
    where, route, _ = strip_of(corridor(9))
    longer = np.concatenate([route.points] * 4)
    strip = route_strip(where, replace(route, points=longer))
    assert strip.shape == (SAMPLES, CHANNELS) and strip[:, PRESENT].all()
