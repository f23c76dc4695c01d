"""One trial: everything that determines it, and what is left when it has ended."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from barn_eval.trials import identity, seeds
from barn_eval.trials.encounters import encounters
from barn_eval.trials.outcome import Verdict
from barn_eval.trials.protocol import Course, Protocol
from barn_eval.trials.result import TrialResult, WallClock, trial_id
from barn_eval.trials.scores import score
from barn_eval.trials.trajectory import Floats, Trajectory, measure
from barn_sim.body.phase import phase_s
from barn_sim.config import PRESETS, SimulatorConfig, with_robot
from barn_worlds.base.config import as_dict, replace_dotted
from barn_worlds.base.errors import ConfigError, suggest
from barn_worlds.base.twin import twin
from barn_worlds.base.types import OccupancyMap, Pose2D
from barn_worlds.geometry.footprint import contact_of
from barn_worlds.messages.topics import FRAMES
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.cells import STANDARD_CELL_M
from barn_worlds.worlds.world import World


@dataclass(frozen=True, eq=False)
class TrialSpec:
    """What a trial is: equal specifications give equal results, wherever and whenever they run.

    index: number of the world in its data set. overrides: dotted names of planner parameters to values. planner_config:
    fingerprint of the planner's configuration.
    """

    dataset: str
    index: int
    world: World
    planner: str
    preset: str
    overrides: Mapping[str, Any]
    protocol: Protocol
    simulator: SimulatorConfig
    campaign_seed: int
    repetition: int
    planner_config: str = ""

    @cached_property
    def task(self) -> str:
        """Fingerprint of protocol, simulator and robot."""
        return identity.fingerprint(identity.task(self.protocol, self.simulator))

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
        return seeds.planner_seed(self.campaign_seed, self.index, self.repetition, self.planner)

    @cached_property
    def course(self) -> Course:
        """Start, goal and lengths of the world under the protocol."""
        return self.rules.course(self.world)

    @cached_property
    def rules(self) -> Protocol:
        """The protocol with its distances in the size of the world, for a robot other than the Jackal."""
        return self.protocol.sized(self.world, self.simulator.chassis)

    @cached_property
    def phase_s(self) -> float:
        """How far into their motions moving obstacles are at the start."""
        return phase_s(self.world, self.simulator.obstacles.random_phase, self.simulator_seed)

    @property
    def planning_frame(self) -> str:
        """Frame in which the planner gets its goal and its pose: map if it is given one, else odom."""
        return FRAMES.map if self.protocol.map_given else FRAMES.odom

    @property
    def goal(self) -> Pose2D:
        """The goal in the planning frame, as it comes out of a message."""
        course = self.course
        goal = course.goal if self.protocol.map_given else course.start.inverse() @ course.goal
        return goal.through_quaternion()

    @cached_property
    def map(self) -> OccupancyMap | None:
        """The map that the planner is given, if any, as it comes out of a message."""
        if not self.protocol.map_given:
            return None
        standard = math.isclose(self.world.resolution_m, STANDARD_CELL_M)
        grid = self.world.occupancy_map(historical=standard and self.protocol.historical_map)
        # Worlds of other cells never had such a map; theirs is off as a whole, by as much as the pose is.
        off_m = 0.0 if standard else self.protocol.map_offset_m()
        return replace(grid, resolution=float(np.float32(grid.resolution)), origin_y=grid.origin_y + off_m)

    def again(self, campaign_seed: int, repetition: int) -> "TrialSpec":
        """Return the same trial with other noise; what does not depend on it is not worked out again."""
        other = twin(self)
        other.__dict__.update(campaign_seed=campaign_seed, repetition=repetition)
        other.__dict__.pop("phase_s", None)
        return other

    def description(self) -> dict[str, Any]:
        """Return everything that determines the trial as plain data, all configuration resolved."""
        course = self.course
        phase = {"phase_s": self.phase_s} if self.world.moving else {}
        return {
            "trial_id": self.trial_id,
            "dataset": self.dataset,
            "world": {"index": self.index, "name": self.world.name, "checksum": self.world.checksum},
            "start": as_dict(course.start),
            "goal": as_dict(course.goal),
            "task": self.task,
            "planner": {
                "name": self.planner,
                "preset": self.preset,
                "overrides": dict(self.overrides),
                "fingerprint": self.planner_config,
            },
            "protocol": as_dict(self.protocol),
            "simulator": as_dict(self.simulator),
            "seeds": {
                "campaign": self.campaign_seed,
                "simulator": self.simulator_seed,
                "planner": self.planner_seed,
                "repetition": self.repetition,
            },
            **phase,
        }


@dataclass(frozen=True, eq=False)
class FinishedTrial:
    """A trial that has ended: what was asked for, the result, and what the robot did.

    cylinders_m: (k, 2) where the world's cylinders stood at the end, None where it is not known.
    """

    spec: TrialSpec
    result: TrialResult
    trajectory: Trajectory
    cylinders_m: Floats | None = None


def simulator_config(
    protocol: Protocol, overrides: Mapping[str, Any] | None = None, robot: Robot | None = None
) -> SimulatorConfig:
    """Return the simulator's configuration under a protocol: its preset, what the protocol fixes, then overrides.

    robot: in place of the preset's, which is the Jackal; the preset keeps what it says of noise and latency.

    Under a protocol with the historical map the pose is off with the map, by one cell of a standard world: AMCL matches
    scans to the map that it is given.
    """
    if protocol.simulator not in PRESETS:
        raise ConfigError(
            f"protocol {protocol.name}: unknown simulator preset {protocol.simulator!r}"
            f"{suggest(protocol.simulator, PRESETS)}"
        )
    fixed = {
        "control_period_s": protocol.control_period_s,
        "obstacles.movable": protocol.movable_obstacles,
        "obstacles.random_phase": protocol.random_phase,
    }
    for name in sorted(set(fixed) & set(overrides or {})):
        raise ConfigError(f"simulator parameter {name!r} is given by protocol {protocol.name}")
    preset, off_m = PRESETS[protocol.simulator], protocol.map_offset_m()
    preset = preset if robot is None else with_robot(preset, robot)
    matched: dict[str, Any] = {}
    if off_m and preset.localisation.mode == "particles":
        matched = {"localisation.historical_map": True}
    elif off_m:
        matched = {"localisation.offset_y_m": off_m}
    return replace_dotted(preset, {**matched, **fixed, **(overrides or {})}, "simulator parameters")


def conclude(
    spec: TrialSpec,
    mode: str,
    verdict: Verdict,
    trajectory: Trajectory,
    *,
    wall_clock: WallClock | None = None,
    recoveries: int | None = None,
    planner_verdict: str | None = None,
    cylinders_m: Floats | None = None,
    remarks: str = "",
) -> FinishedTrial:
    """Return the finished trial with its scores and measures; mode is "direct" or "ros"."""
    world, scores = spec.world, score(verdict, spec.course, spec.protocol)
    traversal_s = scores.traversal_time_s if scores.success else None
    outline = contact_of(spec.simulator.chassis)
    result = TrialResult(
        trial_id=spec.trial_id,
        dataset=spec.dataset,
        world=spec.index,
        world_name=world.name,
        world_checksum=world.checksum,
        planner=spec.planner,
        preset=spec.preset,
        protocol=spec.protocol.name,
        mode=mode,
        repetition=spec.repetition,
        campaign_seed=spec.campaign_seed,
        simulator_seed=spec.simulator_seed,
        planner_seed=spec.planner_seed,
        outcome=verdict.outcome,
        detail=verdict.detail,
        scores=scores,
        measures=measure(trajectory, world.cylinders_m, world.cylinder_radius_m, outline),
        recoveries=recoveries,
        planner_verdict=planner_verdict,
        task=spec.task,
        planner_config=spec.planner_config,
        metric=spec.protocol.metric,
        fault=verdict.fault,
        remarks=remarks,
        motion=encounters(trajectory, world, spec.phase_s, outline, spec.course, spec.rules, traversal_s),
        wall_clock=wall_clock or WallClock(),
    )
    return FinishedTrial(spec, result, trajectory, cylinders_m)
