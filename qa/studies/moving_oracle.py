"""What a planner that knows all motions reaches among moving obstacles.

    python qa/studies/moving_oracle.py drive dynabarn60 --worlds 0:60:2 --speed 2.0
    python qa/studies/moving_oracle.py drive dynabarn60 --driver waiting
    python qa/studies/moving_oracle.py starts dynabarn60

`drive` drives in the simulator, knowing all tracks. The driver `planning` searches ways
in space and time: a ceiling for planners that only see a scan. `waiting` stands until
the straight line to the goal is free, which shows what waiting earns. `parking` stops
where an obstacle will come. `starts` names worlds in which a robot that has not moved
is run over.
"""

import math
from dataclasses import replace

import click
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy import ndimage

from barn_eval.analysis.measures import MEASURES
from barn_eval.analysis.summary import summarize
from barn_eval.running.direct import run_direct_trial
from barn_eval.trials.protocol import load_protocol
from barn_eval.trials.result import TrialResult
from barn_eval.trials.run_config import PlannerChoice, RunConfig
from barn_eval.trials.spec import TrialSpec, simulator_config
from barn_planners.interface import Decision, Observation, Planner, Task
from barn_sim.seeds import time_until_hit
from barn_worlds.base.arrays import BoolGrid, Floats
from barn_worlds.base.types import NANOSECONDS_PER_SECOND, Pose2D, Velocity2D
from barn_worlds.datasets.dataset import open_dataset, select_worlds
from barn_worlds.geometry.bodies import wall_bodies

# Around the circle around the robot: the next one where the one before leaves no way.
MARGINS_M = (0.2, 0.1, 0.0)
# A way in space and time goes on by layers. In one the robot reaches the cells within
# `_REACH_CELLS`.
LAYER_S = 0.2
_REACH_CELLS = 2
LONGEST_S = 60.0
# The plan is made anew so often, and the robot aims this far ahead in it.
REPLANNING_S = 0.5
LOOKAHEAD_S = 0.4
# Share of the speed that plans count on: what is left brings the robot back to them.
SPEED_SHARE = 0.9
MAX_YAW_RATE_RADPS = 2.0
# Less than a protocol's limit of the first motion.
LONGEST_WAIT_S = 28.0
# A robot parks where an obstacle comes so many layers later: not at once, but soon.
PARKING_LAYERS = (10, 50)
# As in dynabarn60.
WORLDS_OF_A_CLASS = 20
# Phases of each world that `starts` looks at.
PHASES = 100


class SpaceTime:
    """Where and when the center of the robot may be, in cells and layers."""

    def __init__(self, spec: TrialSpec, speed_mps: float) -> None:
        """Compute the free cells of all layers of a trial.

        Args:
            spec: The trial, whose phase is known here.
            speed_mps: Speed that plans count on.
        """
        world = spec.world
        self.cell_m = speed_mps * LAYER_S / _REACH_CELLS
        left, bottom, right, top = world.bounds_m
        self._corner = np.array([left, bottom])
        x = np.arange(left, right, self.cell_m) + self.cell_m / 2.0
        y = np.arange(bottom, top, self.cell_m) + self.cell_m / 2.0
        self._x, self._y = np.meshgrid(x, y, indexing="ij")
        self._goal = spec.course.goal
        # Half a meter before what counts as arrival.
        self._arrival_m = max(spec.protocol.goal_distance_m - 0.5, self.cell_m)
        self._spec = spec

        outline = spec.outline
        corner_m = float(np.hypot(*outline.corners_m.T).max())
        self._circle_m = corner_m + outline.radius_m
        self._standing = {margin: self._standing_cells(margin) for margin in MARGINS_M}
        self._occupied: dict[tuple[int, float], BoolGrid] = {}

    def _standing_cells(self, margin_m: float) -> BoolGrid:
        """Return the cells that walls and cylinders leave no room in."""
        radius_m = self._circle_m + margin_m
        x, y = self._x, self._y
        occupied = np.zeros(x.shape, np.bool_)
        for shape in wall_bodies(self._spec.world.walls).shapes():
            along = np.abs((x - shape[0]) * shape[5] + (y - shape[1]) * shape[6])
            across = np.abs((y - shape[1]) * shape[5] - (x - shape[0]) * shape[6])
            gap = np.hypot(
                np.maximum(along - shape[3], 0.0), np.maximum(across - shape[4], 0.0)
            )
            occupied |= gap < radius_m
        reach_m = radius_m + self._spec.world.cylinder_radius_m
        for center in self._spec.world.cylinders_m:
            occupied |= np.hypot(x - center[0], y - center[1]) < reach_m
        return occupied

    def occupied(self, layer: int, margin_m: float) -> BoolGrid:
        """Return the cells that are occupied from a layer to the next one."""
        key = (layer, margin_m)
        if key not in self._occupied:
            occupied = self._standing[margin_m].copy()
            radius_m = self._circle_m + margin_m
            tracks = self._spec.world.tracks
            # A box counts as the circle around it.
            radii = np.hypot(*(tracks.size_m.T / 2.0)) + tracks.radius_m
            begin_s = self._spec.phase_s + layer * LAYER_S
            positions, _ = tracks.over(begin_s + np.array([0.0, 0.5, 1.0]) * LAYER_S)
            for places in positions:
                for (px, py), radius in zip(places, radii, strict=True):
                    dx = self._x - px
                    dy = self._y - py
                    occupied |= dx * dx + dy * dy < (radius_m + radius) ** 2
            self._occupied[key] = occupied
        return self._occupied[key]

    def is_occupied(self, position: Floats, layer: int) -> bool:
        """Return whether there is no room at x and y (2,) in m until the next layer."""
        row, col = ((position - self._corner) / self.cell_m).astype(int)
        return bool(self.occupied(layer, MARGINS_M[1])[row, col])

    def plan(self, position: Floats, time_s: float) -> Floats:
        """Return places (n, 2) in m at layers from now on, the fastest way to the goal.

        Without a way to the goal it is the one that lasts longest.

        Args:
            position: x and y (2,) of the robot in the map frame, in m.
            time_s: Time since the start of the trial.
        """
        first = round(time_s / LAYER_S)
        size = self._x.shape
        cell = np.floor((position - self._corner) / self.cell_m).astype(int)
        cell = np.clip(cell, 0, np.array(size) - 1)
        reached = np.zeros(size, np.bool_)
        reached[tuple(cell)] = True
        distance = np.hypot(self._x - self._goal.x, self._y - self._goal.y)
        arrived = distance < self._arrival_m

        for margin_m in MARGINS_M:
            layers = self._spread(reached, arrived, first, margin_m)
            if (layers[-1] & arrived).any():
                break

        # Backwards from the cell nearest to the goal.
        distance[~layers[-1]] = np.inf
        here = np.array(np.unravel_index(distance.argmin(), size))
        cells = [here]
        step = np.zeros(2)
        for cells_before in reversed(layers[:-1]):
            before = np.argwhere(cells_before)
            steps = here - before
            is_near = np.hypot(*steps.T) <= _REACH_CELLS
            # The robot turns slowly, so that one is best whose step changes least.
            best = np.hypot(*(steps[is_near] - step).T).argmin()
            step = steps[is_near][best]
            here = before[is_near][best]
            cells.append(here)
        places: Floats = self._corner + (np.array(cells[::-1]) + 0.5) * self.cell_m
        return places

    def _spread(
        self, reached: BoolGrid, arrived: BoolGrid, first: int, margin_m: float
    ) -> list[BoolGrid]:
        """Return the cells that are reached by layer, to the goal or the last way."""
        disc = np.hypot(*np.mgrid[-2:3, -2:3]) <= _REACH_CELLS
        layers = [reached]
        for layer in range(int(LONGEST_S / LAYER_S)):
            spread = ndimage.binary_dilation(layers[-1], disc)
            spread &= ~self.occupied(first + layer, margin_m)
            if not spread.any():
                break
            layers.append(spread)
            if (spread & arrived).any():
                break
        return layers


class Oracle(Planner):
    """Drives the ways that `SpaceTime` finds."""

    def __init__(self, spec: TrialSpec, speed_mps: float) -> None:
        """Prepare for one trial, whose obstacles it knows."""
        self._speed_mps = speed_mps
        self._start = spec.course.start
        self._space_time = SpaceTime(spec, SPEED_SHARE * speed_mps)
        self._plan = np.zeros((1, 2))
        self._planned_s = -math.inf

    def start(self, task: Task, seed: int) -> None:  # noqa: ARG002 (it knows the goal)
        """Forget the last plan; the goal is known."""
        self._planned_s = -math.inf

    def step(self, observation: Observation) -> Decision:
        """Drive to where the robot should be in a moment."""
        now_s = observation.stamp_ns / NANOSECONDS_PER_SECOND
        pose = self._start @ observation.pose
        if now_s - self._planned_s >= REPLANNING_S:
            position = np.array(pose.position)
            self._plan = self._space_time.plan(position, now_s)
            self._planned_s = now_s

        # Between two layers the robot goes straight.
        ahead = (now_s - self._planned_s + LOOKAHEAD_S) / LAYER_S
        layers = np.arange(len(self._plan))
        target_x = float(np.interp(ahead, layers, self._plan[:, 0]))
        target_y = float(np.interp(ahead, layers, self._plan[:, 1]))
        local = pose.inverse() @ Pose2D(target_x, target_y, 0.0)
        distance_m = math.hypot(*local.position)
        if distance_m < 0.5 * self._space_time.cell_m:
            return Decision(Velocity2D(0.0, 0.0))

        # Backwards if the place lies behind.
        direction = 1.0 if local.x >= 0.0 else -1.0
        bearing = math.atan2(direction * local.y, direction * local.x)
        yaw_rate = min(max(5.0 * bearing, -MAX_YAW_RATE_RADPS), MAX_YAW_RATE_RADPS)
        speed = min(distance_m / LOOKAHEAD_S, self._speed_mps) * math.cos(bearing) ** 2
        return Decision(Velocity2D(direction * speed, yaw_rate))


class WaitingOracle(Oracle):
    """Stands until the straight line to the goal is free, then drives along it."""

    def __init__(self, spec: TrialSpec, speed_mps: float) -> None:
        """Find the first time from which on the straight line is free."""
        super().__init__(spec, speed_mps)
        self._goal = spec.course.goal
        self._speed_mps *= SPEED_SHARE
        drive_s = self._start.distance(self._goal) / self._speed_mps
        self._line = np.linspace(
            self._start.position,
            self._goal.position,
            math.ceil(drive_s / LAYER_S),
        )
        self._first_layer = 0
        while self._first_layer * LAYER_S < LONGEST_WAIT_S and self._is_blocked():
            self._first_layer += 1

    def _is_blocked(self) -> bool:
        """Return whether an obstacle meets a drive that begins at the first layer."""
        return any(
            self._space_time.is_occupied(position, self._first_layer + k)
            for k, position in enumerate(self._line)
        )

    def step(self, observation: Observation) -> Decision:
        """Stand, then drive straight at the goal."""
        if observation.stamp_ns < self._first_layer * LAYER_S * NANOSECONDS_PER_SECOND:
            return Decision(Velocity2D(0.0, 0.0))
        local = (self._start @ observation.pose).inverse() @ self._goal
        return Decision(Velocity2D(self._speed_mps, math.atan2(local.y, local.x)))


class ParkingOracle(Oracle):
    """Drives as planned, but stops for good where an obstacle will come."""

    _is_parked = False

    def step(self, observation: Observation) -> Decision:
        """Drive on unless the robot is parked or can park here."""
        pose = self._start @ observation.pose
        layer = round(observation.stamp_ns / NANOSECONDS_PER_SECOND / LAYER_S)
        # Far enough from the start that the clock runs.
        if layer > PARKING_LAYERS[0] and not self._is_parked:
            self._is_parked = any(
                self._space_time.is_occupied(np.array(pose.position), layer + k)
                for k in range(*PARKING_LAYERS)
            )
        if self._is_parked:
            return Decision(Velocity2D(0.0, 0.0))
        return super().step(observation)


SHOWN = ("success", "challenge", "not_at_fault", "hit_at_rest", "waited_s")
DRIVERS = {"planning": Oracle, "waiting": WaitingOracle, "parking": ParkingOracle}


def configure(dataset: str, worlds: str, protocol: str) -> RunConfig:
    """Return the configuration of a run, of which a study takes the trials."""
    rules = load_protocol(protocol)
    return RunConfig(
        dataset=dataset,
        worlds=worlds,
        planners=(PlannerChoice("gap"),),
        protocol=rules,
        simulator=simulator_config(rules),
    )


@click.group()
def main() -> None:
    """Tell what is possible among moving obstacles, and what is not."""


@main.command()
@click.argument("dataset")
@click.option("--worlds", default="all", show_default=True, help="Which of its worlds.")
@click.option("--driver", type=click.Choice(list(DRIVERS)), default="planning")
@click.option("--speed", default=2.0, show_default=True, help="Speed in m/s.")
@click.option("--protocol", default="dynabarn", show_default=True, help="Its rules.")
@click.option("--repetitions", default=1, show_default=True, help="Phases of a world.")
@click.option("--seed", default=1, show_default=True, help="As of `barn run`.")
def drive(
    dataset: str,
    worlds: str,
    driver: str,
    speed: float,
    protocol: str,
    repetitions: int,
    seed: int,
) -> None:
    """Drive the oracle in trials as `barn run` has them, by 20 worlds of a class."""
    config = configure(dataset, worlds, protocol)
    config = replace(config, repetitions=repetitions, seed=seed)
    results: dict[int, list[TrialResult]] = {}
    for trial in config.trials():
        spec = replace(trial, planner="oracle", declared_mps=speed)
        result = run_direct_trial(spec, planner=DRIVERS[driver](spec, speed)).result
        results.setdefault(spec.world_number // WORLDS_OF_A_CLASS, []).append(result)
        click.echo(f"{spec.trial_id}: {result.outcome.value}", err=True)

    table = Table("worlds", "trials", *(MEASURES[key].label for key in SHOWN))
    for group, rows in sorted(results.items()):
        summary = summarize(rows, SHOWN)
        first = WORLDS_OF_A_CLASS * group
        table.add_row(
            f"{first} to {first + WORLDS_OF_A_CLASS - 1}",
            str(len(rows)),
            *(MEASURES[key].text(summary[key]) for key in SHOWN),
        )
    Console().print(table)


@main.command()
@click.argument("dataset")
@click.option("--worlds", default="all", show_default=True, help="Which of its worlds.")
@click.option(
    "--limit", default=30.0, show_default=True, help="Time in s at the start."
)
def starts(dataset: str, worlds: str, limit: float) -> None:
    """Name the worlds in which a robot that has not moved is run over."""
    data = open_dataset(dataset)
    config = configure(dataset, worlds, "dynabarn")
    for number in select_worlds(worlds, data.world_numbers):
        (spec,) = config.trials([number])
        longest_s = max(item.motion.period_s for item in spec.world.moving)
        start = spec.course.start
        phases = np.linspace(0.0, longest_s, PHASES, endpoint=False).tolist()
        hits = [
            time_until_hit(spec.world, spec.outline, start, phase, limit)
            for phase in phases
        ]
        share = np.isfinite(hits).mean()
        if share > 0.0:
            click.echo(f"world {number}: in {100.0 * share:.0f}% of the phases")


if __name__ == "__main__":
    main()
