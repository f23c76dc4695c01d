"""Local planners behind one interface, as a library and as ROS 2 nodes.

`interface` defines what a planner is and `registry` makes planners by name. DWA,
elastic bands, MPPI, follow-the-gap and learned policies each have a folder of their
own.
"""

from barn_worlds import __version__ as __version__
