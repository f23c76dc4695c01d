"""Members of a model as plain arrays and a line of a header, and back, judged on the way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_metrics.model.errors import ModelError
from barn_metrics.model.forest import Forest
from barn_metrics.model.inputs import STRIPS, input_names
from barn_metrics.model.network import Network
from barn_metrics.model.predictor import Member
from barn_metrics.model.sequence import DILATIONS, SequenceNetwork
from barn_metrics.model.strips import CHANNELS

KINDS = ("network", "forest", "sequence")
_TREE_ARRAYS = {"roots": "i4", "column": "i2", "threshold": "f8", "left": "i4", "right": "i4", "value": "f4"}

Arrays = Mapping[str, npt.NDArray[Any]]
Pairs = tuple[tuple[npt.NDArray[Any], npt.NDArray[Any]], ...]


def flatten(member: Member, prefix: str, arrays: dict[str, npt.NDArray[Any]]) -> dict[str, Any]:
    """Add a member's arrays under a prefix and return its line of the header."""
    function = member.function
    if isinstance(function, Forest):
        arrays |= {
            f"{prefix}_{name}": getattr(function, name).astype("<" + kind) for name, kind in _TREE_ARRAYS.items()
        }
        return {"kind": "forest", "weight": member.weight, "trees": len(function.roots)}
    arrays[f"{prefix}_mean"], arrays[f"{prefix}_std"] = (one.astype("<f8") for one in (function.mean, function.std))
    _flatten_pairs(function.layers, f"{prefix}_weights", f"{prefix}_bias", arrays)
    if isinstance(function, SequenceNetwork):
        _flatten_pairs(function.filters, f"{prefix}_filters", f"{prefix}_filter_bias", arrays)
        return {"kind": "sequence", "weight": member.weight, "layers": len(function.layers)}
    sizes = [len(function.mean), *(len(bias) for _, bias in function.layers)]
    return {"kind": "network", "weight": member.weight, "layers": len(function.layers), "sizes": sizes}


def read_member(part: Mapping[str, Any], prefix: str, arrays: Arrays, ends: tuple[str, int], where: Path) -> Member:
    """Return the member that a line of the header and its arrays make; ModelError if they do not fit.

    ends: the set of inputs that it has to take, and the number of outputs that it has to give.
    """
    inputs, outputs = ends
    weight, size = float(part["weight"]), len(input_names(inputs))
    if part["kind"] == "forest":
        return Member(_forest(prefix, arrays, (size, outputs), where), weight)
    sequence = part["kind"] == "sequence"
    if sequence != (inputs == "strips"):
        raise ModelError(f"{where}: {prefix}: a {part['kind']} does not take inputs {inputs!r}")
    size = len(input_names("rich")) if sequence else size
    mean, std = (_array(arrays, f"{prefix}_{name}", (size,), "f8", where) for name in ("mean", "std"))
    if not (std > 0.0).all():
        raise ModelError(f"{where}: {prefix}_std must be above 0")
    if not sequence:
        return Member(Network(mean, std, _layers(prefix, arrays, size, outputs, part["layers"], where)), weight)
    filters = _filters(prefix, arrays, where)
    layers = _layers(prefix, arrays, 2 * len(filters[-1][1]) + size, outputs, part["layers"], where)
    return Member(SequenceNetwork(mean, std, filters, layers), weight)


def _flatten_pairs(
    pairs: Sequence[tuple[npt.NDArray[Any], npt.NDArray[Any]]],
    weights_name: str,
    bias_name: str,
    arrays: dict[str, npt.NDArray[Any]],
) -> None:
    for number, (weights, bias) in enumerate(pairs):
        arrays[f"{weights_name}{number}"] = weights.astype("<f8")
        arrays[f"{bias_name}{number}"] = bias.astype("<f8")


def _layers(prefix: str, arrays: Arrays, width: int, outputs: int, count: int, where: Path) -> Pairs:
    """Return fully connected layers from that width to that many outputs."""
    layers = []
    for number in range(count):
        shape = (width, outputs if number == count - 1 else None)
        weights = _array(arrays, f"{prefix}_weights{number}", shape, "f8", where)
        width = weights.shape[1]
        layers.append((weights, _array(arrays, f"{prefix}_bias{number}", (width,), "f8", where)))
    return tuple(layers)


def _filters(prefix: str, arrays: Arrays, where: Path) -> Pairs:
    """Return the layers of filters along strips."""
    filters = []
    channels = len(STRIPS) * CHANNELS
    for number in range(len(DILATIONS)):
        name = f"{prefix}_filters{number}"
        weights = _array(arrays, name, (None, channels, None), "f8", where)
        if len(weights) % 2 == 0:
            raise ModelError(f"{where}: {name} must span an odd number of samples, got {len(weights)}")
        channels = weights.shape[2]
        filters.append((weights, _array(arrays, f"{prefix}_filter_bias{number}", (channels,), "f8", where)))
    return tuple(filters)


def _forest(prefix: str, arrays: Arrays, ends: tuple[int, int], where: Path) -> Forest:
    nodes = len(_array(arrays, f"{prefix}_column", (None,), "i2", where))
    shapes: dict[str, tuple[int | None, ...]] = dict.fromkeys(_TREE_ARRAYS, (nodes,))
    shapes |= {"roots": (None,), "value": (nodes, ends[1])}
    read = {name: _array(arrays, f"{prefix}_{name}", shapes[name], kind, where) for name, kind in _TREE_ARRAYS.items()}
    forest = Forest(**read)
    inner = forest.column >= 0
    after = np.stack([forest.left, forest.right])[:, inner]
    # A way down leads to later nodes only, so that it ends.
    sound = (
        nodes > 0
        and len(forest.roots) > 0
        and ((forest.roots >= 0) & (forest.roots < nodes)).all()
        and ((forest.column >= -1) & (forest.column < ends[0])).all()
        and ((after > np.flatnonzero(inner)) & (after < nodes)).all()
    )
    if not sound:
        raise ModelError(f"{where}: {prefix} is no forest: a node leads outside, back, or looks at no input")
    return forest


def _array(arrays: Arrays, name: str, shape: tuple[int | None, ...], kind: str, where: Path) -> npt.NDArray[Any]:
    """Return an array of the shape (None: any above 0) and kind that it must have, all its values finite."""
    if name not in arrays:
        raise ModelError(f"{where}: has no array {name}")
    array = arrays[name]
    fits = array.ndim == len(shape) and all(want in (None, got) for want, got in zip(shape, array.shape, strict=True))
    if not fits or array.dtype != np.dtype("<" + kind):
        wanted = " x ".join("any" if side is None else str(side) for side in shape)
        raise ModelError(f"{where}: {name} must be {wanted} of {kind}, got {array.dtype} of shape {array.shape}")
    if not np.isfinite(array).all():
        raise ModelError(f"{where}: {name} holds values that are not finite")
    return array
