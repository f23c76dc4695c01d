"""Networks along strips of routes: what a strip shows, the same in numpy as in torch, and files of their weights."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from test_model import corridor, made_trials
from test_model_weights import refused, rewrite

from barn_metrics.model import DifficultyModel, load_model, save_model
from barn_metrics.model.inputs import STRIPS, input_names, inputs_of
from barn_metrics.model.networks import SequenceNetwork, _convolved
from barn_metrics.model.predictor import Member
from barn_metrics.model.recipes import recipe_named, targets_of
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
from barn_worlds.base.errors import ConfigError
from barn_worlds.worlds.dataset import open_dataset

SUMMED_UP = len(input_names("rich"))
MIDDLE = HEADING // 2


@pytest.fixture(scope="module")
def worlds():
    dataset = open_dataset("barn300")
    return {index: dataset.load(index) for index in dataset.indices[::12]}


@pytest.fixture(scope="module")
def inputs(worlds):
    return inputs_of(worlds.values(), "strips")


def made_network(outputs=2):
    drawn = np.random.default_rng(4).standard_normal
    sizes = [len(STRIPS) * CHANNELS, 6, 5, 4]
    filters = tuple((drawn((3, a, b)) / a**0.5, drawn(b)) for a, b in pairwise(sizes))
    layers = ((drawn((8 + SUMMED_UP, 7)), drawn(7)), (drawn((7, outputs)), drawn(outputs)))
    return SequenceNetwork(np.zeros(SUMMED_UP), np.ones(SUMMED_UP), filters, layers)


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


def test_mirrored_strips_are_those_of_the_mirrored_world():
    where = clearance_map(open_dataset("barn300").load(150))
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


def test_the_output_for_a_world_depends_on_that_world_alone_and_not_on_its_side(inputs):
    network = made_network()
    together = network(inputs)
    assert np.concatenate([network(row[None]) for row in inputs]) == pytest.approx(together, rel=1e-9)
    turned = inputs.copy()
    turned[:, SUMMED_UP:] = mirrored(inputs[:, SUMMED_UP:].reshape(-1, CHANNELS)).reshape(len(inputs), -1)
    assert network(turned) == pytest.approx(together, rel=1e-9)
    assert network(inputs[:0]).shape == (0, 2)
    nothing = np.zeros_like(inputs[:1])
    assert np.isfinite(network(nothing)).all()


def test_training_repeats_and_numpy_evaluates_it_as_torch_does(worlds, inputs):
    pytest.importorskip("torch", reason="networks are trained with PyTorch")
    from barn_metrics.model.sequence_training import SequenceConfig, _Training, train_sequence_network  # noqa: PLC0415

    targets = targets_of(recipe_named("routes"), made_trials(worlds))
    config = SequenceConfig(filters=8, epochs=60, batch=10, dropout=0.0)
    first, again = (train_sequence_network(inputs, targets, 3, config) for _ in range(2))
    assert (first(inputs) == again(inputs)).all()
    assert np.mean((first(inputs) - targets)[:, 0] ** 2) < 0.3 * targets[:, 0].var()

    import torch  # noqa: PLC0415

    with pytest.raises(ConfigError, match="width must be odd, got 4"):
        SequenceConfig(width=4)
    training = _Training(torch, inputs, targets, config, 3)
    every = torch.arange(len(inputs))
    with torch.no_grad():
        both = [training._outputs(way, every).numpy() for way in training._ways]
    theirs = 0.5 * (both[0] + both[1]) * training._spread + training._shift
    assert training._network()(inputs) == pytest.approx(theirs, rel=1e-4, abs=1e-4)


@pytest.fixture
def file(tmp_path):
    model = DifficultyModel("routes", "strips", ("dwa",), (Member(made_network(), 1.0),), 0.2, {"seed": 1})
    save_model(model, tmp_path / "weights.npz")
    return tmp_path / "weights.npz"


def test_weights_are_read_as_they_were_written(file, inputs):
    model = load_model(file)
    assert (model.members[0].function(inputs) == made_network()(inputs)).all()
    save_model(model, file.with_name("again.npz"))
    assert file.with_name("again.npz").read_bytes() == file.read_bytes()


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"m0_filters0": np.zeros((4, len(STRIPS) * CHANNELS, 6))}, "m0_filters0 must span an odd number of samples"),
        ({"m0_filters0": np.zeros((3, 7, 6))}, f"m0_filters0 must be any x {len(STRIPS) * CHANNELS} x any of f8"),
        ({"m0_filters1": np.zeros((0, 6, 5))}, "m0_filters1 must span an odd number of samples"),
        ({"m0_filter_bias2": np.full(4, np.nan)}, "m0_filter_bias2 holds values that are not finite"),
        ({"m0_weights0": np.zeros((8, 7))}, f"m0_weights0 must be {8 + SUMMED_UP} x any of f8"),
        ({"m0_std": np.zeros(SUMMED_UP)}, "m0_std must be above 0"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(file, arrays, message):
    rewrite(file, arrays=arrays)
    assert message in refused(file)


def test_a_member_is_refused_that_does_not_take_the_inputs_of_the_model(file):
    rewrite(file, {"members": [{"kind": "network", "weight": 1.0, "layers": 2}]})
    assert "m0: a network does not take inputs 'strips'" in refused(file)
    rewrite(file, {"members": [{"kind": "sequence", "weight": 1.0, "layers": 2}]})
    rewrite(file, {"inputs": "rich", "input_names": list(input_names("rich"))})
    assert "m0: a sequence does not take inputs 'rich'" in refused(file)


def test_a_route_longer_than_a_strip_is_cut_off():
    where, route, _ = strip_of(corridor(9))
    longer = np.concatenate([route.points] * 4)
    strip = route_strip(where, replace(route, points=longer))
    assert strip.shape == (SAMPLES, CHANNELS) and strip[:, PRESENT].all()
