"""What a bag says of its trial: the specification and the result that it was given, by anybody or nobody."""

import math
from typing import Any

from barn_eval.bags.bagfile import BagFile
from barn_sim.config import chassis_in
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.text_files import parse_json
from barn_worlds.base.types import Pose2D
from barn_worlds.robots.robot import Chassis
from barn_worlds.robots.standard import STANDARD
from barn_worlds.worlds.cells import STANDARD_CELL_M

ORIGIN = Pose2D(0.0, 0.0, 0.0)


def map_frame(trial: dict[str, Any]) -> Pose2D:
    """Return where the planner's map frame lies among the true poses: localisation is off with the map by as much.

    A pose that is matched to the map by particles has no fixed offset; there the map is off by its one cell.
    """
    off = specified(trial, "localisation", "offset_x_m", "offset_y_m")
    if off is None:
        return ORIGIN
    matched = trial["simulator"]["localisation"].get("historical_map") is True
    return Pose2D(0.0 - off[0], (STANDARD_CELL_M if matched else 0.0) - off[1], 0.0)


def specified(trial: dict[str, Any], part: str, *names: str) -> list[float] | None:
    """Return fields of a part of the simulator's configuration, None where they are not there as finite numbers."""
    try:
        values = [float(trial["simulator"][part][name]) for name in names]
    except (KeyError, TypeError, ValueError):
        return None
    return values if all(map(math.isfinite, values)) else None


def chassis_of(trial: dict[str, Any]) -> tuple[Chassis, str]:
    """Return the robot of a trial, the Jackal where none is named, and a note where it cannot be read."""
    try:
        return chassis_in(trial.get("simulator")), ""
    except ConfigError as error:
        return STANDARD.chassis, f"drawn as a {STANDARD.name}, for its robot cannot be read: {error}"


def metadata(bag: BagFile, name: str, key: str) -> dict[str, Any]:
    """Return a mapping that a bag has as JSON under a name and key; empty where it has none."""
    try:
        content = parse_json(bag.metadata.get(name, {}).get(key, "{}"), name)
    except ConfigError:
        return {}
    return content if isinstance(content, dict) else {}
