"""Files of weights: a header in JSON and plain arrays in one .npz.

Nothing in such a file is executed, and sizes are bounded before memory is taken. The
arrays must fit the header exactly and be finite, and their checksum is in it.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from barn_metrics.model.inputs import STRIPS, input_names, summary_names
from barn_metrics.model.predictor import DILATIONS, DifficultyModel, Layer, RouteNetwork
from barn_metrics.model.route import CHANNELS
from barn_worlds.base.arrays import AnyArray, Floats
from barn_worlds.base.config import Checked, as_dict, from_dict, quantity
from barn_worlds.base.errors import ModelError
from barn_worlds.base.files import package_data
from barn_worlds.formats.npz import Arrays, NpzFormat

FORMAT = NpzFormat(
    "a difficulty model", "header.json", schema=1, largest_file=2**25, largest=2**27
)


@dataclass(frozen=True)
class _Member(Checked):
    """The header's entry for one network."""

    kind: str = quantity("sequence", "kind of network", choices=("sequence",))
    weight: float = quantity(1.0, "share in the mean", "", 0.0, 1.0)
    layers: int = quantity(2, "fully connected layers", "", 1, 8)


@dataclass(frozen=True, kw_only=True)
class _Header(Checked):
    """The header of a file of weights, with the fields of `DifficultyModel`."""

    schema: int
    recipe: str = quantity("routes", "method of training", choices=("routes",))
    inputs: str = quantity("strips", "kind of inputs", choices=("strips",))
    input_names: tuple[str, ...]
    planners: tuple[str, ...]
    relative_std: float = quantity(0.0, "spread about the prediction", "", 0.0, 1e6)
    members: tuple[_Member, ...]
    about: dict[str, Any]
    sha256: str

    def check_rules(self) -> None:
        """Raise ConfigError unless inputs, planners and members fit this version."""
        self.require(
            self.input_names == input_names(),
            "input_names",
            "must be those of this version; train again",
        )
        self.require(1 <= len(self.members) <= 64, "members", "must be from 1 to 64")
        self.require(1 <= len(self.planners) <= 16, "planners", "must be from 1 to 16")
        weights = [member.weight for member in self.members]
        self.require(
            np.allclose(weights, 1.0 / len(weights), rtol=1e-6, atol=0.0),
            "members",
            "must weigh the same and add up to 1",
        )


def default_weights() -> Path:
    """Return the path of the shipped difficulty model's .npz file; reads nothing.

    The model was trained in generated worlds that are not in barn300.
    """
    return package_data("barn_metrics") / "difficulty.npz"


def save_model(model: DifficultyModel, path: Path) -> None:
    """Write a difficulty model to an .npz file; the same model gives the same bytes.

    Args:
        model: Its networks, planners and origin are stored.
        path: File to write, .npz.

    Raises:
        WorldError: If the file cannot be written.
    """
    arrays: Arrays = {}
    members = []
    for number, network in enumerate(model.networks):
        arrays[f"m{number}_mean"] = network.mean
        arrays[f"m{number}_std"] = network.std
        for place, (weights, bias) in enumerate(network.layers):
            arrays[f"m{number}_weights{place}"] = weights
            arrays[f"m{number}_bias{place}"] = bias
        for place, (weights, bias) in enumerate(network.filters):
            arrays[f"m{number}_filters{place}"] = weights
            arrays[f"m{number}_filter_bias{place}"] = bias
        share = 1.0 / len(model.networks)
        members.append(_Member("sequence", share, len(network.layers)))

    # The same bytes on every machine.
    arrays = {name: array.astype("<f8") for name, array in arrays.items()}
    header = _Header(
        schema=FORMAT.schema,
        input_names=input_names(),
        planners=model.planners,
        relative_std=model.relative_std,
        members=tuple(members),
        about=dict(model.about),
        sha256=_checksum(arrays),
    )
    FORMAT.write(path, as_dict(header), arrays)


def load_model(path: Path | str | None = None) -> DifficultyModel:
    """Load a difficulty model, by default the shipped one; BarnError if damaged.

    Raises:
        BarnError: If the file is no sound model.
    """
    path = default_weights() if path is None else Path(path)
    content, arrays = FORMAT.read(path)
    header = from_dict(_Header, content, f"{path}: {FORMAT.header}")
    # A damaged file may still have arrays of the right shapes.
    if header.sha256 != _checksum(arrays):
        raise ModelError(
            f"{path}: damaged: its arrays do not match the checksum in the header"
        )

    networks = []
    for number, member in enumerate(header.members):
        reader = _NetworkReader(path, arrays, number)
        networks.append(reader.network(member.layers, len(header.planners)))
    return DifficultyModel(
        header.planners, tuple(networks), header.relative_std, header.about
    )


class _NetworkReader:
    """Reads one network of a file and checks that its arrays fit together."""

    def __init__(self, path: Path, arrays: Arrays, number: int):
        """Keep arrays, of which `network` reads those whose names begin mNUMBER_."""
        self._path = path
        self._arrays = arrays
        self._prefix = f"m{number}_"

    def network(self, layer_count: int, planner_count: int) -> RouteNetwork:
        """Return the network; BarnError if an array is missing or does not fit."""
        size = len(summary_names())
        mean = self._array("mean", size)
        std = self._array("std", size)
        if not (std > 0.0).all():
            raise ModelError(f"{self._path}: {self._prefix}std must be above 0")

        filters = []
        channels = len(STRIPS) * CHANNELS
        for place in range(len(DILATIONS)):
            name = f"filters{place}"
            layer = self._layer(name, f"filter_bias{place}", None, channels, None)
            width, _, channels = layer[0].shape
            if width % 2 == 0:
                raise ModelError(
                    f"{self._path}: {self._prefix}{name} must span an odd number of "
                    f"samples, got {width}"
                )
            filters.append(layer)

        layers = []
        # The layers see the largest and the mean response of each filter.
        units = size + 2 * channels
        for place in range(layer_count):
            is_last = place == layer_count - 1
            # A time and a share of failures per planner.
            outputs = 2 * planner_count if is_last else None
            layer = self._layer(f"weights{place}", f"bias{place}", units, outputs)
            units = len(layer[1])
            layers.append(layer)
        return RouteNetwork(mean, std, tuple(filters), tuple(layers))

    def _layer(self, weights_name: str, bias_name: str, *shape: int | None) -> Layer:
        """Return weights of a shape (None: any side) and the bias that fits them."""
        weights = self._array(weights_name, *shape)
        return weights, self._array(bias_name, weights.shape[-1])

    def _array(self, name: str, *shape: int | None) -> Floats:
        """Return an array by name; WorldError if shape or values are wrong."""
        name = self._prefix + name
        return FORMAT.array(self._arrays, name, self._path, shape, "float64")


def _checksum(arrays: Mapping[str, AnyArray]) -> str:
    """Return the SHA-256, in hexadecimal, of names, types, shapes and contents."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
