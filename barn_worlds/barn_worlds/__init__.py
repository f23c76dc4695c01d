"""Worlds of the BARN navigation benchmark: generator, geometry, data sets, formats, map server."""

__version__ = "0.1.0"
