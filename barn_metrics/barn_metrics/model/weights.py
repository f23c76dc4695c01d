"""Files of weights: a header in JSON and plain arrays in one .npz, checked before anything is used.

Nothing in such a file is executed, no pickle is read, and sizes are bounded before memory is taken. The header names
the schema, the inputs and the members; the arrays have to fit it exactly and to be finite, and their checksum is in it.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_metrics.model.inputs import STRIPS, input_names, summary_names
from barn_metrics.model.predictor import DILATIONS, DifficultyModel, Layer, RouteNetwork
from barn_metrics.model.route import CHANNELS
from barn_worlds.base.arrays import Floats
from barn_worlds.base.config import Checked, as_dict, from_dict, quantity
from barn_worlds.base.errors import ConfigError, ModelError, WorldError
from barn_worlds.formats.npz import NpzFormat

FORMAT = NpzFormat(
    "a difficulty model", "header.json", schema=1, largest_file=32 * 1024 * 1024, largest=128 * 1024 * 1024
)
_MOST_MEMBERS, _MOST_PLANNERS = 64, 16


@dataclass(frozen=True)
class _Member(Checked):
    """What the header says of one network."""

    kind: str = quantity("sequence", "what its arrays make", choices=("sequence",))
    weight: float = quantity(1.0, "share in the mean", "", 0.0, 1.0)
    layers: int = quantity(2, "fully connected layers", "", 1, 8)


@dataclass(frozen=True, kw_only=True)
class _Header(Checked):
    """What a file of weights says of its arrays, in the words of `DifficultyModel`."""

    schema: int
    recipe: str = quantity("routes", "how it was trained", choices=("routes",))
    inputs: str = quantity("strips", "what it sees", choices=("strips",))
    input_names: tuple[str, ...]
    planners: tuple[str, ...]
    relative_std: float = quantity(0.0, "spread about the prediction", "", 0.0, 1e6)
    members: tuple[_Member, ...]
    about: dict[str, Any]
    sha256: str

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require(self.input_names == input_names(), "input_names", "must be those of this version; train again")
        for name, most in (("members", _MOST_MEMBERS), ("planners", _MOST_PLANNERS)):
            self.require(1 <= len(getattr(self, name)) <= most, name, f"must be from 1 to {most}")
        equal = all(abs(one.weight * len(self.members) - 1.0) < 1e-6 for one in self.members)
        self.require(equal, "members", "must weigh the same and add up to 1")


def shipped_weights() -> Path:
    """Return the file of the weights that come with the package, trained in generated worlds that are not barn300's."""
    return Path(str(resources.files("barn_metrics"))) / "data" / "difficulty.npz"


def save_model(model: DifficultyModel, path: Path) -> None:
    """Write a model; the same model gives the same bytes. WorldError if the file cannot be written."""
    arrays: dict[str, npt.NDArray[Any]] = {}
    for number, network in enumerate(model.networks):
        parts = {"mean": network.mean, "std": network.std}
        for layers, names in ((network.layers, ("weights", "bias")), (network.filters, ("filters", "filter_bias"))):
            for place, layer in enumerate(layers):
                parts |= {f"{name}{place}": one for name, one in zip(names, layer, strict=True)}
        arrays |= {f"m{number}_{name}": one.astype("<f8") for name, one in parts.items()}
    header = _Header(
        schema=FORMAT.schema,
        input_names=input_names(),
        planners=model.planners,
        relative_std=model.relative_std,
        members=tuple(_Member("sequence", 1.0 / len(model.networks), len(one.layers)) for one in model.networks),
        about=dict(model.about),
        sha256=_checksum(arrays),
    )
    FORMAT.write(path, as_dict(header), arrays)


def load_model(path: Path | str | None = None) -> DifficultyModel:
    """Return the model of a file, or the shipped one; ModelError in one line for a file that is no sound model."""
    where = shipped_weights() if path is None else Path(path)
    try:
        content, arrays = FORMAT.read(where)
        header = from_dict(_Header, content, f"{where}: {FORMAT.header}")
    except (WorldError, ConfigError) as error:
        raise ModelError(str(error)) from None
    if header.sha256 != _checksum(arrays):
        raise ModelError(f"{where}: damaged: its arrays do not have the checksum of the header")
    outputs = 2 * len(header.planners)
    networks = [_network(_Arrays(where, arrays, f"m{k}_"), one.layers, outputs) for k, one in enumerate(header.members)]
    return DifficultyModel(header.planners, tuple(networks), header.relative_std, header.about)


@dataclass(frozen=True)
class _Arrays:
    """The arrays of one network in a file; ModelError for those that do not fit."""

    where: Path
    arrays: Mapping[str, npt.NDArray[Any]]
    prefix: str

    def require(self, held: bool, what: str) -> None:
        if not held:
            raise ModelError(f"{self.where}: {what}")

    def array(self, name: str, *shape: int | None) -> Floats:
        """Return an array of the shape that it must have (None: any), all its values finite."""
        name = self.prefix + name
        self.require(name in self.arrays, f"has no array {name}")
        array = self.arrays[name]
        fits = array.ndim == len(shape) and all(
            want in (None, got) for want, got in zip(shape, array.shape, strict=True)
        )
        wanted = " x ".join("any" if side is None else str(side) for side in shape)
        got = f"{array.dtype} of shape {array.shape}"
        self.require(fits and array.dtype == np.dtype("<f8"), f"{name} must be {wanted} of f8, got {got}")
        self.require(bool(np.isfinite(array).all()), f"{name} holds values that are not finite")
        return array

    def layer(self, names: tuple[str, str], number: int, *shape: int | None) -> Layer:
        """Return weights of a shape, and the bias of as many values as they give."""
        weights = self.array(f"{names[0]}{number}", *shape)
        return weights, self.array(f"{names[1]}{number}", weights.shape[-1])


def _network(arrays: _Arrays, layers: int, outputs: int) -> RouteNetwork:
    size, seen = len(summary_names()), len(STRIPS) * CHANNELS
    mean, std = arrays.array("mean", size), arrays.array("std", size)
    arrays.require(bool((std > 0.0).all()), f"{arrays.prefix}std must be above 0")
    filters, connected = [], []
    for number in range(len(DILATIONS)):
        filters.append(arrays.layer(("filters", "filter_bias"), number, None, seen, None))
        span, _, seen = filters[-1][0].shape
        odd = f"{arrays.prefix}filters{number} must span an odd number of samples, got {span}"
        arrays.require(span % 2 == 1, odd)
    width = size + 2 * seen
    for number in range(layers):
        connected.append(arrays.layer(("weights", "bias"), number, width, outputs if number == layers - 1 else None))
        width = len(connected[-1][1])
    return RouteNetwork(mean, std, tuple(filters), tuple(connected))


def _checksum(arrays: Mapping[str, npt.NDArray[Any]]) -> str:
    """Return SHA-256 over names, types, shapes and contents."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
