"""Files of weights: a header in JSON and plain arrays in one .npz, checked before anything is used.

Nothing in such a file is executed, and sizes are bounded before memory is taken. The arrays have to fit the header
exactly and to be finite, and their checksum is in it.
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
    "a difficulty model", "header.json", schema=1, largest_file=2**25, largest=2**27
)


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
        self.require(
            self.input_names == input_names(),
            "input_names",
            "must be those of this version; train again",
        )
        self.require(1 <= len(self.members) <= 64, "members", "must be from 1 to 64")
        self.require(1 <= len(self.planners) <= 16, "planners", "must be from 1 to 16")
        equal = all(
            abs(one.weight * len(self.members) - 1.0) < 1e-6 for one in self.members
        )
        self.require(equal, "members", "must weigh the same and add up to 1")


def default_weights() -> Path:
    """Return the file of the weights that come with the package, trained in generated worlds that are not barn300's."""
    return Path(str(resources.files("barn_metrics"))) / "data" / "difficulty.npz"


def save_model(model: DifficultyModel, path: Path) -> None:
    """Write a model; the same model gives the same bytes. WorldError if the file cannot be written."""
    arrays: dict[str, npt.NDArray[Any]] = {}
    for number, network in enumerate(model.networks):
        parts = {"mean": network.mean, "std": network.std}
        for layers, names in (
            (network.layers, ("weights", "bias")),
            (network.filters, ("filters", "filter_bias")),
        ):
            for place, layer in enumerate(layers):
                parts |= {
                    f"{name}{place}": one
                    for name, one in zip(names, layer, strict=True)
                }
        arrays |= {
            f"m{number}_{name}": one.astype("<f8") for name, one in parts.items()
        }
    header = _Header(
        schema=FORMAT.schema,
        input_names=input_names(),
        planners=model.planners,
        relative_std=model.relative_std,
        members=tuple(
            _Member("sequence", 1.0 / len(model.networks), len(one.layers))
            for one in model.networks
        ),
        about=dict(model.about),
        sha256=_checksum(arrays),
    )
    FORMAT.write(path, as_dict(header), arrays)


def load_model(path: Path | str | None = None) -> DifficultyModel:
    """Return the model of a file, or the shipped one; ModelError in one line for a file that is no sound model."""
    where = default_weights() if path is None else Path(path)
    try:
        content, arrays = FORMAT.read(where)
        header = from_dict(_Header, content, f"{where}: {FORMAT.header}")
    except (WorldError, ConfigError) as error:
        raise ModelError(str(error)) from None
    if header.sha256 != _checksum(arrays):
        raise ModelError(
            f"{where}: damaged: its arrays do not have the checksum of the header"
        )
    networks = [
        _network(where, arrays, k, one.layers, header.planners)
        for k, one in enumerate(header.members)
    ]
    return DifficultyModel(
        header.planners, tuple(networks), header.relative_std, header.about
    )


def _network(
    where: Path,
    arrays: Mapping[str, npt.NDArray[Any]],
    number: int,
    layers: int,
    planners: tuple[str, ...],
) -> RouteNetwork:
    """Return the network of that number in a file; ModelError for arrays that do not fit."""

    def require(held: bool, name: str, what: str) -> None:
        if not held:
            raise ModelError(f"{where}: {name} {what}")

    def array(name: str, *shape: int | None) -> Floats:
        """Return an array of the shape that it must have (None: any), all its values finite."""
        name = f"m{number}_{name}"
        if (found := arrays.get(name)) is None:
            raise ModelError(f"{where}: has no array {name}")
        fits = found.ndim == len(shape) and all(
            map(lambda want, got: want in (None, got), shape, found.shape)
        )
        wanted = " x ".join("any" if side is None else str(side) for side in shape)
        got = f"{found.dtype} of shape {found.shape}"
        require(
            fits and found.dtype == np.dtype("<f8"),
            name,
            f"must be {wanted} of f8, got {got}",
        )
        require(
            bool(np.isfinite(found).all()), name, "holds values that are not finite"
        )
        return found

    def layer(weights: str, bias: str, *shape: int | None) -> Layer:
        found = array(weights, *shape)
        return found, array(bias, found.shape[-1])

    size, seen = len(summary_names()), len(STRIPS) * CHANNELS
    mean, std = array("mean", size), array("std", size)
    require(bool((std > 0.0).all()), f"m{number}_std", "must be above 0")
    filters, connected = [], []
    for k in range(len(DILATIONS)):
        filters.append(layer(f"filters{k}", f"filter_bias{k}", None, seen, None))
        span, _, seen = filters[-1][0].shape
        require(
            span % 2 == 1,
            f"m{number}_filters{k}",
            f"must span an odd number of samples, got {span}",
        )
    width = size + 2 * seen
    for k in range(layers):
        connected.append(
            layer(
                f"weights{k}",
                f"bias{k}",
                width,
                2 * len(planners) if k == layers - 1 else None,
            )
        )
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
