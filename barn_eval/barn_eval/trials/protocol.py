"""Trial protocols as data: where to start and end, when the clock runs, what ends a trial, how a failure counts.

Those that are built in are in data/protocols.yaml and docs/protocols.md. Others come from a YAML file, which may be
derived from one of these::

    schema_version: 1
    base: challenge
    name: slow_challenge
    limit_s: 200.0

A built-in name stands for exactly the built-in protocol: a derived one needs a name of its own.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from barn_worlds.base.arrays import Points
from barn_worlds.base.config import Checked, as_dict, from_dict, quantity
from barn_worlds.base.errors import ConfigError, format_value, suggest
from barn_worlds.base.text_files import read_package_yaml, read_yaml
from barn_worlds.base.types import Pose2D
from barn_worlds.robots.files import other_name
from barn_worlds.robots.robot import Chassis
from barn_worlds.worlds.cells import LEAD_IN_M, STANDARD_CELL_M, lead_in_cells
from barn_worlds.worlds.world import World

SCHEMA_VERSION = 1
_UNLIMITED_M = 1000.0  # of x, in a rule that sets no limit
ANCHORS = ("map", "path_first", "path_last", "start")
SOURCES = ("odometry", "truth")
METRICS = ("challenge", "challenge_2022", "normalised_time_s_per_m")


@dataclass(frozen=True)
class PoseRule(Checked):
    """A pose in the map frame: offsets from an anchor chosen per axis, then held within limits.

    Anchors: the map's origin, the first or last cell of the world's path in the historical conversion to metres
    (which is what the published trials used), or the start pose.
    """

    anchor_x: str = quantity("map", "what x is counted from", choices=ANCHORS)
    x_m: float = quantity(0.0, "x from its anchor", "m", -1000.0, 1000.0)
    x_min_m: float = quantity(
        -1000.0, "lowest x in the map frame", "m", -1000.0, 1000.0
    )
    x_max_m: float = quantity(
        1000.0, "highest x in the map frame", "m", -1000.0, 1000.0
    )
    anchor_y: str = quantity("map", "what y is counted from", choices=ANCHORS)
    y_m: float = quantity(0.0, "y from its anchor", "m", -1000.0, 1000.0)
    yaw_rad: float = quantity(
        math.pi / 2.0, "heading in the map frame", "rad", -math.pi, math.pi
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require(
            self.x_min_m <= self.x_max_m,
            "x_min_m",
            f"must be at most x_max_m = {self.x_max_m:g}",
        )

    def scaled_to(self, scale: float, first_column_m: float) -> "PoseRule":
        """Return the rule in a world of other cells, whose first column of obstacles lies at this y."""
        ahead_m, from_m = (
            (LEAD_IN_M, first_column_m) if self.anchor_y == "map" else (0.0, 0.0)
        )
        return replace(
            self,
            x_m=scale * self.x_m,
            x_min_m=max(scale * self.x_min_m, -_UNLIMITED_M),
            x_max_m=min(scale * self.x_max_m, _UNLIMITED_M),
            y_m=from_m + scale * (self.y_m - ahead_m),
        )

    def resolve(self, anchors: Mapping[str, tuple[float, float]]) -> Pose2D:
        """Return the pose, given the position of each anchor in metres."""
        for axis, name in (("x", self.anchor_x), ("y", self.anchor_y)):
            if name not in anchors:
                raise ConfigError(
                    f"anchor_{axis}: a start cannot be counted from {name!r}"
                )
        x, y = (
            anchors[self.anchor_x][0] + self.x_m,
            anchors[self.anchor_y][1] + self.y_m,
        )
        return Pose2D(min(max(x, self.x_min_m), self.x_max_m), y, self.yaw_rad)


@dataclass(frozen=True)
class Course:
    """Start and goal of one world under a protocol, in the map frame, and the lengths that times are divided by.

    path_length_m: arc length of the world's path. reference_length_m: start, path in the historical conversion,
    goal, as the challenge measures it. optimal_time_s: that length at the protocol's reference speed.
    """

    start: Pose2D
    goal: Pose2D
    path_length_m: float
    reference_length_m: float
    optimal_time_s: float


@dataclass(frozen=True)
class Protocol(Checked):
    """How trials are run and judged."""

    name: str = quantity("own", "name of the protocol")
    start: PoseRule = field(default_factory=PoseRule)
    goal: PoseRule = field(default_factory=PoseRule)
    clock_start_distance_m: float = quantity(
        math.sqrt(0.1), "motion that starts the clock", "m", 0.0, 100.0
    )
    clock_start_source: str = quantity(
        "odometry", "what that motion is measured by", choices=SOURCES
    )
    goal_distance_m: float = quantity(
        math.sqrt(0.1), "distance to the goal that ends a trial", "m", 0.01, 100.0
    )
    goal_source: str = quantity(
        "odometry", "what that distance is measured by", choices=SOURCES
    )
    limit_s: float = quantity(
        50.0, "longest time on the clock, simulated", "s", 0.1, 100_000.0
    )
    first_motion_limit_s: float = quantity(
        30.0, "longest simulated time until the clock starts", "s", 0.1, 100_000.0
    )
    collision_ends_trial: bool = quantity(False, "a contact ends the trial")
    simulator: str = quantity(
        "paper2020", "preset of the simulator that the trial starts from"
    )
    planner_preset: str = quantity(
        "paper2020", "preset of a planner that a run takes unless told otherwise"
    )
    movable_obstacles: bool = quantity(True, "obstacles can be pushed")
    map_given: bool = quantity(True, "the planner gets a map and a pose in it")
    historical_map: bool = quantity(
        False,
        "the map has its obstacles one cell nearer, as the maps of the original data set have; so has then the pose, "
        "which comes from matching scans to that map",
    )
    goal_period_s: float = quantity(
        0.1, "time between goals sent, 0 for once", "s", 0.0, 1000.0
    )
    control_period_s: float = quantity(
        0.05, "time between commands in lockstep", "s", 0.001, 10.0
    )
    failure_time_s: float = quantity(
        30.0, "time that a failed trial counts with", "s", minimum=0.0
    )
    timeout_time_s: float = quantity(
        30.0, "time that a trial cut off at the limit counts with", "s", minimum=0.0
    )
    reference_speed_mps: float = quantity(
        2.0, "speed of the optimal time", "m/s", 0.01, 100.0
    )
    metric: str = quantity(
        "normalised_time_s_per_m",
        "measure that planners are ranked by",
        choices=METRICS,
    )
    clipped: bool = quantity(
        True, "the time in the challenge metric is clipped to 2 T to 8 T", optional=True
    )
    look_period_s: float = quantity(
        0.0,
        "simulated time between two looks at the robot, by which a trial is judged; 0: each reading",
        "s",
        0.0,
        10.0,
        optional=True,
    )
    arena: bool = quantity(
        False, "made for arenas, worlds without the containment of BARN", optional=True
    )
    random_phase: bool = quantity(
        True,
        "moving obstacles begin at a time of their motions drawn from the trial's seed, not at 0",
        optional=True,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require(
            self.name.strip() != "" and self.name.isprintable(),
            "name",
            "must be printable text",
        )

    def course(self, world: World) -> Course:
        """Return start, goal and lengths of a world; ConfigError where it has no path, or is none for the protocol."""
        if world.start is not None and world.goal is not None:
            return self._own_course(world, world.start, world.goal)
        if self.arena != (world.corner_m is not None):
            is_one, fitting = (
                ("is no arena", CHALLENGE) if self.arena else ("is an arena", DYNABARN)
            )
            made = f"protocol {self.name} is not made for it, {fitting.name} is"
            raise ConfigError(f"world {world.name}: {is_one}; {made}")
        path = world.path_m(historical=True)
        if len(path) < 2:
            raise ConfigError(
                f"world {world.name}: protocol {self.name} needs a path of at least 2 cells"
            )
        anchors = {
            "map": (0.0, 0.0),
            "path_first": tuple(path[0].tolist()),
            "path_last": tuple(path[-1].tolist()),
        }
        start = self.start.resolve(anchors)
        goal = self.goal.resolve(anchors | {"start": (start.x, start.y)})
        return self._along(start, path, goal, world.path_length_m)

    def _own_course(self, world: World, start: Pose2D, goal: Pose2D) -> Course:
        """Return the course of a world that has start and goal of its own."""
        where = f"world {world.name}: "
        if self.historical_map:
            raise ConfigError(
                f"{where}has start and goal of its own; protocol {self.name} is for those of its rules"
            )
        if (apart_m := start.distance(goal)) <= self.goal_distance_m:
            arrived = f"start and goal are {apart_m:.2f} m apart, which is arrival under protocol {self.name}"
            raise ConfigError(where + arrived)
        return self._along(start, world.path_m(), goal, world.path_length_m)

    def _along(
        self, start: Pose2D, path: Points, goal: Pose2D, path_length_m: float
    ) -> Course:
        whole = np.vstack(([start.x, start.y], path, [goal.x, goal.y]))
        reference_m = float(np.hypot(*np.diff(whole, axis=0).T).sum())
        optimal_s = reference_m / self.reference_speed_mps
        return Course(start, goal, path_length_m, reference_m, optimal_s)

    def scaled_to(self, world: World, chassis: Chassis) -> "Protocol":
        """Return the rules for a robot in a world: themselves, for the standard one and in worlds of standard cells.

        For another robot all distances are in the cells of its world, so that it sees the same course in its own
        size: offsets of start and goal, the distances that start the clock and end the trial, and the reference speed,
        with times as they are. What is counted from the map's origin keeps its distance from the first column, where
        obstacles begin. Arenas are as they are. ConfigError if the robot does not fit between back wall and obstacles.
        """
        scale = world.resolution_m / STANDARD_CELL_M
        if (
            not other_name(chassis)
            or world.corner_m is not None
            or math.isclose(scale, 1.0)
        ):
            return self
        first_column_m = lead_in_cells(world.resolution_m) * world.resolution_m
        found = replace(
            self,
            start=self.start.scaled_to(scale, first_column_m),
            goal=self.goal.scaled_to(scale, first_column_m),
            clock_start_distance_m=scale * self.clock_start_distance_m,
            goal_distance_m=scale * self.goal_distance_m,
            reference_speed_mps=scale * self.reference_speed_mps,
        )
        if (
            found.start.anchor_y == "map"
            and found.start.y_m + chassis.extent_m[0] < world.resolution_m
        ):
            place = f"between the back wall and the obstacles, {first_column_m:.1f} m, at the start"
            fits = f"robot {chassis.name} does not fit {place} of protocol {self.name}"
            raise ConfigError(f"world {world.name}: {fits}")
        return found

    def map_offset_m(self) -> float:
        """Return how far along y the map given lies off the obstacles, in metres."""
        return -STANDARD_CELL_M if self.map_given and self.historical_map else 0.0


def load_protocol(source: str) -> Protocol:
    """Return the protocol of that name, or the one that a YAML file describes.

    Raises ConfigError in one line for an unknown name, an unreadable file, an unknown key, a value out of range, or a
    built-in name for other rules.
    """
    if source in PROTOCOLS:
        return PROTOCOLS[source]
    path = Path(source)
    if path.suffix not in (".yaml", ".yml"):
        raise ConfigError(
            f"unknown protocol {format_value(source)}{suggest(source, PROTOCOLS)} (or a .yaml file)"
        )
    content = read_yaml(path, SCHEMA_VERSION)
    required = ("name",) if content.get("base") else ("goal", "name", "start")
    if missing := next((key for key in required if key not in content), ""):
        hint = "" if content.get("base") else f" (or a base: {', '.join(PROTOCOLS)})"
        raise ConfigError(f"{source}: missing key {missing!r}{hint}")
    protocol = from_dict(Protocol, _based(content, source), source)
    check_protocol_name(protocol, f"{source}: ")
    return protocol


def check_protocol_name(protocol: Protocol, where: str = "") -> None:
    """Raise ConfigError for other rules under the name of a built-in protocol."""
    known = PROTOCOLS.get(protocol.name)
    if known is not None and known != protocol:
        key = next(
            item.name
            for item in fields(Protocol)
            if getattr(known, item.name) != getattr(protocol, item.name)
        )
        raise ConfigError(
            f"{where}name: {protocol.name!r} is built in with another {key}; give this one its own name"
        )


def _based(content: dict[str, Any], where: str) -> dict[str, Any]:
    """Return what a protocol says with what it takes over from its base."""
    if (base := content.pop("base", None)) is None:
        return content
    if not isinstance(base, str) or base not in PROTOCOLS:
        raise ConfigError(
            f"{where}: unknown base {format_value(base)}{suggest(base, PROTOCOLS)}"
        )
    merged = as_dict(PROTOCOLS[base])
    for key, value in content.items():
        merged[key] = (
            merged[key] | value
            if key in ("start", "goal") and isinstance(value, dict)
            else value
        )
    return merged


PROTOCOLS: dict[str, Protocol] = {}
for _name, _content in read_package_yaml("barn_eval", "protocols.yaml").items():
    PROTOCOLS[_name] = from_dict(
        Protocol, _based(_content | {"name": _name}, _name), _name
    )
CHALLENGE, DYNABARN, KNOWN_MAP, PAPER_2020, CHALLENGE_2022, CHALLENGE_2022_03 = (
    PROTOCOLS.values()
)
