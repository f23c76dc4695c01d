"""Local planners behind one interface: DWA, elastic bands and baselines, as a library and as ROS 2 nodes."""

from barn_worlds import __version__ as __version__
