"""Difficulty metrics of navigation worlds and the learned difficulty model."""

from barn_worlds import __version__ as __version__
