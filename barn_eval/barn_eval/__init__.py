"""Referee, recorder, trial runner, campaigns and the barn command of the BARN navigation benchmark."""

__version__ = "0.1.0"
