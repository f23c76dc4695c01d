"""Worlds of cells: generator, C-space, path, data sets."""
