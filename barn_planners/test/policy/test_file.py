"""Policy files: what is written is read, what is no policy is refused in one line; what the network computes."""

import json
import re
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from archives import members, pickled, repack
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused

from barn_planners.policy.file import (
    Policy,
    PolicyNetwork,
    affine,
    read_policy,
    write_policy,
)
from barn_planners.policy.planner import SHIPPED, shipped_policy
from barn_planners.policy.space import PolicyAction, PolicyObservation
from barn_worlds.base.errors import BarnError
from barn_worlds.formats.npz import encode_npy

OBSERVATION = PolicyObservation(beams=6)


def policy(layers=(11, 8, 2), **changes):
    rng = np.random.default_rng(3)
    sizes = list(pairwise(layers))
    content = {
        "observation": OBSERVATION,
        "action": PolicyAction(),
        "weights": tuple(rng.normal(size=size).astype(np.float32) for size in sizes),
        "biases": tuple(rng.normal(size=n).astype(np.float32) for _, n in sizes),
    }
    return Policy(**content | changes)


@pytest.fixture
def path(tmp_path):
    write_policy(tmp_path / "policy.npz", policy(about={"by": "a test"}))
    return tmp_path / "policy.npz"


def test_what_is_written_is_read(path):
    written = policy()
    read = read_policy(path)
    assert (read.observation, read.action) == (OBSERVATION, PolicyAction())
    assert read.layers == (11, 8, 2)
    assert (read.activation, read.output) == ("tanh", "clip")
    assert read.about == {"by": "a test"}
    for name in ("weights", "biases"):
        for layer, other in zip(
            getattr(read, name), getattr(written, name), strict=True
        ):
            assert_array_equal(layer, other)


def test_the_file_of_an_equal_policy_is_equal(path, tmp_path):
    write_policy(tmp_path / "again.npz", policy(about={"by": "a test"}))
    assert path.read_bytes() == (tmp_path / "again.npz").read_bytes()


@pytest.mark.parametrize("activation", ["tanh", "relu"])
@pytest.mark.parametrize("output", ["clip", "tanh"])
def test_the_network_against_matrix_products(activation, output):
    network = policy((11, 8, 5, 2), activation=activation, output=output)
    inputs = np.random.default_rng(0).uniform(-1.0, 1.0, 11).astype(np.float32)
    bend = np.tanh if activation == "tanh" else partial(np.maximum, 0.0)
    values = inputs.astype(np.float64)
    for k in range(3):
        values = values @ network.weights[k].astype(np.float64) + network.biases[k]
        if k < 2:
            values = bend(values)
    expected = np.tanh(values) if output == "tanh" else values
    actions = PolicyNetwork(network).act(inputs)
    assert_allclose(actions, expected, rtol=1e-12, atol=1e-12)


def test_a_layer_sums_in_one_order():
    rng = np.random.default_rng(1)
    values = rng.normal(size=300)
    weights = rng.normal(size=(300, 130))
    biases = rng.normal(size=130)
    expected = np.add.accumulate([biases, *(values[:, None] * weights)])[-1]
    assert_array_equal(affine(values, weights, biases), expected)


def header_with(**changes):
    def change(path):
        header = json.loads(members(path)["policy.json"]) | changes
        repack(path, {"policy.json": json.dumps(header)})

    return change


def with_member(name, data):
    return lambda path: repack(path, {name: data})


def cut(path):
    path.write_bytes(path.read_bytes()[:-60])


NAN = np.full((11, 8), np.nan, np.float32)
DAMAGED = {
    "empty file": (lambda path: path.write_bytes(b""), "not a policy file"),
    "text": (lambda path: path.write_text("hello"), "not a policy file"),
    "cut off": (cut, "not a policy file"),
    "no header": (with_member("policy.json", None), "it has no policy.json"),
    "header no JSON": (with_member("policy.json", b"{"), "policy.json: not JSON"),
    "header a list": (
        with_member("policy.json", b"[]"),
        "schema version must be 1 or 2, got None",
    ),
    "other version": (header_with(schema=3), "schema version must be 1 or 2, got 3"),
    "key too many": (header_with(color="red"), "'color'"),
    "unknown activation": (
        header_with(activation="tanhh"),
        "unknown activation 'tanhh'; did you mean 'tanh'",
    ),
    "unknown output": (header_with(output="softmax"), "unknown output 'softmax'"),
    "layers no sizes": (
        header_with(layers=[11, -8, 2]),
        "but its arrays have (11, 8, 2)",
    ),
    "layers no list": (header_with(layers=None), "layers must be a list, got None"),
    "too many layers": (
        header_with(layers=[11] * 40),
        "layers must list 2 to 17 sizes",
    ),
    "other layers": (header_with(layers=[11, 9, 2]), "but its arrays have (11, 8, 2)"),
    "layer missing": (header_with(layers=[11, 8, 8, 2]), "it has no weights_2.npy"),
    "observation of other size": (
        header_with(observation={"beams": 9}),
        "must lead from 14 observed values",
    ),
    "unknown observation": (
        header_with(observation={"beans": 6}),
        "did you mean 'observation.beams'",
    ),
    "action out of range": (
        header_with(action={"max_speed_mps": 99.0}),
        "max_speed_mps must be from -10 to 10",
    ),
    "about no mapping": (header_with(about=1), "about must be a mapping"),
    "weights missing": (with_member("weights_1.npy", None), "it has no weights_1.npy"),
    "weights not finite": (
        with_member("weights_0.npy", encode_npy(NAN)),
        "weights_0 holds values that are not finite",
    ),
    "weights of other shape": (
        with_member("weights_0.npy", encode_npy(np.zeros((11, 7), np.float32))),
        "layer 0 must have weights (11, 8)",
    ),
    "weights flat": (
        with_member("weights_0.npy", encode_npy(NAN[0])),
        "must be any x any of float32",
    ),
    "weights of other type": (
        with_member("biases_0.npy", encode_npy(np.zeros(8))),
        "got float64",
    ),
    "weights pickled": (
        with_member("weights_0.npy", pickled()),
        "Object arrays cannot be loaded",
    ),
    "weights too many": (
        with_member("weights_9.npy", encode_npy(NAN)),
        "must have 4 arrays for its 2 layers, got 5",
    ),
    "bomb": (with_member("filler", bytes(65 * 1024 * 1024)), "unpacks to more than"),
}


@pytest.mark.parametrize("damage", DAMAGED)
def test_what_is_no_policy_is_refused_in_one_line_with_the_path(path, damage):
    spoil, message = DAMAGED[damage]
    spoil(path)
    with refused(f"{path}.*{re.escape(message)}", BarnError):
        read_policy(path)


def test_a_path_without_a_file_is_refused(tmp_path):
    for path in (tmp_path / "none.npz", tmp_path):
        with refused(str(path), BarnError):
            read_policy(path)


def test_a_policy_is_judged_before_it_is_written(tmp_path):
    message = (
        r"must lead from 11 observed values to 2 actions, got layers of \(11, 8, 3\)"
    )
    with refused(message, BarnError):
        policy((11, 8, 3))
    with refused("1 to 16 layers", BarnError):
        policy(weights=(), biases=())
    (tmp_path / "file").write_text("")
    with refused("file", BarnError):
        write_policy(tmp_path / "file" / "policy.npz", policy())


@pytest.mark.parametrize("name", SHIPPED)
def test_a_policy_of_the_package_says_where_it_is_from(name):
    read = read_policy(shipped_policy(name))
    assert read.layers[0] == read.observation.size
    assert {"algorithm", "steps", "seed", "trained_in"} <= set(read.about)
