"""Files of weights: what was written is read, and nothing else is."""

import hashlib
import json

import numpy as np
import pytest
from archives import members, pickled, repack
from model.test_model import make_network

from barn_metrics.model import DifficultyModel, ModelError, load_model, save_model
from barn_metrics.model.inputs import STRIPS, input_names, summary_names
from barn_metrics.model.route import CHANNELS
from barn_metrics.model.weights import _checksum, default_weights
from barn_worlds.formats.npz import encode_npy, parse_npy

SUMMED_UP = len(summary_names())
EVEN = "must span an odd number of samples"
SMALL_MODEL = DifficultyModel(
    ("dwa",), (make_network(), make_network(seed=5)), 0.2, {"seed": 1}
)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "weights.npz"
    save_model(SMALL_MODEL, path)
    return path


def rewrite(path, header=None, arrays=None, *, signed=True):
    """Write the file anew with another header or other arrays, its checksum put right unless told not to."""
    members_by_name = members(path)
    content = json.loads(members_by_name["header.json"]) | (header or {})
    members_by_name |= {
        f"{name}.npy": encode_npy(array) for name, array in (arrays or {}).items()
    }
    parsed = {
        name[:-4]: parse_npy(data, name)
        for name, data in members_by_name.items()
        if name.endswith(".npy")
    }
    if signed:
        content["sha256"] = _checksum(parsed)
    members_by_name["header.json"] = json.dumps(content).encode()
    repack(path, members_by_name)


def refused(path):
    with pytest.raises(ModelError) as caught:
        load_model(path)
    message = str(caught.value)
    assert message.startswith(str(path)) and "\n" not in message
    return message.removeprefix(f"{path}: ")


def test_a_model_is_read_as_it_was_written(file, tmp_path):
    inputs = np.random.default_rng(1).uniform(0.5, 3.0, (20, len(input_names())))
    model = SMALL_MODEL
    read = load_model(file)
    assert read.predict_inputs(inputs) == model.predict_inputs(inputs)
    assert (read.planners, read.about) == (("dwa",), {"seed": 1})
    again = tmp_path / "again.npz"
    save_model(read, again)
    assert again.read_bytes() == file.read_bytes()


@pytest.mark.parametrize(
    "change, message",
    [
        ({"schema": 2}, "schema version must be 1, got 2"),
        ({"inputs": "five"}, "inputs must be one of strips, got 'five'"),
        ({"recipe": "paper"}, "recipe must be one of routes, got 'paper'"),
        (
            {"input_names": ["a", "b"]},
            "input_names must be those of this version; train again",
        ),
        (
            {"planners": ["a", "b"]},
            "m0_weights1 must be 7 x 4 of f8, got float64 of shape (7, 2)",
        ),
        ({"planners": []}, "planners must be from 1 to 16"),
        ({"planners": [7]}, "planners[0] must be"),
        ({"planners": "dwa"}, "m0_weights1 must be 7 x 6 of f8"),
        ({"members": []}, "members must be from 1 to 64"),
        (
            {"members": [{"kind": "sequence", "weight": 1.0, "layers": 1}] * 65},
            "members must be from 1 to 64",
        ),
        (
            {"members": [{"kind": "shell", "weight": 1.0, "layers": 1}]},
            "kind must be one of sequence, got 'shell'",
        ),
        (
            {"members": [{"kind": "sequence", "weight": 1.0, "layers": 9000}]},
            "layers must be from 1 to 8, got 9000",
        ),
        (
            {"members": [{"kind": "sequence", "weight": 0.5, "layers": 2}]},
            "members must weigh the same and add up to 1",
        ),
        (
            {"members": [{"kind": "sequence", "weight": 1.0, "layers": 3}]},
            "has no array m0_weights2",
        ),
        ({"relative_std": -1.0}, "relative_std must be from 0 to 1e+06, got -1.0"),
        (
            {"relative_std": float("nan")},
            "header.json: not JSON: numbers must be finite, got NaN",
        ),
        ({"about": None}, "about"),
        ({"sizes": [5, 3]}, "unknown key 'sizes'"),
        (
            {"m0_mean": np.zeros(4)},
            f"m0_mean must be {SUMMED_UP} of f8, got float64 of shape (4,)",
        ),
        (
            {"m0_mean": np.zeros(SUMMED_UP, np.float32)},
            f"m0_mean must be {SUMMED_UP} of f8, got float32",
        ),
        ({"m0_std": np.zeros(SUMMED_UP)}, "m0_std must be above 0"),
        (
            {"m0_bias1": np.array([np.nan, 0.0])},
            "m0_bias1 holds values that are not finite",
        ),
        (
            {"m1_weights0": np.zeros((5, 1))},
            f"m1_weights0 must be {8 + SUMMED_UP} x any of f8",
        ),
        (
            {"m0_filters0": np.zeros((4, len(STRIPS) * CHANNELS, 6))},
            f"m0_filters0 {EVEN}",
        ),
        (
            {"m0_filters0": np.zeros((3, 7, 6))},
            f"m0_filters0 must be any x {len(STRIPS) * CHANNELS} x any of f8",
        ),
        ({"m0_filters1": np.zeros((0, 6, 5))}, f"m0_filters1 {EVEN}"),
    ],
)
def test_a_wrong_header_or_array_is_refused(file, change, message):
    arrays = {
        name: value for name, value in change.items() if isinstance(value, np.ndarray)
    }
    rewrite(
        file,
        {name: value for name, value in change.items() if name not in arrays},
        arrays,
    )
    assert message in refused(file)


def test_changed_arrays_are_refused_by_their_checksum(file):
    rewrite(file, arrays={"m0_bias1": np.array([9.0, 9.0])}, signed=False)
    assert "do not have the checksum" in refused(file)


def test_a_pickle_is_not_opened(file):
    repack(file, {"m0_mean.npy": pickled()})
    assert "allow_pickle=False" in refused(file)


def test_other_files_are_refused(tmp_path):
    missing = tmp_path / "none.npz"
    assert "cannot be read" in refused(missing)
    text = tmp_path / "text.npz"
    text.write_text("weights")
    assert "not a difficulty model, or a damaged one" in refused(text)
    other = tmp_path / "other.npz"
    np.savez(other, a=np.zeros(3))
    assert "not a difficulty model: it has no header.json" in refused(other)


def test_shipped_weights_order_worlds(worlds):
    model = load_model()
    easy = list(worlds.values())[:10]
    hard = list(worlds.values())[-10:]
    lower, higher = (
        np.mean(
            [prediction.difficulty_s_per_m for prediction in map(model.predict, some)]
        )
        for some in (easy, hard)
    )
    assert lower + 0.5 < higher
    prediction = model.predict(easy[0])
    assert set(prediction.per_planner_s_per_m) == {"dwa", "eband"}
    assert prediction.difficulty_s_per_m == pytest.approx(
        np.mean(list(prediction.per_planner_s_per_m.values()))
    )
    assert 0.0 <= prediction.failure_probability <= 1.0 and prediction.std_s_per_m > 0.0


def test_the_card_beside_the_shipped_weights_is_theirs():
    card = default_weights().with_suffix(".md").read_text("utf-8")
    assert hashlib.sha256(default_weights().read_bytes()).hexdigest() in card
