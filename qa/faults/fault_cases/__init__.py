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
    direct.FAMILY: "Planners in mode direct",
    planners.FAMILY: "Planners over ROS",
    meddling.FAMILY: "Planners that meddle",
    processes.FAMILY: "Processes of a run over ROS",
    campaigns.FAMILY: "Campaigns that are disturbed",
    files.FAMILY: "Disks and files of results",
    inputs.FAMILY: "Files of strangers",
    commands.FAMILY: "Mistakes on the command line",
    environment.FAMILY: "The machine",
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
