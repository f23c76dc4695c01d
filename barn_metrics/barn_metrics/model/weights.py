"""Files of weights: a header in JSON and plain arrays in one .npz, checked before anything is used.

Nothing in such a file is executed, no pickle is read, and sizes are bounded before memory is taken. The header names
the schema, the inputs and the members; the arrays have to fit it exactly and to be finite, and their checksum is in it.
"""

import hashlib
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_metrics.model.inputs import check_inputs, input_names
from barn_metrics.model.members import Arrays, MemberHeader, as_arrays, from_arrays
from barn_metrics.model.predictor import DifficultyModel
from barn_worlds.base.config import Checked, as_dict, from_dict, quantity
from barn_worlds.base.errors import ConfigError, ModelError, WorldError
from barn_worlds.formats.npz import NpzFormat

FORMAT = NpzFormat(
    "a difficulty model", "header.json", schema=1, largest_file=32 * 1024 * 1024, largest=128 * 1024 * 1024
)
_MOST_MEMBERS, _MOST_PLANNERS = 64, 16


@dataclass(frozen=True, kw_only=True)
class _Header(Checked):
    """What a file of weights says of its arrays, in the words of `DifficultyModel`."""

    schema: int
    recipe: str
    inputs: str
    input_names: tuple[str, ...]
    planners: tuple[str, ...]
    relative_std: float = quantity(0.0, "spread about the prediction", minimum=0.0, maximum=1e6)
    members: tuple[MemberHeader, ...]
    about: dict[str, Any]
    sha256: str


def shipped_weights() -> Path:
    """Return the file of the weights that come with the package, trained in generated worlds that are not barn300's."""
    return Path(str(resources.files("barn_metrics"))) / "data" / "difficulty.npz"


def save_model(model: DifficultyModel, path: Path) -> None:
    """Write a model; the same model gives the same bytes. WorldError if the file cannot be written."""
    arrays: dict[str, npt.NDArray[Any]] = {}
    members = tuple(as_arrays(member, f"m{number}", arrays) for number, member in enumerate(model.members))
    header = _Header(
        schema=FORMAT.schema,
        recipe=model.recipe,
        inputs=model.inputs,
        input_names=input_names(model.inputs),
        planners=model.planners,
        relative_std=model.relative_std,
        members=members,
        about=dict(model.about),
        sha256=_checksum(arrays),
    )
    FORMAT.write(path, as_dict(header), arrays)


def load_model(path: Path | str | None = None) -> DifficultyModel:
    """Return the model of a file, or the shipped one; ModelError in one line for a file that is no sound model."""
    where = shipped_weights() if path is None else Path(path)
    try:
        content, arrays = FORMAT.read(where)
        header = _header(content, where)
        if header.sha256 != _checksum(arrays):
            raise ModelError(f"{where}: damaged: its arrays do not have the checksum of the header")
        ends = header.inputs, 2 * len(header.planners) or 1
        members = tuple(
            from_arrays(one, f"m{number}", arrays, ends, where) for number, one in enumerate(header.members)
        )
    except (WorldError, ConfigError) as error:
        raise ModelError(str(error)) from None
    return DifficultyModel(header.recipe, header.inputs, header.planners, members, header.relative_std, header.about)


def _header(content: dict[str, Any], where: Path) -> _Header:
    """Return the checked header."""
    header = from_dict(_Header, content, f"{where}: {FORMAT.header}")
    check_inputs(header.inputs, f"{where}: ")
    if header.input_names != input_names(header.inputs):
        raise ModelError(f"{where}: was trained on other inputs than this version's set {header.inputs!r}; train again")
    for name, most in (("members", _MOST_MEMBERS), ("planners", _MOST_PLANNERS)):
        if len(getattr(header, name)) > most:
            raise ModelError(f"{where}: must have at most {most} {name}, got {len(getattr(header, name))}")
    if abs(sum(member.weight for member in header.members) - 1.0) > 1e-6:
        raise ModelError(f"{where}: weights of the members must add up to 1")
    return header


def _checksum(arrays: Arrays) -> str:
    """Return SHA-256 over names, types, shapes and contents."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
