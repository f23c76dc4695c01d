"""Members of a model as plain arrays and a line of a header, and back, checked on the way."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_metrics.model.inputs import STRIPS, input_names
from barn_metrics.model.networks import DILATIONS, Layer, Network, SequenceNetwork
from barn_metrics.model.predictor import Member
from barn_metrics.model.route import CHANNELS
from barn_worlds.base.arrays import Floats
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import ModelError

Arrays = Mapping[str, npt.NDArray[Any]]
Shape = tuple[int | None, ...]


@dataclass(frozen=True)
class MemberHeader(Checked):
    """The line of a header that goes with a member's arrays."""

    kind: str = quantity("network", "what the arrays make", choices=("network", "sequence"))
    weight: float = quantity(1.0, "share in the average", minimum=0.0, maximum=1.0)
    layers: int = quantity(1, "fully connected layers", minimum=1, maximum=8)


def as_arrays(member: Member, prefix: str, arrays: dict[str, npt.NDArray[Any]]) -> MemberHeader:
    """Add a member's arrays under a prefix and return its line of the header; ModelError if it is no network."""
    function = member.function
    if not isinstance(function, (Network, SequenceNetwork)):
        raise ModelError("a file of weights holds networks only")
    arrays |= {f"{prefix}_mean": function.mean.astype("<f8"), f"{prefix}_std": function.std.astype("<f8")}
    _add(function.layers, f"{prefix}_weights", f"{prefix}_bias", arrays)
    if isinstance(function, SequenceNetwork):
        _add(function.filters, f"{prefix}_filters", f"{prefix}_filter_bias", arrays)
        return MemberHeader("sequence", member.weight, len(function.layers))
    return MemberHeader("network", member.weight, len(function.layers))


def from_arrays(header: MemberHeader, prefix: str, arrays: Arrays, ends: tuple[str, int], where: Path) -> Member:
    """Return the member that a line of the header and its arrays make; ModelError if they do not fit.

    ends: the set of inputs that it has to take, and the number of outputs that it has to give.
    """
    inputs, outputs = ends
    sequence = header.kind == "sequence"
    if sequence != (inputs == "strips"):
        raise ModelError(f"{where}: {prefix}: a {header.kind} does not take inputs {inputs!r}")
    size = len(input_names("rich" if sequence else inputs))
    mean, std = (_array(arrays, f"{prefix}_{name}", (size,), where) for name in ("mean", "std"))
    if not (std > 0.0).all():
        raise ModelError(f"{where}: {prefix}_std must be above 0")
    filters = _filters(prefix, arrays, where) if sequence else ()
    width = size + (2 * len(filters[-1][1]) if filters else 0)
    layers = _chain(prefix, ("weights", "bias"), arrays, (width,), [*[None] * (header.layers - 1), outputs], where)
    network = SequenceNetwork(mean, std, filters, layers) if sequence else Network(mean, std, layers)
    return Member(network, header.weight)


def _add(layers: Sequence[Layer], weights_name: str, bias_name: str, arrays: dict[str, npt.NDArray[Any]]) -> None:
    for number, (weights, bias) in enumerate(layers):
        arrays[f"{weights_name}{number}"] = weights.astype("<f8")
        arrays[f"{bias_name}{number}"] = bias.astype("<f8")


def _filters(prefix: str, arrays: Arrays, where: Path) -> tuple[Layer, ...]:
    """Return the layers of filters along strips."""
    first = (None, len(STRIPS) * CHANNELS)
    filters = _chain(prefix, ("filters", "filter_bias"), arrays, first, [None] * len(DILATIONS), where)
    for number, (weights, _) in enumerate(filters):
        if len(weights) % 2 == 0:
            what = f"{prefix}_filters{number} must span an odd number of samples"
            raise ModelError(f"{where}: {what}, got {len(weights)}")
    return filters


def _chain(
    prefix: str, names: tuple[str, str], arrays: Arrays, shape: Shape, outputs: Sequence[int | None], where: Path
) -> tuple[Layer, ...]:
    """Return layers of weights (..., in, out) and bias (out,), each of which takes what the one before gives.

    shape: of the first one's weights without `out`. outputs: what each of them has to give, None: any number.
    """
    layers = []
    for number, wanted in enumerate(outputs):
        weights = _array(arrays, f"{prefix}_{names[0]}{number}", (*shape, wanted), where)
        shape = (*shape[:-1], weights.shape[-1])
        layers.append((weights, _array(arrays, f"{prefix}_{names[1]}{number}", shape[-1:], where)))
    return tuple(layers)


def _array(arrays: Arrays, name: str, shape: Shape, where: Path) -> Floats:
    """Return an array of the shape that it must have (None: any above 0), all its values finite."""
    if name not in arrays:
        raise ModelError(f"{where}: has no array {name}")
    array = arrays[name]
    fits = array.ndim == len(shape) and all(want in (None, got) for want, got in zip(shape, array.shape, strict=True))
    if not fits or array.dtype != np.dtype("<f8"):
        wanted = " x ".join("any" if side is None else str(side) for side in shape)
        raise ModelError(f"{where}: {name} must be {wanted} of f8, got {array.dtype} of shape {array.shape}")
    if not np.isfinite(array).all():
        raise ModelError(f"{where}: {name} holds values that are not finite")
    return array
