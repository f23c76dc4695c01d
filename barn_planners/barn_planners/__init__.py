"""Local planners behind one interface: DWA, elastic bands and baselines, as a library and as ROS 2 nodes."""

__version__ = "0.1.0"
