"""The profile that keeps Fast DDS on the loopback interface, and whether a process has it."""

import os
from pathlib import Path

LOOPBACK = Path(__file__).parents[1] / "data" / "dds" / "loopback.xml"
LOOPBACK_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"


def reach() -> str:
    """Return how far this process looks for others, in the words of ROS.

    The profile may be that of another installation of the package, from which the process was started.
    """
    profile = Path(os.environ.get(LOOPBACK_VARIABLE, ""))
    if profile.parts[-3:] == LOOPBACK.parts[-3:]:
        return "LOCALHOST"
    return os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
