"""What a run is, and how it is executed.

`RunConfig` decides the results, so a folder is resumed only with an equal one.
`ExecutionConfig` decides how soon results arrive, and may change from one session to
the next.
"""

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from typing import Any

from barn_eval.trials import identity
from barn_eval.trials.protocol import CHALLENGE, Protocol
from barn_eval.trials.result import DECLARED, FREE, MEASURED, REAL_TIME
from barn_eval.trials.ros_config import BAGS, ENGINES, MODES, RosConfig
from barn_eval.trials.spec import TrialSpec, simulator_config
from barn_eval.trials.system import System
from barn_planners.registry import (
    planner_config,
    planner_entry,
    planner_names,
    speed_cap_mps,
)
from barn_planners.robots import fit_parameters, lidar_mount_changes
from barn_sim.config import SimulatorConfig, robot_of
from barn_worlds.base.compute import NO_COMPUTE, Compute
from barn_worlds.base.config import (
    OPTIONAL,
    Checked,
    as_dict,
    fields_of,
    optional,
    quantity,
)
from barn_worlds.base.errors import ConfigError, format_value
from barn_worlds.base.types import Pose2D
from barn_worlds.datasets.dataset import Dataset, open_dataset, select_worlds

# Names of planners become names of files.
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,59}")

# Characters of an input, few enough for a pipe that nobody reads yet.
_MAX_INPUT = 4000

# What stands for the goal of a trial in a planner's command or input.
_PLACEHOLDER = re.compile(r"\{(goal_x|goal_y|goal_yaw|frame)\}")

# Source of a planner object whose code cannot be read.
UNKNOWN_SOURCE = "unknown"


def fill_placeholders(text: str, goal: Pose2D, frame: str) -> str:
    """Return a text with the goal in place of {goal_x}, {goal_y}, {goal_yaw}, {frame}.

    Args:
        text: Command or input of a planner.
        goal: Goal of a trial, in m and rad.
        frame: Frame of the goal.
    """
    values = {"frame": frame}
    for name in ("x", "y", "yaw"):
        # A parameter of ROS is a float only if it has a point.
        values[f"goal_{name}"] = str(round(float(getattr(goal, name)), 6))
    return _PLACEHOLDER.sub(lambda match: values[match[1]], text)


COMPUTE_KEYS = tuple(field.name for field in fields(Compute))


def _compute_quantity(name: str) -> Any:
    """Return a dataclass field, 0 by default, declared like the same one of `Compute`."""
    declarations = {key: item for key, item, _ in fields_of(NO_COMPUTE)}
    delay = declarations[name]
    return optional(0.0, delay.description, "s", delay.minimum, delay.maximum)


@dataclass(frozen=True)
class PlannerChoice(Checked):
    """A planner of a run: one of the registry, a command over ROS or a planner object.

    With a command or a source, the name is only what results are filed under.
    """

    name: str = quantity("dwa", "name of the planner")
    preset: str = quantity(
        "", "preset of its parameters; empty: the preset that the protocol names"
    )
    overrides: dict[str, Any] = field(default_factory=dict)
    entry: str = optional(
        "", "registry name of a planner whose results are filed under another name"
    )
    command: str = quantity(
        "",
        "in mode ros: command that starts the planner instead of a node of the suite",
    )
    input: str = optional(
        "", "text for the standard input of a planner that a command starts"
    )
    source: str = quantity(
        "", "for a planner object: SHA-256 of its source, or unknown"
    )
    max_speed_mps: float = optional(
        0.0,
        "for a planner with a command or a source: highest speed that it may command; 0: the robot's top speed",
        "m/s",
        0.0,
        100.0,
    )
    delay_s: float = _compute_quantity("delay_s")
    delay_p95_s: float = _compute_quantity("delay_p95_s")
    period_s: float = _compute_quantity("period_s")

    # SHA-256 of each file that the command names, by the name there, so that a run is
    # not resumed with other files.
    files: dict[str, str] = field(default_factory=dict, metadata=OPTIONAL)

    def check_rules(self) -> None:
        """Raise ConfigError for a bad name, or settings that its kind does not take."""
        if not _NAME.fullmatch(self.name):
            raise ConfigError(
                f"planner {format_value(self.name)}: a name must be 1 to 60 letters,"
                " digits, '_', '-' or '.'"
            )
        if not self.registered and (self.preset or self.overrides or self.entry):
            raise ConfigError(
                f"planner {self.name!r}: only registered planners have presets and parameters"
            )
        # Rows, pages and colors know the registry's planners by their names.
        if self.entry and self.name in planner_names():
            raise ConfigError(
                f"planner {self.name!r}: is a planner of the registry; give this"
                f" {self.entry} another name"
            )
        if self.input and not self.command:
            raise ConfigError(
                f"planner {self.name!r}: only a planner with a command can have an input"
            )
        if len(self.input) > _MAX_INPUT:
            raise ConfigError(
                f"planner {self.name!r}: an input must have at most {_MAX_INPUT}"
                f" characters, got {len(self.input)}"
            )
        if self.registered and self.max_speed_mps:
            raise ConfigError(
                f"planner {self.name!r}: its parameters set its speed cap, so max_speed_mps is not allowed"
            )
        self._compute_of_choice()  # refuses times that contradict each other

    @property
    def registered(self) -> bool:
        """Whether it is a planner of the registry: no command and no source."""
        return not (self.command or self.source)

    @property
    def entry_name(self) -> str:
        """Registry name of a registered planner: `entry`, or else its own name."""
        return self.entry or self.name

    @property
    def entry_text(self) -> str:
        """Text NAME:PRESET as on the command line, NAME alone without a preset."""
        # Nothing follows the name of a planner without a preset.
        return f"{self.entry_name}:{self.preset}".removesuffix(":")

    @property
    def takes_goal_at_start(self) -> bool:
        """Whether its command or input contains a placeholder for the goal."""
        return bool(_PLACEHOLDER.search(self.command + self.input))

    @property
    def compute(self) -> Compute:
        """Declared delays and period, in s: the choice's own, else the registry's."""
        compute = self._compute_of_choice()
        if compute.is_declared or not self.registered:
            return compute
        return planner_entry(self.entry_name).compute or compute

    def _compute_of_choice(self) -> Compute:
        """Return delays and period of the choice; ConfigError if they conflict."""
        return Compute(**{key: getattr(self, key) for key in COMPUTE_KEYS})


@dataclass(frozen=True)
class PlannerSetup:
    """A planner's configuration, resolved for `TrialSpec`."""

    preset: str = ""
    # Values by dotted name of the parameter, those that follow from the robot included.
    overrides: dict[str, Any] = field(default_factory=dict)
    # Fingerprint of the configuration; empty for a planner that was started by hand.
    planner_config: str = ""
    # The highest speed that the planner says it commands, 0 if it does not say.
    declared_mps: float = 0.0
    compute: Compute = NO_COMPUTE
    # Name in the registry, empty where it is the name of the choice.
    entry: str = ""


@dataclass(frozen=True)
class RunConfig(Checked):
    """What decides the results of a run: planners, worlds, repetitions and rules."""

    dataset: str = quantity("barn300", "data set: a name, folder or file")
    worlds: str = quantity(
        "all", "worlds, such as 0, 0-49, 0:300:6, 1,4,7-9 or all", is_selection=True
    )
    planners: tuple[PlannerChoice, ...] = (PlannerChoice(),)
    repetitions: int = quantity(1, "trials per world and planner", "", 1, 99)
    protocol: Protocol = CHALLENGE
    simulator: SimulatorConfig = field(
        default_factory=lambda: simulator_config(CHALLENGE)
    )
    seed: int = quantity(0, "seed of all random numbers", "", 0, 2**62)
    mode: str = quantity(
        "direct",
        "run trials in one process (direct) or with ROS nodes (ros)",
        choices=MODES,
    )
    bags: str = quantity("none", "trials to record in bags", choices=BAGS)
    compute: str = optional(
        DECLARED,
        "computing time that trials charge: the time that the planner declares, if"
        " any, or the time measured on this machine",
        choices=(DECLARED, MEASURED),
    )
    ros: RosConfig = field(default_factory=RosConfig)
    course: tuple[float, ...] = optional(
        (),
        "start x, y, yaw and goal x, y for all worlds, in m and rad, instead of the worlds' own courses",
    )
    # `RunRequest` draws them, and makes each a world of the run.
    routes: int = optional(
        0,
        "routes to draw at random in each world; each route is counted as a separate world",
        "",
        0,
        1000,
    )
    system: System = field(default_factory=System, metadata=OPTIONAL)

    def check_rules(self) -> None:
        """Raise ConfigError for no or equal planners, or settings of another mode."""
        if not self.planners:
            raise ConfigError("planners must name at least one planner")

        over_ros = self.mode == "ros"
        names = [planner.name for planner in self.planners]
        for place, planner in enumerate(self.planners):
            name = planner.name
            if name in names[:place]:
                raise ConfigError(
                    f"planners names {name!r} twice; give one another name, such as"
                    f" {name}_2={planner.entry_text}"
                )
            if planner.source and over_ros:
                raise ConfigError(
                    f"planner {name!r}: a Python object needs mode direct"
                )
            if planner.command and not over_ros:
                raise ConfigError(f"planner {name!r}: a planner command needs mode ros")

        if over_ros and self.compute == MEASURED:
            raise ConfigError(
                "compute measured needs mode direct; over ROS, ros.lockstep=false"
                " charges all computing time"
            )
        if not over_ros and self.ros != RosConfig():
            raise ConfigError("the settings of ros need mode ros")

    def planner(self, name: str) -> PlannerChoice:
        """Return the planner of a name, which the run must have."""
        return next(planner for planner in self.planners if planner.name == name)

    def require_own_names(self) -> None:
        """Raise ConfigError if a user's planner in the suite's system has a suite name.

        Earlier versions allowed it, so their folders can be read, but not submitted.
        A planner of the suite may drive a system that is only observed.
        """
        for planner in self.planners:
            # "E-Band" would be taken for the suite's "eband" as well.
            plain_name = re.sub("[^a-z0-9]", "", planner.name.lower())
            is_own = not planner.registered and not self.system.is_observed
            if is_own and plain_name in planner_names():
                raise ConfigError(
                    f"planner {planner.name!r}: is a planner of the suite; give your"
                    f" planner a different name, such as my_{plain_name}"
                )

    def compute_mode(self, compute: Compute) -> str:
        """Return DECLARED, MEASURED, FREE or REAL_TIME: how computing is charged."""
        if self.mode == "ros" and not self.ros.lockstep:
            return REAL_TIME
        if self.compute == MEASURED:
            return MEASURED
        return DECLARED if compute.is_declared else FREE

    def resolve_planner(self, choice: PlannerChoice) -> PlannerSetup:
        """Return a planner's resolved setup; ConfigError for a parameter it lacks.

        Raises:
            ConfigError: The planner does not take one of its parameters, or a parameter
                puts the lidar elsewhere than the simulator does.
        """
        preset = choice.preset or self.protocol.planner_preset
        if choice.source:
            preset = ""

        overrides: dict[str, Any] = {}
        content: dict[str, Any]
        if choice.registered:
            overrides = self._registry_overrides(choice, preset)
            config = planner_config(choice.entry_name, preset, overrides)
            declared_mps = speed_cap_mps(choice.entry_name, config)
            content = {"planner": choice.entry_name} | as_dict(config)
        else:
            declared_mps = choice.max_speed_mps
            content = {"command": choice.command, "source": choice.source}
            if choice.max_speed_mps:
                content["max_speed_mps"] = choice.max_speed_mps
            if choice.files:
                content["files"] = choice.files
            if choice.input:
                content["input"] = choice.input

        compute = choice.compute
        if compute.is_declared:
            content["compute"] = as_dict(compute)
        fingerprint = identity.fingerprint(content)
        return PlannerSetup(
            preset, overrides, fingerprint, declared_mps, compute, choice.entry
        )

    def _registry_overrides(self, choice: PlannerChoice, preset: str) -> dict[str, Any]:
        """Return parameters set by choice and robot; ConfigError if lidars differ.

        Raises:
            ConfigError: The choice puts the lidar elsewhere than the simulator does.
        """
        robot = robot_of(self.simulator)
        name = choice.entry_name
        overrides = fit_parameters(name, preset, dict(choice.overrides), robot)
        config = planner_config(name, preset, overrides)
        for key, mount in lidar_mount_changes(config, self.simulator.lidar).items():
            if key in overrides:
                axis = key.rpartition(".")[2].removeprefix("lidar_")
                unit = axis.rpartition("_")[2]
                raise ConfigError(
                    f"planner {choice.name!r}: {key} is {overrides[key]:g}, but the"
                    f" lidar is mounted at {mount:g} {unit} (simulator parameter"
                    f" lidar.mount_{axis})"
                )
            overrides[key] = mount
        return overrides

    def trials(
        self,
        worlds: Iterable[int] | None = None,
        *,
        dataset: Dataset | None = None,
        started_by_hand: bool = False,
    ) -> list[TrialSpec]:
        """Return specifications of all trials: by world, repetition, then planner.

        Planners come innermost, so they are compared on the same worlds even if a run
        stops early. Each world is read once.

        Args:
            worlds: Numbers of the worlds to take, by default those of the run.
            dataset: Where the worlds are, by default the data set that the run names.
            started_by_hand: Whether somebody else starts the planners, so that only
                their names are certain.

        Raises:
            BarnError: A world cannot be read, or does not fit the protocol or robot.
        """
        setups = []
        for choice in self.planners:
            setup = PlannerSetup(choice.preset, choice.overrides)
            if not started_by_hand:
                setup = self.resolve_planner(choice)
            setups.append((choice.name, setup))

        robot = robot_of(self.simulator)
        dataset = (dataset or open_dataset(self.dataset)).for_robot(robot, self.course)
        if worlds is None:
            worlds = select_worlds(self.worlds, dataset.world_numbers)
        world_numbers = tuple(worlds)
        dataset.require_fit(robot, world_numbers)

        specs = []
        for world_number in world_numbers:
            world = dataset.load(world_number)

            # Refuse a world that has no course under the protocol before any trial
            # runs.
            self.protocol.scaled_to(world, self.simulator.chassis).course(world)

            for repetition in range(self.repetitions):
                for name, setup in setups:
                    spec = TrialSpec(
                        dataset=dataset.name,
                        world_number=world_number,
                        world=world,
                        planner=name,
                        protocol=self.protocol,
                        simulator=self.simulator,
                        run_seed=self.seed,
                        repetition=repetition,
                        system=self.system,
                        compute_mode=self.compute_mode(setup.compute),
                        **vars(setup),
                    )
                    specs.append(spec)
        return specs


@dataclass(frozen=True)
class ExecutionConfig(Checked):
    """How a run is executed; nothing here changes a result."""

    engine: str = quantity("local", "engine that runs the trials", choices=ENGINES)
    # 0 is one per processor.
    workers: int = quantity(0, "trials to run at a time", "", 0, 10_000)
    address: str = quantity(
        "", "address of a Ray cluster; empty: start one on this machine"
    )
    trial_limit_s: float = quantity(
        600.0,
        "wall-clock time after which the suite abandons a trial; 0: never",
        "s",
        0.0,
        1e6,
    )
    attempts: int = quantity(
        3, "attempts at a trial whose worker dies or exceeds trial_limit_s", "", 1, 100
    )
    losses: int = quantity(
        20, "trials lost in a row before the run stops", "", 1, 10_000
    )

    def check_rules(self) -> None:
        """Raise ConfigError for a value out of range, or an address without Ray."""
        if self.address and self.engine != "ray":
            raise ConfigError("address needs engine ray")

    @property
    def processes(self) -> int:
        """Number of workers here: 1 inline, else `workers` or one per usable CPU."""
        if self.engine == "inline":
            return 1
        return self.workers or len(os.sched_getaffinity(0))
