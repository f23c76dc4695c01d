"""Replay the recordings of the original ROS 1 planners with this package's planners.

What they saw, planned and commanded is compared cycle by cycle.

    python qa/fidelity/replay_originals.py ../shared/originals/eband_*.npz
    python qa/fidelity/replay_originals.py ../shared/originals/dwa_1_fine.npz --depth
    observations --partings 20

A recording has the observations of one drive, and what the original made of each:
costmaps, plan, band and command. Three depths say where a difference comes from:
`controller` gives our planner the original's plan and costmaps, `plan` its costmaps
alone, `observations` neither. At the first two depths a difference does not last: each
cycle has the original's inputs. The table counts the driving cycles, in which the
original's local planner sent a command, and the share of them in which ours equals it;
with `--partings` follow the first cycles in which something differs, and what.
"""

import ast
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import click
import numpy as np
import numpy.typing as npt
import yaml

from barn_planners.costmap.costmap import Costmap, RollingCostmap
from barn_planners.global_plan.planner import GlobalPlan, GlobalPlanner
from barn_planners.interface import FloatArray, Observation, Task
from barn_planners.navigation.loop import NavigationConfig, NavigationPlanner
from barn_planners.registry import planner_config, planner_entry
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.types import (
    STOP,
    OccupancyMap,
    Odometry,
    Pose2D,
    Scan,
    Velocity2D,
)

DEPTHS = ("controller", "plan", "observations")
# tolerances in m/s and rad/s
TIGHT = (0.005, 0.01)
LOOSE = (0.02, 0.05)
PRESET = "paper2020"
_PLACE_M = 1e-4
_ROUNDED_M = 1e-6  # recordings keep places in single precision


class Recording:
    """One drive of an original planner.

    `planner` names it, `cycles` counts its control cycles.
    """

    def __init__(self, path: Path):
        with np.load(path, allow_pickle=False) as file:
            self._arrays = {name: file[name] for name in file.files}
        self.name = path.stem
        self.planner = path.stem.partition("_")[0]
        self.cycles = len(self._arrays["stamp_ns"])

    def costs(self, name: str) -> npt.NDArray[np.uint8]:
        """Return the costs (cycles, rows, columns) of costmap `local` or `global`."""
        costs: npt.NDArray[np.uint8] = self._arrays[name].astype(np.uint8, copy=False)
        return costs

    def origins(self, name: str) -> FloatArray:
        """Return the outer corners (cycles, 2) of a costmap's cell 0, 0 in m."""
        origin = self._arrays[f"{name}_origin"]
        return np.broadcast_to(origin, (self.cycles, 2)).astype(np.float64)

    def number(self, name: str) -> float:
        """Return a number that is recorded once."""
        return float(self._arrays[name])

    @property
    def task(self) -> Task:
        """The goal and the map."""
        cells = self._arrays["map"].astype(np.int8)
        origin_x, origin_y = self._arrays["map_origin"].tolist()
        return Task(
            Pose2D(*self._arrays["goal"].tolist()),
            OccupancyMap(cells, self.number("map_resolution"), origin_x, origin_y),
        )

    @property
    def parameters(self) -> dict[str, object]:
        """Parameters of our planners where a recording differs from the launch."""
        options = ast.literal_eval(str(self._arrays["options"]))
        paddings = {
            f"{ours}.footprint_padding_m": options.get(theirs, {}).get(
                "footprint_padding", 0.1
            )
            for ours, theirs in (("local_costmap", "local"), ("global_costmap", "glob"))
        }
        return {**paddings, "global_costmap.map_resolution": "static_at" not in options}

    def observation(self, cycle: int) -> Observation:
        """Return the readings of a cycle."""
        recorded = self._arrays
        x, y, yaw, speed, turn = recorded["odometry"][cycle].tolist()
        stamp_ns = int(recorded["stamp_ns"][cycle])
        odometry = Odometry(stamp_ns, Pose2D(x, y, yaw), Velocity2D(speed, turn))
        angles = (self.number("angle_min"), self.number("angle_increment"))
        limits = (self.number("range_min"), self.number("range_max"))
        scan = Scan(
            int(recorded["scan_stamp_ns"][cycle]),
            recorded["ranges"][cycle],
            *angles,
            *limits,
        )
        pose = Pose2D(*recorded["pose"][cycle].tolist())
        return Observation(stamp_ns, odometry, scan, pose)

    def plan(self, cycle: int) -> FloatArray:
        """Return the plan (n, 2) in m after a cycle.

        What lies on lines of the grid is put back there exactly.
        """
        points = self._join("plan", cycle)
        resolution = self.number("global_resolution")
        origin: FloatArray = self._arrays["global_origin"]
        lines: FloatArray = (
            origin + np.rint((points - origin) / resolution) * resolution
        )
        return np.where(np.abs(points - lines) <= _ROUNDED_M, lines, points)

    def band(self, cycle: int) -> FloatArray:
        """Return the bubbles (n, 3) after a cycle: x, y, radius in m."""
        return self._join("band", cycle)

    def command(self, cycle: int) -> Velocity2D | None:
        """Return what was sent in a cycle, None for nothing."""
        recorded = self._arrays
        return (
            Velocity2D(float(recorded["v"][cycle]), float(recorded["w"][cycle]))
            if recorded["published"][cycle]
            else None
        )

    def _join(self, name: str, cycle: int) -> FloatArray:
        end = self._ends[name][cycle]
        begin = end - self._arrays[f"{name}_n"][cycle]
        points: FloatArray = self._arrays[name][begin:end].astype(np.float64)
        return points

    @cached_property
    def _ends(self) -> Mapping[str, npt.NDArray[np.int64]]:
        return {name: np.cumsum(self._arrays[f"{name}_n"]) for name in ("plan", "band")}


class _RecordedCosts(RollingCostmap):
    """A costmap whose costs and place are those of a recording, cycle by cycle."""

    def __init__(self, costmap: Costmap, recording: Recording, name: str):
        super().__init__(costmap.config)
        self.resolution = recording.number(f"{name}_resolution")
        self._recorded, self._origins, self.cycle = (
            recording.costs(name),
            recording.origins(name),
            0,
        )

    def update(self, pose: Pose2D, scan: Scan, lidar: Pose2D) -> None:
        """Take the costs of the cycle."""
        del pose, scan, lidar
        self.costs = self._recorded[self.cycle].copy()
        self.origin_x, self.origin_y = self._origins[self.cycle].tolist()

    def reset(self) -> None:
        """Clear everything."""
        self.costs[:] = 0


class _RecordedPlans(GlobalPlanner):
    """A global planner that returns the plans of a recording.

    Poses but the goal have yaw 0.
    """

    def __init__(self, recording: Recording):
        self._recording = recording
        self.cycle = 0

    def plan(self, costmap: Costmap, start: Pose2D, goal: Pose2D) -> GlobalPlan:
        """Return the plan of the cycle."""
        del costmap, start
        points = self._recording.plan(self.cycle)
        if not len(points):
            return GlobalPlan(None, "no plan was recorded")
        poses = np.column_stack([points, np.zeros(len(points))])
        poses[-1] = goal.numbers
        return GlobalPlan(poses)


@dataclass(frozen=True)
class Cycle:
    """One control cycle of ours beside the original's.

    Which parts are equal, and the commands.
    """

    number: int
    plan: bool
    local: int
    whole: int
    band: bool
    ours: Velocity2D
    original: Velocity2D

    def within(self, tolerance: tuple[float, float]) -> bool:
        """Tell whether the commands are equal within m/s and rad/s."""
        speed = abs(self.ours.linear - self.original.linear)
        turn = abs(self.ours.angular - self.original.angular)
        return speed <= tolerance[0] and turn <= tolerance[1]

    def __str__(self) -> str:
        parts = [f"local costmap {self.local} cells"] * (self.local > 0) + [
            f"global costmap {self.whole} cells"
        ] * (self.whole > 0)
        parts += ["plan"] * (not self.plan) + ["band"] * (not self.band)
        commands = " against ".join(
            f"({c.linear:.3f} m/s, {c.angular:.3f} rad/s)"
            for c in (self.ours, self.original)
        )
        return f"cycle {self.number}: {commands}; differ: {', '.join(parts) or 'the command alone'}"


class Replay(NavigationPlanner):
    """Our planner, given at a depth what the original had in place of its own."""

    def __init__(
        self, recording: Recording, depth: str, overrides: Mapping[str, object]
    ):
        if depth not in DEPTHS:
            raise ConfigError(
                f"depth must be one of {', '.join(DEPTHS)}, got {depth!r}"
            )
        config = planner_config(
            recording.planner, PRESET, {**recording.parameters, **overrides}
        )
        if not isinstance(config, NavigationConfig):
            raise ConfigError(
                f"{recording.name}: {recording.planner!r} follows no global plan"
            )
        planner = planner_entry(recording.planner).build(config)
        assert isinstance(planner, NavigationPlanner)
        super().__init__(config, planner.controller)
        self._recording = recording
        self._depth = depth
        self._given: list[_RecordedCosts | _RecordedPlans] = []
        self.start(recording.task, seed=0)

    def start(self, task: Task, seed: int) -> None:
        """Begin the drive; in place of ours stands what the depth gives."""
        super().start(task, seed)
        recorded = self._recording
        if self._depth != "observations":
            self._local_costmap = _RecordedCosts(self._local_costmap, recorded, "local")
            self._global_costmap = _RecordedCosts(
                self._global_costmap, recorded, "global"
            )
            self._given += [self._local_costmap, self._global_costmap]
        if self._depth == "controller":
            self._global_planner = _RecordedPlans(recorded)
            self._given.append(self._global_planner)

    def compare(self) -> Iterator[Cycle]:
        """Yield the driving cycles.

        Those in which the original's local planner was asked and sent a command.
        """
        sent = STOP
        for number in range(self._recording.cycles):
            for stand_in in self._given:
                stand_in.cycle = number
            ours = self.step(self._recording.observation(number)).command
            sent = sent if ours is None else ours
            original = self._recording.command(number)
            if original is not None and number > 0:
                yield self._compare_commands(number, sent, original)

    def _compare_commands(
        self, number: int, sent: Velocity2D, original: Velocity2D
    ) -> Cycle:
        recorded = self._recording
        band = self.controller.view().band
        local, whole = (
            int((ours.costs != recorded.costs(name)[number]).sum())
            for ours, name in (
                (self._local_costmap, "local"),
                (self._global_costmap, "global"),
            )
        )
        plan = np.empty((0, 2)) if self._plan is None else self._plan[:, :2]
        bubbles = np.empty((0, 3)) if band is None else band
        same_band = recorded.planner != "eband" or _near(bubbles, recorded.band(number))
        return Cycle(
            number,
            _near(plan, recorded.plan(number)),
            local,
            whole,
            same_band,
            sent,
            original,
        )


def _near(values: FloatArray, other_values: FloatArray) -> bool:
    if values.shape != other_values.shape:
        return False
    return bool((np.abs(values - other_values) <= _PLACE_M).all())


def share(cycles: Sequence[Cycle], tolerance: tuple[float, float]) -> float:
    """Return the share of cycles whose commands are equal within the tolerance."""
    return sum(cycle.within(tolerance) for cycle in cycles) / max(1, len(cycles))


def row(name: str, cycles: Sequence[Cycle]) -> str:
    """Return a line of the table.

    Cycles, and the shares in which commands and their causes are equal.
    """
    count = max(1, len(cycles))
    equal = [
        share(cycles, TIGHT),
        share(cycles, LOOSE),
        sum(cycle.local == 0 for cycle in cycles) / count,
        sum(cycle.whole == 0 for cycle in cycles) / count,
        sum(cycle.plan for cycle in cycles) / count,
        sum(cycle.band for cycle in cycles) / count,
    ]
    return f"{name:18} {len(cycles):6}" + "".join(
        f"{100 * part:8.1f}%" for part in equal
    )


@click.command()
@click.argument(
    "paths",
    nargs=-1,
    required=True,
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
)
@click.option(
    "--depth",
    "depths",
    multiple=True,
    type=click.Choice(DEPTHS),
    help="What is compared; all without it.",
)
@click.option(
    "--partings",
    default=0,
    show_default=True,
    type=click.IntRange(0),
    help="Cycles to tell of per drive.",
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="KEY=VALUE",
    help="A parameter of our planner.",
)
def main(
    paths: Sequence[Path], depths: Sequence[str], partings: int, settings: Sequence[str]
) -> None:
    """Compare our planners with recordings of the originals."""
    overrides = {
        key: yaml.safe_load(value)
        for key, _, value in (text.partition("=") for text in settings)
    }
    for depth in depths or DEPTHS:
        click.echo(
            f"{depth:18} cycles{'tight':>10}{'loose':>10}{'local':>10}{'global':>10}{'plan':>10}{'band':>10}"
        )
        all_cycles: list[Cycle] = []
        for path in paths:
            recording = Recording(path)
            cycles = list(Replay(recording, depth, overrides).compare())
            all_cycles += cycles
            click.echo(row(recording.name, cycles))
            for cycle in [cycle for cycle in cycles if not cycle.within(TIGHT)][
                :partings
            ]:
                click.echo(f"    {cycle}")
        click.echo(row("all", all_cycles))


if __name__ == "__main__":
    main()
