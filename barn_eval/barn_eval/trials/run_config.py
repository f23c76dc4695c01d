"""What an experiment is, and how it is run.

The two are kept apart: `Experiment` decides the results, so a folder is only resumed with the same one; `Execution`
decides how soon they are there, and may change from one session to the next.
"""

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from typing import Any

from barn_eval.trials import identity
from barn_eval.trials.protocol import CHALLENGE, Protocol
from barn_eval.trials.result import DECLARED, FREE, MEASURED, REAL_TIME
from barn_eval.trials.ros_config import BAGS, ENGINES, MODES, RosSetup
from barn_eval.trials.spec import TrialSpec, simulator_config
from barn_planners.registry import planner_config, planner_entry, speed_cap_mps
from barn_planners.robots import lidar_place, parameters_for
from barn_sim.config import SimulatorConfig, robot_of
from barn_worlds.base.compute import Compute
from barn_worlds.base.config import OPTIONAL, Checked, as_dict, fields_of, quantity
from barn_worlds.base.errors import ConfigError, format_value
from barn_worlds.datasets.dataset import Dataset, open_dataset, select_worlds

# Names of planners become names of files.
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,59}")
NO_SOURCE = "unknown"


COMPUTE_KEYS = tuple(field.name for field in fields(Compute))


def _declared(name: str) -> float:
    """Return a field of `Compute` as one of a choice, where it counts in place of what the registry declares."""
    about = next(about for key, about, _ in fields_of(Compute()) if key == name)
    return quantity(
        0.0, about.description, "s", about.minimum, about.maximum, optional=True
    )


@dataclass(frozen=True)
class PlannerChoice(Checked):
    """A planner of an experiment; with a command or a source, the name is only what results are filed under.

    files: SHA-256 of those that the command names, by their names there, so that a run is not resumed with others.
    """

    name: str = quantity("dwa", "name of the planner")
    preset: str = quantity(
        "", "preset of its parameters, empty for that of the protocol"
    )
    overrides: dict[str, Any] = field(default_factory=dict)
    command: str = quantity(
        "", "of mode ros: command that starts it, in place of a node of the suite"
    )
    source: str = quantity(
        "", "of a planner given as a Python object: SHA-256 of its source, or unknown"
    )
    max_speed_mps: float = quantity(
        0.0,
        "of a planner with a command or a source: the highest speed that it commands, and is held to; 0: the robot's",
        "m/s",
        0.0,
        100.0,
        optional=True,
    )
    delay_s: float = _declared("delay_s")
    delay_p95_s: float = _declared("delay_p95_s")
    period_s: float = _declared("period_s")
    files: dict[str, str] = field(default_factory=dict, metadata=OPTIONAL)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not _NAME.fullmatch(self.name):
            raise ConfigError(
                f"planner {format_value(self.name)}: a name must be 1 to 60 letters, digits, '_', '-' or '.'"
            )
        if (self.command or self.source) and (self.preset or self.overrides):
            raise ConfigError(
                f"planner {self.name!r}: presets and parameters are for planners of the registry"
            )
        if self.registered and self.max_speed_mps:
            raise ConfigError(
                f"planner {self.name!r}: its speed cap follows from its parameters, it takes no other"
            )
        self.stated()  # checks it

    @property
    def registered(self) -> bool:
        """Whether the suite makes the planner itself, from its registry."""
        return not (self.command or self.source)

    def stated(self) -> Compute:
        """Return what the choice itself says of the time that the planner computes."""
        return Compute(**{key: getattr(self, key) for key in COMPUTE_KEYS})

    @property
    def compute(self) -> Compute:
        """How long the planner computes for a cycle: as the choice says, else as the registry declares, if it does."""
        own = self.stated()
        return (
            own
            if own.is_declared or not self.registered
            else planner_entry(self.name).compute or own
        )


@dataclass(frozen=True)
class Experiment(Checked):
    """What decides the results of an experiment: which planners drive which worlds how often, and under what rules."""

    dataset: str = quantity("barn300", "data set: a name, folder or file")
    worlds: str = quantity("all", "which of its worlds, such as 0, 0-49 or 0:300:6")
    planners: tuple[PlannerChoice, ...] = (PlannerChoice(),)
    repetitions: int = quantity(1, "trials per world and planner", "", 1, 99)
    protocol: Protocol = field(default_factory=lambda: CHALLENGE)
    simulator: SimulatorConfig = field(
        default_factory=lambda: simulator_config(CHALLENGE)
    )
    seed: int = quantity(0, "seed that all others come from", "", 0, 2**62)
    mode: str = quantity("direct", "one process or ROS nodes", choices=MODES)
    bags: str = quantity("none", "which trials keep a bag", choices=BAGS)
    compute: str = quantity(
        DECLARED,
        "what trials charge for a planner's computing: what it declares, if it does, or what is measured, at this"
        " machine's pace",
        choices=(DECLARED, MEASURED),
        optional=True,
    )
    ros: RosSetup = field(default_factory=RosSetup)
    course: tuple[float, ...] = quantity(
        (),
        "start x, y, yaw and goal x, y of all its worlds, in m and rad, in place of their own",
        optional=True,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        names, over_ros = (
            [planner.name for planner in self.planners],
            self.mode == "ros",
        )
        if not names:
            raise ConfigError("planners must name at least one planner")
        for planner in self.planners:
            name = planner.name
            if names.count(name) > 1:
                raise ConfigError(
                    f"planners names {name!r} twice; make two experiments and use `barn compare` on them"
                )
            if planner.source and over_ros:
                raise ConfigError(
                    f"planner {name!r}: a Python object drives in mode direct only"
                )
            if planner.command and not over_ros:
                raise ConfigError(f"planner {name!r}: a planner command needs mode ros")
        if over_ros and self.compute == MEASURED:
            raise ConfigError(
                "compute measured needs mode direct; over ROS, ros.lockstep=false charges all time"
            )
        if not over_ros and self.ros != RosSetup():
            raise ConfigError("settings of ros need mode ros")

    def way(self, compute: Compute) -> str:
        """Return what its trials charge for the computing of a planner that declares this."""
        if self.mode == "ros" and not self.ros.lockstep:
            return REAL_TIME
        return (
            MEASURED
            if self.compute == MEASURED
            else DECLARED
            if compute.is_declared
            else FREE
        )

    def settings(self, planner: PlannerChoice) -> dict[str, Any]:
        """Return what a `TrialSpec` has of a planner's configuration; ConfigError for parameters that it does not take.

        What a planner of the registry takes from the robot (`barn_planners.robots`) follows from the simulator; another
        place of the lidar is refused.
        """
        preset = (
            "" if planner.source else planner.preset or self.protocol.planner_preset
        )
        computing = (
            {"compute": as_dict(planner.compute)} if planner.compute.is_declared else {}
        )
        if not planner.registered:
            known: dict[str, Any] = {
                "command": planner.command,
                "source": planner.source,
            } | computing
            known |= {
                key: value
                for key in ("max_speed_mps", "files")
                if (value := getattr(planner, key))
            }
            return _settings(preset, {}, known, planner.max_speed_mps)
        overrides = parameters_for(
            planner.name, preset, dict(planner.overrides), robot_of(self.simulator)
        )
        place_of_lidar = lidar_place(
            planner_config(planner.name, preset, overrides), self.simulator.lidar
        )
        for key, place in place_of_lidar.items():
            if key in overrides:
                what = key.rpartition(".")[2].removeprefix("lidar_")
                there = f"{place:g} {what.rpartition('_')[2]} (simulator parameter lidar.mount_{what})"
                other = (
                    f"{key} is {overrides[key]:g}, but the lidar is mounted at {there}"
                )
                raise ConfigError(f"planner {planner.name!r}: {other}")
            overrides[key] = place
        config = planner_config(planner.name, preset, overrides)
        known = {"planner": planner.name} | as_dict(config) | computing
        return _settings(preset, overrides, known, speed_cap_mps(planner.name, config))

    def trials(
        self,
        worlds: Iterable[int] | None = None,
        *,
        dataset: Dataset | None = None,
        started_by_hand: bool = False,
    ) -> list[TrialSpec]:
        """Return the trials, world by world, repetition by repetition, planner by planner.

        So planners are compared on the same worlds however early an experiment is stopped. Each world is read once.
        worlds: numbers of those to take in place of all. dataset: where they are, if not where it says.
        started_by_hand: whether planners were, so that nothing is known of them but their names.
        BarnError in one line if a world cannot be read or driven in.
        """
        driven: list[dict[str, Any]] = []
        for one in self.planners:
            compute = Compute() if started_by_hand else one.compute
            settings = (
                {"preset": one.preset, "overrides": one.overrides}
                if started_by_hand
                else self.settings(one)
            )
            driven.append(
                {"planner": one.name, "compute": compute, "way": self.way(compute)}
                | settings
            )
        dataset = (dataset or open_dataset(self.dataset)).for_robot(
            robot_of(self.simulator), self.course
        )
        chosen = tuple(
            select_worlds(self.worlds, dataset.world_numbers)
            if worlds is None
            else worlds
        )
        dataset.require_fit(robot_of(self.simulator), chosen)
        found = []
        for index in chosen:
            world = dataset.load(index)
            self.protocol.sized(world, self.simulator.chassis).course(world)
            found += [
                TrialSpec(
                    dataset=dataset.name,
                    index=index,
                    world=world,
                    protocol=self.protocol,
                    simulator=self.simulator,
                    campaign_seed=self.seed,
                    repetition=repetition,
                    **one,
                )
                for repetition in range(self.repetitions)
                for one in driven
            ]
        return found


@dataclass(frozen=True)
class Execution(Checked):
    """How an experiment is run; nothing here changes a result."""

    engine: str = quantity("local", "what runs the trials", choices=ENGINES)
    workers: int = quantity(
        0, "trials at a time, 0 for one per processor", "", 0, 10_000
    )
    address: str = quantity(
        "", "address of a Ray cluster, empty to start one on this machine"
    )
    trial_limit_s: float = quantity(
        600.0,
        "wall-clock time after which a trial is given up; 0: never",
        "s",
        0.0,
        1e6,
    )
    attempts: int = quantity(
        3, "attempts at a trial whose worker dies or exceeds that time", "", 1, 100
    )
    losses: int = quantity(
        20, "trials lost one after the other before it stops", "", 1, 10_000
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.address and self.engine != "ray":
            raise ConfigError("address needs engine ray")

    @property
    def processes(self) -> int:
        """Number of workers on this machine."""
        return (
            1
            if self.engine == "inline"
            else self.workers or len(os.sched_getaffinity(0))
        )


def _settings(
    preset: str, overrides: dict[str, Any], known: dict[str, Any], declared_mps: float
) -> dict[str, Any]:
    fingerprint = identity.fingerprint(known)
    return {
        "preset": preset,
        "overrides": overrides,
        "planner_config": fingerprint,
        "declared_mps": declared_mps,
    }
