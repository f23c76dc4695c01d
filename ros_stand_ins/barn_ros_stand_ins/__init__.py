"""Plain Python in place of ROS packages that have no wheel: tf2_ros and its like.

The file barn_ros_stand_ins.pth imports this module whenever Python starts. It adds a
finder behind all others, so that an installed package or a sourced ROS always wins.
"""

from __future__ import annotations

import sys
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path

MODULES = Path(__file__).with_name("modules")
"""Folder of the modules that are offered."""


class StandInFinder:
    """Finds modules that nothing else has found."""

    @staticmethod
    def find_spec(
        name: str,
        path: object = None,
        target: object = None,  # noqa: ARG004
    ) -> ModuleSpec | None:
        """Return the spec of an offered top-level module, None for any other."""
        if path is not None:
            return None
        return PathFinder.find_spec(name, [str(MODULES)])


if StandInFinder not in sys.meta_path:
    sys.meta_path.append(StandInFinder)
