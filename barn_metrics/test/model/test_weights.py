"""Files of weights: what was written is read, and nothing else is."""

import hashlib
import json

import numpy as np
import pytest
from archives import members, pickled, repack
from model.test_model import make_network

from barn_metrics.model import DifficultyModel, load_model, save_model
from barn_metrics.model.inputs import STRIPS, input_names, summary_names
from barn_metrics.model.route import CHANNELS
from barn_metrics.model.weights import _checksum, default_weights
from barn_worlds.base.errors import BarnError
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


def rewrite(path, change, *, signed=True):
    """Rewrite the file with other arrays or header entries; correct its checksum unless told not to."""
    content = members(path)
    header = json.loads(content["header.json"])
    for name, value in change.items():
        if isinstance(value, np.ndarray):
            content[f"{name}.npy"] = encode_npy(value)
        else:
            header[name] = value
    if signed:
        arrays = {
            name.removesuffix(".npy"): parse_npy(data, name)
            for name, data in content.items()
            if name != "header.json"
        }
        header["sha256"] = _checksum(arrays)
    data = json.dumps(header).encode()
    repack(path, content | {"header.json": data})


def refused(path):
    with pytest.raises(BarnError) as caught:
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
            "m0_weights1 must be 7 x 4 of float64, got float64 of shape (7, 2)",
        ),
        ({"planners": []}, "planners must be from 1 to 16"),
        ({"planners": [7]}, "planners[0] must be"),
        ({"planners": "dwa"}, "planners must be a list, got 'dwa'"),
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
            "it has no m0_weights2.npy",
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
            f"m0_mean must be {SUMMED_UP} of float64, got float64 of shape (4,)",
        ),
        (
            {"m0_mean": np.zeros(SUMMED_UP, np.float32)},
            f"m0_mean must be {SUMMED_UP} of float64, got float32",
        ),
        ({"m0_std": np.zeros(SUMMED_UP)}, "m0_std must be above 0"),
        (
            {"m0_bias1": np.array([np.nan, 0.0])},
            "m0_bias1 holds values that are not finite",
        ),
        (
            {"m1_weights0": np.zeros((5, 1))},
            f"m1_weights0 must be {8 + SUMMED_UP} x any of float64",
        ),
        (
            {"m0_filters0": np.zeros((4, len(STRIPS) * CHANNELS, 6))},
            f"m0_filters0 {EVEN}",
        ),
        (
            {"m0_filters0": np.zeros((3, 7, 6))},
            f"m0_filters0 must be any x {len(STRIPS) * CHANNELS} x any of float64",
        ),
        ({"m0_filters1": np.zeros((0, 6, 5))}, f"m0_filters1 {EVEN}"),
    ],
)
def test_a_wrong_header_or_array_is_refused(file, change, message):
    rewrite(file, change)
    assert message in refused(file)


def test_changed_arrays_are_refused_by_their_checksum(file):
    rewrite(file, {"m0_bias1": np.array([9.0, 9.0])}, signed=False)
    assert "do not match the checksum" in refused(file)


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
    predictions = [model.predict(world) for world in worlds.values()]
    times = [prediction.difficulty_s_per_m for prediction in predictions]
    assert np.mean(times[:10]) + 0.5 < np.mean(times[-10:])
    prediction = predictions[0]
    assert set(prediction.per_planner_s_per_m) == {"dwa", "eband"}
    of_planners = list(prediction.per_planner_s_per_m.values())
    assert prediction.difficulty_s_per_m == pytest.approx(np.mean(of_planners))
    assert prediction.std_s_per_m > 0.0


def test_the_card_beside_the_shipped_weights_is_theirs():
    card = default_weights().with_suffix(".md").read_text("utf-8")
    weights = default_weights().read_bytes()
    assert hashlib.sha256(weights).hexdigest() in card
