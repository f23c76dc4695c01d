"""The error of the difficulty model."""

from __future__ import annotations

from barn_worlds.errors import BarnError


class ModelError(BarnError):
    """Weights that cannot be read, trials that no model can be made of, or a library that training lacks."""
