"""One trial: everything that determines it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from barn_eval.trials import identity, seeds
from barn_eval.trials.protocol import Course, Protocol
from barn_eval.trials.result import FREE, trial_id
from barn_sim.config import PRESETS, SimulatorConfig, with_robot
from barn_sim.seeds import phase_s
from barn_worlds.base.compute import NO_COMPUTE, Compute
from barn_worlds.base.config import as_dict, replace_dotted
from barn_worlds.base.errors import ConfigError, suggest
from barn_worlds.base.types import OccupancyMap, Pose2D
from barn_worlds.geometry.shortest import shortest_path_bound_m
from barn_worlds.messages.topics import FRAMES
from barn_worlds.robots.contact import contact_footprint
from barn_worlds.robots.robot import Chassis, Robot
from barn_worlds.worlds.cells import STANDARD_CELL_M
from barn_worlds.worlds.world import World


@dataclass(frozen=True, eq=False)
class TrialSpec:
    """What a trial is: equal specifications give equal results, wherever and whenever they run."""

    dataset: str
    index: int  # number of the world in its data set
    world: World
    planner: str
    preset: str
    overrides: Mapping[str, Any]  # dotted names of planner parameters to values
    protocol: Protocol
    simulator: SimulatorConfig
    campaign_seed: int
    repetition: int
    planner_config: str = ""  # fingerprint of the planner's configuration
    declared_mps: float = (
        0.0  # the highest speed that the planner says it commands, 0 if it does not say
    )
    compute: Compute = NO_COMPUTE  # what it declares of its computing
    way: str = FREE  # what is charged for that, as in `TrialResult`
    recorded_ns: tuple[
        int, ...
    ] = ()  # delays of a trial that was measured, which are charged again

    @property
    def trial_id(self) -> str:
        """Name of the trial, its bag and its picture."""
        return trial_id(self.planner, self.index, self.repetition)

    @property
    def simulator_seed(self) -> int:
        """Seed of the simulator."""
        return seeds.simulator_seed(self.campaign_seed, self.index, self.repetition)

    @property
    def planner_seed(self) -> int:
        """Seed of the planner."""
        return seeds.planner_seed(
            self.campaign_seed, self.index, self.repetition, self.planner
        )

    @property
    def phase_s(self) -> float:
        """How far into their motions moving obstacles are at the start."""
        return phase_s(
            self.world, self.simulator.obstacles.random_phase, self.simulator_seed
        )

    @property
    def planning_frame(self) -> str:
        """Frame in which the planner gets its goal and its pose: map if it is given one, else odom."""
        return FRAMES.map if self.protocol.map_given else FRAMES.odom

    @property
    def task(self) -> str:
        """Fingerprint of protocol, simulator and robot."""
        return _task(self.protocol, self.simulator)

    @cached_property
    def rules(self) -> Protocol:
        """The protocol with its distances in the size of the world, for a robot other than the Jackal."""
        return self.protocol.sized(self.world, self.simulator.chassis)

    @cached_property
    def course(self) -> Course:
        """Start, goal and lengths of the world under the protocol."""
        return _course(self.rules, self.world)

    @property
    def speed_cap_mps(self) -> float:
        """The highest speed that the robot takes from the planner: as declared, at most its own."""
        limit = self.simulator.drive.max_speed_m_s
        return min(self.declared_mps, limit) if self.declared_mps > 0.0 else limit

    @cached_property
    def least_time_s(self) -> float:
        """A time on the clock that no trial of this robot at this speed cap falls below.

        docs/efficiency.md has the proof. From the reading before the one that starts the clock to the one that ends the
        trial, the robot goes from the disc around its start in which no clock starts to the disc around the goal in
        which it has arrived, without a contact where that ends the trial. So it drives at least the shortest way
        between the two that a disc inside its outline could take, at no more than its speed.
        """
        fastest = self.speed_cap_mps * (1.0 + SLIP[self.simulator.chassis.kind])
        length_m = _least_way_m(
            self.rules, self.course, self.world, self.simulator.chassis
        )
        return (
            max(0.0, length_m / fastest - self.rules.control_period_s)
            if fastest > 0.0
            else 0.0
        )

    @cached_property
    def goal(self) -> Pose2D:
        """The goal in the planning frame, as it comes out of a message."""
        goal = (
            self.course.goal
            if self.protocol.map_given
            else self.course.start.inverse() @ self.course.goal
        )
        return goal.through_quaternion()

    @cached_property
    def map(self) -> OccupancyMap | None:
        """The map that the planner is given, if any, as it comes out of a message."""
        return (
            _map(self.protocol, self.world, self.course)
            if self.protocol.map_given
            else None
        )

    def reseeded(self, campaign_seed: int, repetition: int) -> "TrialSpec":
        """Return the trial with another seed; what does not depend on it need not be worked out again."""
        other = object.__new__(TrialSpec)  # `replace` would lose what is cached
        vars(other).update(
            vars(self), campaign_seed=campaign_seed, repetition=repetition
        )
        return other

    def description(self) -> dict[str, Any]:
        """Return everything that determines the trial as plain data, all configuration resolved."""
        phase = {"phase_s": self.phase_s} if self.world.moving else {}
        computing = (
            {"compute": as_dict(self.compute)} if self.compute.is_declared else {}
        )
        return {
            "trial_id": self.trial_id,
            "dataset": self.dataset,
            "world": {
                "index": self.index,
                "name": self.world.name,
                "checksum": self.world.checksum,
            },
            "start": as_dict(self.course.start),
            "goal": as_dict(self.course.goal),
            "task": self.task,
            "planner": {
                "name": self.planner,
                "preset": self.preset,
                "overrides": dict(self.overrides),
            }
            | {"fingerprint": self.planner_config, **computing},
            "protocol": as_dict(self.protocol),
            "simulator": as_dict(self.simulator),
            "seeds": {
                "campaign": self.campaign_seed,
                "simulator": self.simulator_seed,
                "planner": self.planner_seed,
            }
            | {"repetition": self.repetition},
            **phase,
        }


# What trials have in common is worked out once.

# By how much of the commanded speed base_link may go faster on average: the wheels of a skid-steered robot slide where
# it turns, and its weight shifts to the outer ones.
SLIP = {"skid_steer": 0.02, "differential": 0.005}
_BEYOND_M = (
    1.0  # which a map goes on beyond a start or a goal that its world does not hold
)


@lru_cache(maxsize=64)
def _task(protocol: Protocol, simulator: SimulatorConfig) -> str:
    return identity.fingerprint(identity.task(protocol, simulator))


@lru_cache(maxsize=512)
def _course(rules: Protocol, world: World) -> Course:
    return rules.course(world)


@lru_cache(maxsize=64)
def _least_way_m(
    rules: Protocol, course: Course, world: World, chassis: Chassis
) -> float:
    """Return a lower bound of the way in m from the one disc to the other."""
    near_m, goal_m = rules.clock_start_distance_m, rules.goal_distance_m
    start, goal = (np.array([pose.x, pose.y]) for pose in (course.start, course.goal))
    centres, radius_m = np.empty((0, 2)), 0.0
    if (
        rules.collision_ends_trial
        and rules.clock_start_source == rules.goal_source == "truth"
    ):
        inside_m = -float(
            contact_footprint(chassis).distances(np.zeros(1), np.zeros(1))[0]
        )
        radius_m = world.cylinder_radius_m + max(0.0, inside_m)
        # a straight line in either disc completes the way to one from start to goal, which must not be barred
        from_start, from_goal = (
            np.hypot(*(world.cylinders_m - point).T) - radius_m
            for point in (start, goal)
        )
        centres = world.cylinders_m[(from_start >= near_m) & (from_goal >= goal_m)]
    return max(
        0.0, shortest_path_bound_m(start, goal, centres, radius_m) - near_m - goal_m
    )


@lru_cache(maxsize=64)
def _map(protocol: Protocol, world: World, course: Course) -> OccupancyMap:
    standard = math.isclose(world.resolution_m, STANDARD_CELL_M)
    grid = world.occupancy_map(historical=standard and protocol.historical_map)
    # Worlds of other cells never had such a map; theirs is off as a whole, by as much as the pose is.
    off_m = 0.0 if standard else protocol.map_offset_m()
    grid = _reaching(_reaching(grid, course.start), course.goal)
    return replace(
        grid,
        resolution=float(np.float32(grid.resolution)),
        origin_y=grid.origin_y + off_m,
    )


def _reaching(grid: OccupancyMap, pose: Pose2D) -> OccupancyMap:
    """Return a map with free cells up to a metre beyond a pose that is off it: a planner could not plan there."""
    (rows, cols), size = grid.data.shape, grid.resolution
    row, col = (
        math.floor((pose.y - grid.origin_y) / size),
        math.floor((pose.x - grid.origin_x) / size),
    )
    if 0 <= row < rows and 0 <= col < cols:
        return grid
    beyond = math.ceil(_BEYOND_M / size)
    below, left = max(0, beyond - row), max(0, beyond - col)
    above, right = max(0, row + 1 + beyond - rows), max(0, col + 1 + beyond - cols)
    data = np.pad(grid.data, ((below, above), (left, right)))
    return OccupancyMap(
        data, size, grid.origin_x - left * size, grid.origin_y - below * size
    )


def simulator_config(
    protocol: Protocol,
    overrides: Mapping[str, Any] | None = None,
    robot: Robot | None = None,
) -> SimulatorConfig:
    """Return the simulator's configuration under a protocol: its preset, what the protocol fixes, then overrides.

    robot: in place of the preset's, which is the Jackal; the preset keeps what it says of noise and latency.

    Under a protocol with the historical map the pose is off with the map, by one cell of a standard world: AMCL matches
    scans to the map that it is given.
    """
    if (name := protocol.simulator) not in PRESETS:
        raise ConfigError(
            f"protocol {protocol.name}: unknown simulator preset {name!r}{suggest(name, PRESETS)}"
        )
    fixed = {
        "control_period_s": protocol.control_period_s,
        "obstacles.movable": protocol.movable_obstacles,
        "obstacles.random_phase": protocol.random_phase,
    }
    for name in sorted(set(fixed) & set(overrides or {})):
        raise ConfigError(
            f"simulator parameter {name!r} is given by protocol {protocol.name}"
        )
    preset, off_m = PRESETS[protocol.simulator], protocol.map_offset_m()
    preset = preset if robot is None else with_robot(preset, robot)
    particles = preset.localisation.mode == "particles"
    shift: dict[str, Any] = (
        {"historical_map": True} if particles else {"offset_y_m": off_m}
    )
    matched = (
        {f"localisation.{name}": value for name, value in shift.items()}
        if off_m
        else {}
    )
    return replace_dotted(
        preset, {**matched, **fixed, **(overrides or {})}, "simulator parameters"
    )
