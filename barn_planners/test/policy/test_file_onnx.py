"""Policies as ONNX files: one with a state, and files that are none."""

import json

import numpy as np
import pytest
from refusals import refused

onnx = pytest.importorskip("onnx", reason="onnx is not installed")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")

from onnx import TensorProto, helper, numpy_helper  # noqa: E402

from barn_planners.policy.file import METADATA_KEY, load_network  # noqa: E402
from barn_planners.policy.space import PolicyAction, PolicyObservation  # noqa: E402
from barn_worlds.base.config import as_dict  # noqa: E402
from barn_worlds.base.errors import BarnError  # noqa: E402

OBSERVATION = PolicyObservation(beams=3)
ACTION = PolicyAction(repeat=2)
METADATA = {"observation": as_dict(OBSERVATION), "action": as_dict(ACTION)}


def write_model(path, metadata=METADATA, size=OBSERVATION.size, kept=4):
    """Write a policy that adds up what it sees: its action is a share of the sum."""
    weights = np.random.default_rng(0).normal(size=(size, kept)).astype(np.float32)
    heads = np.random.default_rng(1).normal(size=(kept, 2)).astype(np.float32)

    def tensor(name, *shape):
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)

    nodes = [
        helper.make_node("MatMul", ["observation", "weights"], ["seen"]),
        helper.make_node("Add", ["seen", "state"], ["next"]),
        helper.make_node("MatMul", ["next", "heads"], ["action"]),
    ]
    graph = helper.make_graph(
        nodes,
        "policy",
        [tensor("observation", 1, size), tensor("state", 1, kept)],
        [tensor("action", 1, 2), tensor("next", 1, kept)],
        [
            numpy_helper.from_array(weights, "weights"),
            numpy_helper.from_array(heads, "heads"),
        ],
    )
    imports = [helper.make_opsetid("", 17)]
    model = helper.make_model(graph, opset_imports=imports, ir_version=9)
    if metadata is not None:
        entry = model.metadata_props.add()
        entry.key = METADATA_KEY
        entry.value = json.dumps(metadata)
    path.write_bytes(model.SerializeToString())
    return weights.astype(float), heads.astype(float)


def test_a_recurrent_policy_keeps_its_state_until_the_next_trial(tmp_path):
    path = tmp_path / "policy.onnx"
    weights, heads = write_model(path)
    network = load_network(path)
    assert (network.observation, network.action) == (OBSERVATION, ACTION)
    vector = np.linspace(-1.0, 1.0, OBSERVATION.size, dtype=np.float32)
    for _ in range(2):
        for step in (1, 2, 3):
            expected = step * (vector @ weights) @ heads
            np.testing.assert_allclose(network.act(vector), expected, rtol=1e-4)
        network.reset()


WRONG = {
    "no metadata": ({"metadata": None}, "has no entry barn_policy"),
    "unknown key": ({"metadata": METADATA | {"beans": 1}}, "beans"),
    "no action": ({"metadata": {"observation": {}}}, "action"),
    "other size": ({"size": 9}, r"must lead from \[1, 8\]"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_policy_is_refused_in_one_line(tmp_path, name):
    changes, message = WRONG[name]
    path = tmp_path / "policy.onnx"
    write_model(path, **changes)
    with refused(f"^{path}.*{message}", BarnError):
        load_network(path)


def test_bytes_that_are_no_model_are_refused_in_one_line(tmp_path):
    path = tmp_path / "policy.onnx"
    path.write_bytes(b"no model")
    with refused("not an ONNX model", BarnError):
        load_network(path)
    with refused("missing", BarnError):
        load_network(tmp_path / "missing.onnx")
