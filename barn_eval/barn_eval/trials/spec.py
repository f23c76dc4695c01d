"""One trial: everything that determines it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from barn_eval.trials import identity, seeds
from barn_eval.trials.protocol import Course, Protocol
from barn_eval.trials.result import FREE, format_trial_id
from barn_eval.trials.system import SUITE, System
from barn_eval.trials.trajectory import compute_clearances
from barn_sim.config import PRESETS, SimulatorConfig, with_robot
from barn_sim.seeds import phase_s
from barn_worlds.base.arrays import Floats
from barn_worlds.base.compute import NO_COMPUTE, Compute
from barn_worlds.base.config import as_dict, replace_dotted
from barn_worlds.base.errors import ConfigError, suggest
from barn_worlds.base.types import OccupancyMap, Pose2D
from barn_worlds.geometry.footprint import Footprint
from barn_worlds.geometry.shortest import shortest_path_bound_m
from barn_worlds.robots.contact import contact_footprint
from barn_worlds.robots.robot import Chassis, Robot
from barn_worlds.worlds.cells import STANDARD_CELL_M
from barn_worlds.worlds.world import World

# By how much of the commanded speed base_link may go faster on average: the wheels of a
# skid-steered robot slide where it turns, and its weight shifts to the outer ones.
WHEEL_SLIP = {"skid_steer": 0.02, "differential": 0.005}

# How far a map extends beyond a start or a goal that lies outside its world.
_MARGIN_M = 1.0


@dataclass(frozen=True, eq=False)
class TrialSpec:
    """What a trial is: equal specifications give equal results, wherever they run."""

    dataset: str
    world_number: int  # in its data set
    world: World
    planner: str
    preset: str
    overrides: Mapping[str, Any]  # planner parameters by dotted name
    protocol: Protocol
    simulator: SimulatorConfig
    run_seed: int
    repetition: int

    # Fingerprint of the configuration; empty for a planner that was started by hand.
    planner_config: str = ""
    # The highest speed that the planner says it commands, 0 if it does not say.
    declared_mps: float = 0.0
    # What the planner declares of its computing, and how that is charged.
    compute: Compute = NO_COMPUTE
    compute_mode: str = FREE
    # Registry name of a planner whose results are filed under another name.
    entry: str = ""
    # Delays of a trial that was measured, which are charged again.
    recorded_ns: tuple[int, ...] = ()
    system: System = SUITE

    @property
    def entry_name(self) -> str:
        """Registry name of a registered planner: `entry`, or else its own name."""
        return self.entry or self.planner

    @property
    def trial_id(self) -> str:
        """Name of the trial, its bag and its picture, such as "dwa_w0012_r00"."""
        return format_trial_id(self.planner, self.world_number, self.repetition)

    @property
    def simulator_seed(self) -> int:
        """Seed of the simulator, equal for all planners in the same trial."""
        return seeds.simulator_seed(self.run_seed, self.world_number, self.repetition)

    @property
    def planner_seed(self) -> int:
        """Seed of the planner, different for each name, world and repetition."""
        return seeds.planner_seed(
            self.run_seed, self.world_number, self.repetition, self.planner
        )

    @cached_property
    def phase_s(self) -> float:
        """Seconds into the motions of moving obstacles at which the trial begins."""
        start = self.course.start
        return phase_s(self.world, self.simulator, start, self.simulator_seed)

    @property
    def task(self) -> str:
        """Task fingerprint: a hash of protocol, simulator, robot, system, versions."""
        return _task_fingerprint(self.protocol, self.simulator, self.system)

    @cached_property
    def scaled_protocol(self) -> Protocol:
        """The protocol scaled to cells; its limits rise if a world's own course is long."""
        protocol = self.protocol.scaled_to(self.world, self.simulator.chassis)
        return protocol.extend_to(self.world, self.simulator.drive.max_speed_m_s)

    @property
    def metric(self) -> str:
        """Key of the ranking measure; the protocol's own without a least time."""
        # Without a bound there is no efficiency to rank by.
        if self.least_time_s is None:
            return self.protocol.metric
        return self.scaled_protocol.ranking_metric(
            self.world, self.simulator.drive.max_speed_m_s
        )

    @cached_property
    def course(self) -> Course:
        """Start and goal in the map frame, with path lengths and optimal time."""
        return _course(self.scaled_protocol, self.world)

    @property
    def speed_cap_mps(self) -> float | None:
        """Declared cap in m/s up to the robot's limit, else that; None if unknown.

        It is unknown of a planner that declares none and that the suite neither
        configures nor holds to the robot's limit.
        """
        limit = self.simulator.drive.max_speed_m_s
        if self.declared_mps > 0.0:
            return min(self.declared_mps, limit)
        if self.system.is_observed or not self.planner_config:
            return None
        return limit

    @property
    def outline(self) -> Footprint:
        """Outline, in base_link, of the robot's parts that obstacles can touch."""
        return contact_footprint(self.simulator.chassis)

    def clearances(self, poses: Floats) -> Floats:
        """Return distances (n,) in m to the nearest cylinder, below 0 in an overlap.

        Empty without cylinders. Walls and moving obstacles do not count.

        Args:
            poses: Poses (n, 3) of the robot in the map frame: x, y m, yaw rad.
        """
        world = self.world
        return compute_clearances(
            poses, world.cylinders_m, world.cylinder_radius_m, self.outline
        )

    @cached_property
    def least_time_s(self) -> float | None:
        """Lower bound in s of a success's time on the clock; None if there is none.

        None if speed cap or path are unknown, or the bound does not hold.

        docs/efficiency.md has the proof. From the reading before the one that starts
        the clock to the one that ends the trial, the robot goes from the disc around
        its start in which no clock starts to the disc around the goal in which it has
        arrived, without a contact where that ends the trial. So it drives at least the
        shortest path between the two that a disc inside its outline could take, at no
        more than its speed.
        """
        chassis = self.simulator.chassis
        if self.speed_cap_mps is None or self.course.path_length_m is None:
            return None
        max_speed_mps = self.speed_cap_mps * (1.0 + WHEEL_SLIP[chassis.kind])
        if max_speed_mps <= 0.0:
            return 0.0
        protocol = self.scaled_protocol
        sources = {protocol.clock_start_source, protocol.goal_source}
        # Turning moves a base_link that is not over the axle, at any speed of the
        # wheels, and moving obstacles push it. Wheels of another radius count more
        # odometry than they drive. By two sources, one length is counted twice.
        has_error = self.simulator.odometry.wheel_radius_error and sources != {"truth"}
        is_pushed = self.world.moving and not protocol.collision_ends_trial
        if chassis.axle_x_m or has_error or is_pushed or len(sources) > 1:
            return None
        length_m = _least_path_m(protocol, self.course, self.world, chassis)
        # The clock starts at the first look after the robot has left the disc, so up to
        # a period of the way is not on it.
        return max(0.0, length_m / max_speed_mps - protocol.longest_look_s)

    @cached_property
    def goal(self) -> Pose2D:
        """Goal pose in the map frame if a map is given, else in the odom frame.

        Its yaw is rounded as in a message.
        """
        goal = self.course.goal
        if not self.protocol.map_given:
            goal = self.course.start.inverse() @ goal
        return goal.through_quaternion()

    @cached_property
    def map(self) -> OccupancyMap | None:
        """Occupancy map for the planner, None if the protocol gives none.

        It is rounded as in a message.
        """
        if not self.protocol.map_given:
            return None
        return _planner_map(self.protocol, self.world, self.course)

    def description(self) -> dict[str, Any]:
        """Return all that determines the trial as JSON-ready data, for its bag."""
        planner: dict[str, Any] = {
            "name": self.planner,
            "preset": self.preset,
            "overrides": dict(self.overrides),
            "fingerprint": self.planner_config,
        }
        if self.entry:
            planner["entry"] = self.entry
        if self.compute.is_declared:
            planner["compute"] = as_dict(self.compute)

        description: dict[str, Any] = {
            "trial_id": self.trial_id,
            "dataset": self.dataset,
            "world": {
                "index": self.world_number,
                "name": self.world.name,
                "checksum": self.world.checksum,
            },
            "start": as_dict(self.course.start),
            "goal": as_dict(self.course.goal),
            "task": self.task,
            "planner": planner,
            "protocol": as_dict(self.protocol),
            "simulator": as_dict(self.simulator),
            "seeds": {
                "campaign": self.run_seed,
                "simulator": self.simulator_seed,
                "planner": self.planner_seed,
                "repetition": self.repetition,
            },
        }
        if self.world.moving:
            description["phase_s"] = self.phase_s
        return description


# What trials have in common is worked out once for all of them.


@lru_cache(maxsize=64)
def _task_fingerprint(
    protocol: Protocol, simulator: SimulatorConfig, system: System
) -> str:
    """Return the task fingerprint of trials under protocol and simulator; cached."""
    return identity.fingerprint(identity.task_content(protocol, simulator, system))


_course = lru_cache(maxsize=512)(Protocol.course)


@lru_cache(maxsize=64)
def _least_path_m(
    protocol: Protocol, course: Course, world: World, chassis: Chassis
) -> float:
    """Return a lower bound in m of the path between the discs around start and goal.

    The discs are those in which no clock starts, and in which the robot has arrived.
    """
    start = np.array(course.start.position)
    goal = np.array(course.goal.position)
    centers = np.empty((0, 2))
    radius_m = 0.0

    # Obstacles lengthen the path only where a contact ends the trial, and where the
    # true position, not the odometry, decides when the robot has left and arrived.
    by_truth = protocol.clock_start_source == protocol.goal_source == "truth"
    if protocol.collision_ends_trial and by_truth:
        outline = contact_footprint(chassis)
        inside_m = -float(outline.distances(np.zeros(1), np.zeros(1))[0])
        radius_m = world.cylinder_radius_m + max(0.0, inside_m)

        # A straight line in either disc completes the path to one from start to goal,
        # so no obstacle within a disc may bar it.
        cylinders_m = world.cylinders_m
        from_start = np.hypot(*(cylinders_m - start).T) - radius_m
        from_goal = np.hypot(*(cylinders_m - goal).T) - radius_m
        outside_start = from_start >= protocol.clock_start_distance_m
        outside_goal = from_goal >= protocol.goal_distance_m
        centers = cylinders_m[outside_start & outside_goal]

    length_m = shortest_path_bound_m(start, goal, centers, radius_m)
    length_m = length_m - protocol.clock_start_distance_m - protocol.goal_distance_m
    return max(0.0, length_m)


# Not cached: a planner may change its map, and rivals in its process get one of their own.
def _planner_map(protocol: Protocol, world: World, course: Course) -> OccupancyMap:
    """Return the planner's map, historical if so ruled, padded to start and goal."""
    has_standard_cells = math.isclose(world.resolution_m, STANDARD_CELL_M)
    historical = has_standard_cells and protocol.historical_map
    grid = world.occupancy_map(historical=historical)

    # Worlds of other cells never had a historical map; theirs is off as a whole, by as
    # much as the pose is.
    offset_m = 0.0 if has_standard_cells else protocol.map_offset_m()
    grid = _extend_to(grid, course.start)
    grid = _extend_to(grid, course.goal)

    # A message holds the resolution as a number of 32 bits.
    resolution = float(np.float32(grid.resolution))
    return replace(grid, resolution=resolution, origin_y=grid.origin_y + offset_m)


def _extend_to(grid: OccupancyMap, pose: Pose2D) -> OccupancyMap:
    """Return the map, padded with free cells to 1 m beyond a pose that is off it.

    A map that contains the pose is returned as it is. A planner could not plan from or
    to a pose off its map.
    """
    rows, columns = grid.data.shape
    size = grid.resolution
    row = math.floor((pose.y - grid.origin_y) / size)
    column = math.floor((pose.x - grid.origin_x) / size)
    if 0 <= row < rows and 0 <= column < columns:
        return grid

    margin = math.ceil(_MARGIN_M / size)
    below = max(0, margin - row)
    left = max(0, margin - column)
    above = max(0, row + 1 + margin - rows)
    right = max(0, column + 1 + margin - columns)
    data = np.pad(grid.data, ((below, above), (left, right)))
    origin_x = grid.origin_x - left * size
    origin_y = grid.origin_y - below * size
    return OccupancyMap(data, size, origin_x, origin_y)


def simulator_config(
    protocol: Protocol,
    overrides: Mapping[str, Any] | None = None,
    robot: Robot | None = None,
) -> SimulatorConfig:
    """Return a protocol's preset with overrides; ConfigError for one that it fixes.

    Args:
        protocol: Names the preset, and fixes control period and obstacles. Under one
            with the historical map, the pose is off with the map by one cell of a
            standard world: AMCL matches scans to the map that it is given.
        overrides: Simulator parameters by dotted name, which come last.
        robot: Robot instead of the preset's Jackal; noise and latency stay as in the
            preset.

    Raises:
        ConfigError: The preset or a parameter is unknown, or a value is not allowed, or
            the protocol fixes a parameter that `overrides` has.
    """
    name = protocol.simulator
    if name not in PRESETS:
        raise ConfigError(
            f"protocol {protocol.name}: unknown simulator preset"
            f" {name!r}{suggest(name, PRESETS)}"
        )
    preset = PRESETS[name]
    if robot is not None:
        preset = with_robot(preset, robot)

    changes: dict[str, Any] = {}
    offset_m = protocol.map_offset_m()
    if offset_m and preset.localisation.mode == "particles":
        changes["localisation.historical_map"] = True
    elif offset_m:
        changes["localisation.offset_y_m"] = offset_m

    fixed = {
        "control_period_s": protocol.control_period_s,
        "obstacles.movable": protocol.movable_obstacles,
        "obstacles.random_phase": protocol.random_phase,
        "obstacles.clear_start_s": protocol.clear_start_s,
    }
    overrides = overrides or {}
    for parameter in sorted(fixed.keys() & overrides.keys()):
        raise ConfigError(
            f"simulator parameter {parameter!r} is set by protocol {protocol.name}"
        )
    changes = changes | fixed | dict(overrides)
    return replace_dotted(preset, changes, "simulator parameters")
