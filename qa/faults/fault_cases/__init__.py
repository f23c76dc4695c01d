"""The fault cases, by families."""

from fault_cases import (
    bad_rows,
    campaigns,
    cheats,
    commands,
    direct,
    environment,
    files,
    folders,
    inputs,
    meddling,
    neighbours,
    network,
    planners,
    processes,
    settings,
)
from fault_cases.kit import CASES

FAMILIES = {
    direct.FAMILY: "Planners in direct mode",
    planners.FAMILY: "Planners over ROS",
    meddling.FAMILY: "Planners that interfere",
    processes.FAMILY: "Killed processes of a ROS run",
    campaigns.FAMILY: "Interrupted runs",
    files.FAMILY: "Disks and result files",
    inputs.FAMILY: "Malformed input files",
    commands.FAMILY: "Mistakes on the command line",
    environment.FAMILY: "Limits of the machine",
    network.FAMILY: "The live view",
}

__all__ = [
    "CASES",
    "FAMILIES",
    "bad_rows",
    "cheats",
    "folders",
    "neighbours",
    "settings",
]
