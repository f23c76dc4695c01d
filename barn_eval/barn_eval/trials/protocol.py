"""Trial protocols as data: start and goal, clock, end of a trial, cost of a failure.

Built-in protocols are in data/protocols.yaml and docs/protocols.md. Others come from a
YAML file, which may be derived from a built-in one::

    schema_version: 1
    base: challenge
    name: slow_challenge
    limit_s: 200.0

A built-in name stands for exactly the built-in protocol, so a derived protocol needs a
name of its own.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from barn_worlds.base.arrays import Points, side_lengths
from barn_worlds.base.config import (
    Checked,
    optional,
    quantity,
    read_presets,
    replace_dotted,
)
from barn_worlds.base.errors import ConfigError, format_value, suggest
from barn_worlds.base.files import read_yaml
from barn_worlds.base.types import Pose2D
from barn_worlds.robots.files import name_unless_standard
from barn_worlds.robots.robot import Chassis
from barn_worlds.worlds.cells import LEAD_IN_M, STANDARD_CELL_M, lead_in_cells
from barn_worlds.worlds.world import World

SCHEMA_VERSION = 1
ANCHORS = ("map", "path_first", "path_last", "start")
SOURCES = ("odometry", "truth")
METRICS = ("challenge", "challenge_2022", "normalised_time_s_per_m")
_UNLIMITED_M = 1000.0  # of x, in a rule that sets no limit
_ARRIVAL_REACHES = 4.0  # of a robot: for the Jackal 1.02 m, more than any protocol has


@dataclass(frozen=True)
class PoseRule(Checked):
    """A pose in the map frame: an offset from an anchor per axis, held within limits.

    Anchors are the map's origin, the start pose, and the first and last cell of the
    world's path in the historical conversion to meters, which the published trials
    used.
    """

    anchor_x: str = quantity("map", "reference point of x", choices=ANCHORS)
    x_m: float = quantity(
        0.0, "x relative to its reference point", "m", -1000.0, 1000.0
    )
    x_min_m: float = quantity(
        -1000.0, "lowest x in the map frame", "m", -1000.0, 1000.0
    )
    x_max_m: float = quantity(
        1000.0, "highest x in the map frame", "m", -1000.0, 1000.0
    )
    anchor_y: str = quantity("map", "reference point of y", choices=ANCHORS)
    y_m: float = quantity(
        0.0, "y relative to its reference point", "m", -1000.0, 1000.0
    )
    yaw_rad: float = quantity(
        math.pi / 2.0, "heading in the map frame", "rad", -math.pi, math.pi
    )

    def check_rules(self) -> None:
        """Raise ConfigError for a value out of range, or x_min_m above x_max_m."""
        self.require_order("x_min_m", "at most", "x_max_m")

    def scaled_to(self, scale: float, first_column_m: float) -> "PoseRule":
        """Return the rule scaled; y from the map keeps its gap to the first column.

        Anchors and yaw stay. That y keeps its scaled distance from the first column of
        obstacles.

        Args:
            scale: Size of the world's cells by that of standard cells.
            first_column_m: y at which the world's obstacles begin, in meters.
        """
        # What is counted from the map's origin keeps its scaled distance from the first
        # column of obstacles.
        standard_column_m = 0.0
        if self.anchor_y == "map":
            standard_column_m = LEAD_IN_M
        else:
            first_column_m = 0.0
        return replace(
            self,
            x_m=scale * self.x_m,
            x_min_m=max(scale * self.x_min_m, -_UNLIMITED_M),
            x_max_m=min(scale * self.x_max_m, _UNLIMITED_M),
            y_m=first_column_m + scale * (self.y_m - standard_column_m),
        )

    def resolve(self, anchors: Mapping[str, tuple[float, float]]) -> Pose2D:
        """Return the pose, x within its limits; ConfigError for an anchor not given.

        `anchors` has x and y in m of each anchor by name, in the map frame.

        Raises:
            ConfigError: An anchor of the rule is not among them.
        """
        for axis, anchor in (("x", self.anchor_x), ("y", self.anchor_y)):
            if anchor not in anchors:
                raise ConfigError(
                    f"anchor_{axis}: a start cannot be relative to {anchor!r}"
                )
        x = anchors[self.anchor_x][0] + self.x_m
        y = anchors[self.anchor_y][1] + self.y_m
        return Pose2D(min(max(x, self.x_min_m), self.x_max_m), y, self.yaw_rad)


@dataclass(frozen=True)
class Course:
    """Start and goal of one world in the map frame, and lengths that times refer to."""

    start: Pose2D
    goal: Pose2D
    # Arc length of the world's path; None of a world that is unknown, with a path of
    # one cell.
    path_length_m: float | None
    # Start, path in the historical conversion, goal: as the challenge measures it.
    reference_length_m: float
    # The reference length at the protocol's reference speed; None with the path's.
    optimal_time_s: float | None
    # x_min, y_min, x_max, y_max in m that the robot may not leave.
    bounds_m: tuple[float, float, float, float] = (
        -math.inf,
        -math.inf,
        math.inf,
        math.inf,
    )


@dataclass(frozen=True)
class Protocol(Checked):
    """How trials are run and judged."""

    name: str = quantity("own", "name of the protocol")
    start: PoseRule = PoseRule()
    goal: PoseRule = PoseRule()
    clock_start_distance_m: float = quantity(
        math.sqrt(0.1),
        "distance from the start that starts the clock; 0: the clock starts with the goal",
        "m",
        0.0,
        100.0,
    )
    clock_start_source: str = quantity(
        "odometry", "source of the pose for clock_start_distance_m", choices=SOURCES
    )
    goal_distance_m: float = quantity(
        math.sqrt(0.1), "distance to the goal that ends a trial", "m", 0.01, 100.0
    )
    goal_source: str = quantity(
        "odometry", "source of the pose for goal_distance_m", choices=SOURCES
    )
    limit_s: float = quantity(
        50.0, "longest simulated time on the clock", "s", 0.1, 100_000.0
    )
    first_motion_limit_s: float = quantity(
        30.0, "longest simulated time until the clock starts", "s", 0.1, 100_000.0
    )
    collision_ends_trial: bool = quantity(False, "whether a contact ends the trial")
    simulator: str = quantity(
        "paper2020", "preset of the simulator that the trial starts from"
    )
    planner_preset: str = quantity(
        "paper2020", "preset of planners unless a run names another preset"
    )
    movable_obstacles: bool = quantity(True, "whether the robot can push obstacles")
    map_given: bool = quantity(
        True, "whether the planner gets a map and its pose in the map"
    )
    historical_map: bool = quantity(
        False,
        "whether the map shows obstacles one cell too near, as in the original data set; this"
        " also shifts the pose, which is estimated by matching scans to the map",
    )
    goal_period_s: float = quantity(
        0.1,
        "period at which the goal is sent again; 0: the goal is sent once",
        "s",
        0.0,
        1000.0,
    )
    control_period_s: float = quantity(
        0.05, "time between commands in lockstep", "s", 0.001, 10.0
    )
    failure_time_s: float = quantity(
        30.0, "time that counts for a failed trial", "s", minimum=0.0
    )
    timeout_time_s: float = quantity(
        30.0, "time that counts for a trial that reaches the limit", "s", minimum=0.0
    )
    reference_speed_mps: float = quantity(
        2.0, "speed that defines the optimal time", "m/s", 0.01, 100.0
    )
    metric: str = quantity(
        "normalised_time_s_per_m", "measure that ranks planners", choices=METRICS
    )
    clipped: bool = optional(
        True,
        "whether the challenge metric clips the time to 2 to 8 times the optimal time",
    )
    look_period_s: float = optional(
        0.0,
        "simulated time between two checks of the robot by the referee; 0: every reading is checked",
        "s",
        0.0,
        10.0,
    )
    arena: bool = optional(
        False,
        "whether the protocol is for arenas, which are worlds without BARN's containment",
    )
    edge_m: float = optional(
        _UNLIMITED_M,
        "how far the robot may drive beyond the cells of the world",
        "m",
        0.0,
        _UNLIMITED_M,
    )
    own_limit: float = optional(
        3.0,
        "factor on the time that the path of a world's own course takes at a quarter of the reference speed (or at"
        " the robot's top speed, if lower); the limit is at least this product; 0: the limit is limit_s",
        "",
        0.0,
        1000.0,
    )
    random_phase: bool = optional(
        True,
        "whether moving obstacles start at a random time in their motions, drawn from"
        " the trial's seed, instead of at 0",
    )
    clear_start_s: float = optional(
        0.0,
        "with a random start time: time for which no moving obstacle reaches a robot that waits at its start",
        "s",
        0.0,
        1000.0,
    )

    def check_rules(self) -> None:
        """Raise ConfigError for a value out of range, or a name not printable."""
        self.require(
            self.name.strip() != "" and self.name.isprintable(),
            "name",
            "must be printable text",
        )

    @property
    def longest_look_s(self) -> float:
        """Control or look period in s, whichever is longer."""
        return max(self.control_period_s, self.look_period_s)

    @property
    def longest_failure_time_s(self) -> float:
        """Seconds that count for a failure or a timeout, whichever are more."""
        return max(self.failure_time_s, self.timeout_time_s)

    def course(self, world: World) -> Course:
        """Return a world's own course, else one by the rules; ConfigError if none fits.

        For a robot of another size, call it on the protocol that `scaled_to` returns.

        Raises:
            ConfigError: The world has no path, or does not fit the protocol.
        """
        where = f"world {world.name}: "
        if world.start is not None and world.goal is not None:
            if self.historical_map:
                raise ConfigError(
                    f"{where}has its own start and goal, but protocol {self.name} sets both by its rules"
                )
            distance_m = world.start.distance(world.goal)
            if distance_m <= self.goal_distance_m:
                raise ConfigError(
                    f"{where}start and goal are {distance_m:.2f} m apart, which counts as"
                    f" arrival under protocol {self.name}"
                )
            return self._measure_course(world, world.start, world.path_m(), world.goal)

        is_arena = world.corner_m is not None
        if self.arena != is_arena:
            kind = "is an arena" if is_arena else "is not an arena"
            protocol = DYNABARN if is_arena else CHALLENGE
            raise ConfigError(
                f"{where}{kind}, so protocol {self.name} does not fit it; use"
                f" {protocol.name}"
            )
        path = world.path_m(historical=True)
        if len(path) < 2:
            raise ConfigError(
                f"{where}protocol {self.name} needs a path of at least 2 cells"
            )
        anchors = {
            "map": (0.0, 0.0),
            "path_first": tuple(path[0].tolist()),
            "path_last": tuple(path[-1].tolist()),
        }
        start = self.start.resolve(anchors)
        anchors["start"] = start.position
        goal = self.goal.resolve(anchors)
        return self._measure_course(world, start, path, goal)

    def _measure_course(
        self, world: World, start: Pose2D, path: Points, goal: Pose2D
    ) -> Course:
        """Return the course along `path` (n, 2) in m, straight if of unknown length."""
        points = np.vstack((start.position, path, goal.position))
        reference_m = float(side_lengths(points).sum())
        if not world.path_length_m:
            return Course(start, goal, None, start.distance(goal), None)
        optimal_s = reference_m / self.reference_speed_mps
        left, bottom, right, top = world.bounds_m
        edge_m = self.edge_m
        return Course(
            start,
            goal,
            world.path_length_m,
            reference_m,
            optimal_s,
            (left - edge_m, bottom - edge_m, right + edge_m, top + edge_m),
        )

    def scaled_to(self, world: World, chassis: Chassis) -> "Protocol":
        """Return the protocol scaled to a robot's cells; on own courses, arrival only.

        Another robot then sees the same course in its own size. Offsets of start and
        goal, the distances that start the clock and end the trial, and the reference
        speed scale; times stay. The protocol itself is returned for the standard robot,
        for arenas and for worlds of standard cells. On courses of a world's own, only
        the distance that ends the trial changes, for small robots.

        Args:
            world: World with cells in the size of the robot.
            chassis: Body of the robot.

        Raises:
            ConfigError: The robot does not fit between back wall and obstacles.
        """
        if world.start is not None:
            # What a protocol says holds for its own robot.
            if not name_unless_standard(chassis):
                return self
            # A small robot has to come closer to a goal that is made for it.
            reach_m = max(map(abs, chassis.extent_m))
            arrival_m = min(self.goal_distance_m, _ARRIVAL_REACHES * reach_m)
            return replace(self, goal_distance_m=arrival_m)

        scale = world.resolution_m / STANDARD_CELL_M
        is_standard = not name_unless_standard(chassis) or math.isclose(scale, 1.0)
        if is_standard or world.corner_m is not None:
            return self

        first_column_m = lead_in_cells(world.resolution_m) * world.resolution_m
        start = self.start.scaled_to(scale, first_column_m)
        rear_m = start.y_m + chassis.extent_m[0]
        if start.anchor_y == "map" and rear_m < world.resolution_m:
            raise ConfigError(
                f"world {world.name}: robot {chassis.name} does not fit between the"
                f" back wall and the obstacles, {first_column_m:.1f} m, at the start of"
                f" protocol {self.name}"
            )
        return replace(
            self,
            start=start,
            goal=self.goal.scaled_to(scale, first_column_m),
            clock_start_distance_m=scale * self.clock_start_distance_m,
            goal_distance_m=scale * self.goal_distance_m,
            edge_m=min(scale * self.edge_m, _UNLIMITED_M),
            reference_speed_mps=scale * self.reference_speed_mps,
        )

    def extend_to(self, world: World, max_speed_mps: float) -> "Protocol":
        """Return the protocol, limit and failure times raised for a long own course.

        Times that count for failures rise with it. The protocol itself is returned for
        worlds without a course of their own, and where its limit is long enough.

        Args:
            world: World whose path is measured.
            max_speed_mps: Highest speed of the robot.
        """
        if world.start is None or self.limit_is_chosen:
            return self
        speed_mps = min(max_speed_mps, self.slow_speed_mps)
        limit_s = self.own_limit * math.ceil(world.path_length_m / speed_mps)
        if limit_s <= self.limit_s:
            return self
        scale = limit_s / self.limit_s
        return replace(
            self,
            limit_s=limit_s,
            failure_time_s=scale * self.failure_time_s,
            timeout_time_s=scale * self.timeout_time_s,
        )

    @property
    def limit_is_chosen(self) -> bool:
        """Whether own_limit is 0, or no built-in protocol has this limit_s."""
        built_in = {protocol.limit_s for protocol in PROTOCOLS.values()}
        return self.own_limit == 0.0 or self.limit_s not in built_in

    @property
    def slow_speed_mps(self) -> float:
        """A quarter of the reference speed in m/s; it gets half of the best metric."""
        return self.reference_speed_mps / 4.0

    def ranking_metric(self, world: World, max_speed_mps: float) -> str:
        """Return the metric; "efficiency" for challenge on own courses or slow robots.

        The optimal time is made for the course of the challenge and for a robot that
        can reach its speed.

        Args:
            world: World of the trial.
            max_speed_mps: Highest speed of the robot.
        """
        is_slow = max_speed_mps < self.slow_speed_mps
        if self.metric.startswith("challenge") and (world.start is not None or is_slow):
            return "efficiency"
        return self.metric

    def map_offset_m(self) -> float:
        """Return by how many m the planner's map is shifted along y: -0.15 or 0.

        The shift is from where obstacles truly stand: one standard cell in the historical
        map.
        """
        return -STANDARD_CELL_M if self.map_given and self.historical_map else 0.0


def load_protocol(source: str) -> Protocol:
    """Return a protocol, built in or from a YAML file; raise ConfigError if invalid.

    Raises:
        ConfigError: The name or a key is unknown, the file cannot be read, a value is
            out of range, or the file has other rules under a built-in name.
    """
    if source in PROTOCOLS:
        return PROTOCOLS[source]
    path = Path(source)
    if path.suffix not in (".yaml", ".yml"):
        raise ConfigError(
            f"unknown protocol {format_value(source)}{suggest(source, PROTOCOLS)}"
            " (or a .yaml file)"
        )
    content = read_yaml(path, SCHEMA_VERSION)
    base = content.pop("base", None)
    standard = Protocol()
    required = ["goal", "name", "start"]
    hint = f" (or a base: {', '.join(PROTOCOLS)})"
    if base is not None:
        if not isinstance(base, str) or base not in PROTOCOLS:
            raise ConfigError(
                f"{source}: unknown base {format_value(base)}{suggest(base, PROTOCOLS)}"
            )
        standard = PROTOCOLS[base]
        required = ["name"]
        hint = ""
    for key in required:
        if key not in content:
            raise ConfigError(f"{source}: missing key {key!r}{hint}")
    # A limit that somebody chose is kept.
    if "limit_s" in content:
        content.setdefault("own_limit", 0.0)
    protocol = replace_dotted(standard, content, source)
    check_protocol_name(protocol, f"{source}: ")
    return protocol


def check_protocol_name(protocol: Protocol, where: str = "") -> None:
    """Raise ConfigError if a protocol has a built-in one's name but other rules.

    Args:
        protocol: Protocol to check.
        where: Beginning of the message, such as the file that the protocol is from.
    """
    built_in = PROTOCOLS.get(protocol.name, protocol)
    for item in fields(Protocol):
        if getattr(built_in, item.name) != getattr(protocol, item.name):
            raise ConfigError(
                f"{where}name: {protocol.name!r} is built in with another {item.name};"
                " choose a different name"
            )


# By name. A built-in protocol may have one above it in the file as its base.
PROTOCOLS = {
    name: replace(protocol, name=name)
    for name, protocol in read_presets(
        "barn_eval", "protocols.yaml", Protocol()
    ).items()
}
# In the order of the file.
(
    CHALLENGE,
    DYNABARN,
    DYNABARN_CLOCK,
    DYNABARN_CLEAR,
    KNOWN_MAP,
    PAPER_2020,
    CHALLENGE_2022,
    CHALLENGE_2022_03,
) = PROTOCOLS.values()
