"""Difficulty metrics of navigation worlds and the learned difficulty model."""

__version__ = "0.1.0"
