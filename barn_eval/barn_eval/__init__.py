"""Referee, recorder, trial runner, campaigns and the barn command of the BARN navigation benchmark."""

from barn_worlds import __version__ as __version__
