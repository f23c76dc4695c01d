"""Files of weights: a header in JSON and plain arrays in one .npz, checked before anything is used.

Nothing in such a file is executed, no pickle is read, and sizes are bounded before memory is taken. The header names
the schema, the inputs and the members; the arrays have to fit it exactly and to be finite, and their checksum is in it.
"""

import hashlib
from collections.abc import Mapping, Sequence
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

_Arrays = Mapping[str, npt.NDArray[Any]]


@dataclass(frozen=True)
class _Member(Checked):
    """What the header says of one network."""

    kind: str = quantity("sequence", "what its arrays make", choices=("sequence",))
    weight: float = quantity(1.0, "share in the mean", minimum=0.0, maximum=1.0)
    layers: int = quantity(2, "fully connected layers", minimum=1, maximum=8)


@dataclass(frozen=True, kw_only=True)
class _Header(Checked):
    """What a file of weights says of its arrays, in the words of `DifficultyModel`."""

    schema: int
    recipe: str = quantity("routes", "how it was trained", choices=("routes",))
    inputs: str = quantity("strips", "what it sees", choices=("strips",))
    input_names: tuple[str, ...]
    planners: tuple[str, ...]
    relative_std: float = quantity(0.0, "spread about the prediction", minimum=0.0, maximum=1e6)
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
        arrays |= {f"m{number}_mean": network.mean.astype("<f8"), f"m{number}_std": network.std.astype("<f8")}
        for layers, names in ((network.layers, ("weights", "bias")), (network.filters, ("filters", "filter_bias"))):
            for place, layer in enumerate(layers):
                arrays |= {
                    f"m{number}_{name}{place}": one.astype("<f8") for name, one in zip(names, layer, strict=True)
                }
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
    read = _Reader(where, arrays)
    networks = [
        read.network(f"m{number}", one.layers, 2 * len(header.planners)) for number, one in enumerate(header.members)
    ]
    return DifficultyModel(header.planners, tuple(networks), header.relative_std, header.about)


@dataclass(frozen=True)
class _Reader:
    """Makes networks of the arrays of a file; ModelError for arrays that do not fit."""

    where: Path
    arrays: _Arrays

    def network(self, prefix: str, layers: int, outputs: int) -> RouteNetwork:
        size = len(summary_names())
        mean, std = (self._array(f"{prefix}_{name}", (size,)) for name in ("mean", "std"))
        if not (std > 0.0).all():
            raise ModelError(f"{self.where}: {prefix}_std must be above 0")
        seen = (None, len(STRIPS) * CHANNELS)
        filters = self._chain(prefix, ("filters", "filter_bias"), seen, [None] * len(DILATIONS))
        for number, (weights, _) in enumerate(filters):
            if len(weights) % 2 == 0:
                what = f"{prefix}_filters{number} must span an odd number of samples"
                raise ModelError(f"{self.where}: {what}, got {len(weights)}")
        width = size + 2 * len(filters[-1][1])
        connected = self._chain(prefix, ("weights", "bias"), (width,), [*[None] * (layers - 1), outputs])
        return RouteNetwork(mean, std, filters, connected)

    def _chain(
        self, prefix: str, names: tuple[str, str], shape: tuple[int | None, ...], outputs: Sequence[int | None]
    ) -> tuple[Layer, ...]:
        """Return layers of weights (..., in, out) and bias (out,), each of which takes what the one before gives.

        shape: of the first one's weights without `out`. outputs: what each of them has to give, None: any number.
        """
        layers = []
        for number, wanted in enumerate(outputs):
            weights = self._array(f"{prefix}_{names[0]}{number}", (*shape, wanted))
            shape = (*shape[:-1], weights.shape[-1])
            layers.append((weights, self._array(f"{prefix}_{names[1]}{number}", shape[-1:])))
        return tuple(layers)

    def _array(self, name: str, shape: tuple[int | None, ...]) -> Floats:
        """Return an array of the shape that it must have (None: any), all its values finite."""
        if name not in self.arrays:
            raise ModelError(f"{self.where}: has no array {name}")
        array = self.arrays[name]
        fits = array.ndim == len(shape) and all(
            want in (None, got) for want, got in zip(shape, array.shape, strict=True)
        )
        if not fits or array.dtype != np.dtype("<f8"):
            wanted = " x ".join("any" if side is None else str(side) for side in shape)
            raise ModelError(f"{self.where}: {name} must be {wanted} of f8, got {array.dtype} of shape {array.shape}")
        if not np.isfinite(array).all():
            raise ModelError(f"{self.where}: {name} holds values that are not finite")
        return array


def _checksum(arrays: _Arrays) -> str:
    """Return SHA-256 over names, types, shapes and contents."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
