"""Data sets: numbered worlds from the package itself, a folder or a file, all used the same way."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from barn_worlds.errors import WorldError, suggest
from barn_worlds.formats import original
from barn_worlds.world import World


@dataclass(frozen=True, eq=False)
class Dataset:
    """Numbered worlds, read when asked for.

    readers: a function per index that returns the world; metrics: likewise the published metrics (5,), in the order of
    the paper, where there are any.
    """

    name: str
    readers: Mapping[int, Callable[[], World]]
    metrics: Mapping[int, Callable[[], npt.NDArray[np.float64] | None]] = field(default_factory=dict)

    @property
    def indices(self) -> tuple[int, ...]:
        """Numbers of the worlds, ascending."""
        return tuple(sorted(self.readers))

    def load(self, index: int) -> World:
        """Return a world; WorldError if there is none of that number or it cannot be read."""
        if index not in self.readers:
            raise WorldError(
                f"{self.name}: no world {index}{suggest(index, self.readers) if len(self.readers) < 20 else ''}"
            )
        return self.readers[index]()

    def published_metrics(self, index: int) -> npt.NDArray[np.float64] | None:
        """Return the published metrics (5,) of a world, or None."""
        return self.metrics[index]() if index in self.metrics else None

    @cached_property
    def checksum(self) -> str:
        """SHA-256 of all worlds and their numbers; reads them all."""
        digest = hashlib.sha256()
        for index in self.indices:
            digest.update(f"{index} {self.load(index).checksum}\n".encode())
        return digest.hexdigest()


def open_dataset(source: str | Path) -> Dataset:
    """Return the data set of a folder in the original layout; WorldError in one line if it is none."""
    path = Path(source)
    if original.is_original_folder(path):
        numbers = original.indices(path)
        return Dataset(
            path.resolve().name,
            {index: partial(original.read_world, path, index) for index in numbers},
            {index: partial(original.read_metrics, path, index) for index in numbers},
        )
    raise WorldError(f"{source}: not a data set")
