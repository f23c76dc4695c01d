"""What a campaign is, and how it is worked off.

The two are kept apart: `CampaignConfig` decides the results, so a campaign is only resumed with the same one;
`ExecutionConfig` decides how soon they are there, and may change from one session to the next.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from barn_eval.experiments.ros_config import BAGS, RosSetup
from barn_eval.experiments.runs import MODES, RunPlan
from barn_eval.trials.protocol import PAPER, Protocol, load_protocol
from barn_eval.trials.spec import simulator_config
from barn_sim.config import SimulatorConfig
from barn_worlds.config import Checked, from_dict, quantity
from barn_worlds.errors import ConfigError, suggest
from barn_worlds.text_files import read_yaml

SCHEMA_VERSION = 1
ENGINES = ("local", "ray")


@dataclass(frozen=True)
class PlannerChoice(Checked):
    """A planner of a campaign; `overrides` are its parameters by dotted name."""

    name: str = quantity("dwa", "name of the planner")
    preset: str = quantity("", "preset of its parameters, empty for the protocol's own")
    overrides: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class CampaignConfig(Checked):
    """What decides the results of a campaign.

    planner_command: of mode ros, what is started in place of the planner's node; empty for our own. ros: how nodes are
    run.
    """

    dataset: str = quantity("barn300", "data set: a name, folder or file")
    worlds: str = quantity("all", "which of its worlds, such as 0, 0-49 or 0:300:6")
    planners: tuple[PlannerChoice, ...] = (PlannerChoice(),)
    repetitions: int = quantity(5, "trials per world and planner", minimum=1, maximum=99)
    protocol: Protocol = field(default_factory=lambda: PAPER)
    simulator: SimulatorConfig = field(default_factory=lambda: simulator_config(PAPER))
    seed: int = quantity(0, "seed of the campaign", minimum=0, maximum=2**62)
    mode: str = quantity("direct", "one process or ROS nodes", choices=MODES)
    planner_command: str = quantity("", "command that starts a planner of your own (mode ros)")
    bags: str = quantity("none", "which trials are recorded", choices=BAGS)
    ros: RosSetup = field(default_factory=RosSetup)

    def __post_init__(self) -> None:
        super().__post_init__()
        names = [planner.name for planner in self.planners]
        if not names:
            raise ConfigError("planners must name at least one planner")
        for name in names:
            if names.count(name) > 1:
                raise ConfigError(f"planners names {name!r} twice; run two campaigns and use `barn compare` on them")
        if self.planner_command and self.mode != "ros":
            raise ConfigError("planner_command needs mode ros")
        if self.ros != RosSetup() and self.mode != "ros":
            raise ConfigError("ros needs mode ros")
        if self.ros.bags != RosSetup().bags:
            raise ConfigError("ros.bags must not be given, bags says it")
        if self.planner_command and len(names) > 1:
            raise ConfigError("planner_command starts one planner; name one planner only")

    def plans(self) -> tuple[RunPlan, ...]:
        """Return the plan of each planner's trials."""
        return tuple(
            RunPlan(
                dataset=self.dataset,
                worlds=self.worlds,
                planner=planner.name,
                preset=planner.preset,
                overrides=planner.overrides,
                protocol=self.protocol,
                simulator=self.simulator,
                mode=self.mode,
                planner_command=self.planner_command,
                ros=replace(self.ros, bags=self.bags) if self.mode == "ros" else RosSetup(),
                seed=self.seed,
                repetitions=self.repetitions,
            )
            for planner in self.planners
        )


@dataclass(frozen=True)
class ExecutionConfig(Checked):
    """How a campaign is worked off; nothing here changes a result."""

    engine: str = quantity("local", "what runs the trials", choices=ENGINES)
    workers: int = quantity(0, "trials at a time, 0 for one per processor", minimum=0, maximum=10_000)
    address: str = quantity("", "address of a Ray cluster, empty to start one on this machine")
    trial_limit_s: float = quantity(
        600.0, "wall-clock time after which a trial is given up", "s", minimum=1.0, maximum=1e6
    )
    attempts: int = quantity(3, "attempts at a trial whose worker dies or exceeds that time", minimum=1, maximum=100)
    losses: int = quantity(20, "trials lost one after the other before the campaign stops", minimum=1, maximum=10_000)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.address and self.engine != "ray":
            raise ConfigError("address needs engine ray")


@dataclass(frozen=True)
class Campaign:
    """A campaign as it was asked for, and the folder it goes to."""

    config: CampaignConfig
    execution: ExecutionConfig
    out: Path


def read_campaign(path: Path | None, options: Mapping[str, Any]) -> Campaign:
    """Return the campaign that a YAML file describes, with what `options` give in place of it.

    Keys are the fields of `CampaignConfig`, `execution` with those of `ExecutionConfig`, and `out`. Short forms, also
    in options: `planners` as texts "name" or "name:preset", `protocol` a name or a file, `simulator` dotted names of
    parameters to change. An option counts unless it is None; there is one more, `settings`: overrides by planner.
    Raises ConfigError in one line.
    """
    content = read_yaml(path, SCHEMA_VERSION) if path else {}
    where = str(path) if path else "options"
    content["execution"] = dict(content.get("execution") or {})
    for name, value in options.items():
        if value is not None and name != "settings":
            (content["execution"] if name in ExecutionConfig.__dataclass_fields__ else content)[name] = value
    out = content.pop("out", None)
    if not isinstance(out, (str, Path)) or not str(out):
        raise ConfigError(f"{where}: out must be a folder, got {out!r}")
    execution = from_dict(ExecutionConfig, content.pop("execution"), f"{where}: execution")
    config = _campaign_config(content, options.get("settings") or {}, where)
    if config.mode == "ros" and execution.engine != "local":
        raise ConfigError(f"{where}: mode ros needs engine local")
    return Campaign(config, execution, Path(out))


def _campaign_config(content: dict[str, Any], settings: Mapping[str, Any], where: str) -> CampaignConfig:
    for key in content:
        if key not in CampaignConfig.__dataclass_fields__:
            raise ConfigError(f"{where}: unknown key {key!r}{suggest(key, _known_keys())}")
    protocol = content.get("protocol", PAPER.name)
    if not isinstance(protocol, str):
        raise ConfigError(f"{where}: protocol must be a name or a YAML file, got {protocol!r}")
    resolved = load_protocol(protocol)
    overrides = content.get("simulator") or {}
    if not isinstance(overrides, dict):
        raise ConfigError(f"{where}: simulator must be a mapping of parameters to values, got {overrides!r}")
    planners = content.get("planners", "dwa")
    if isinstance(planners, str):
        planners = planners.split(",")
    if not isinstance(planners, (list, tuple)):
        raise ConfigError(f"{where}: planners must be a list of names, got {planners!r}")
    values = {key: value for key, value in content.items() if key not in ("protocol", "simulator", "planners")}
    plain = replace(
        from_dict(CampaignConfig, values, where),
        planners=tuple(_planner(entry, where) for entry in planners),
        protocol=resolved,
        simulator=simulator_config(resolved, overrides),
    )
    return _with_settings(plain, settings, where)


def _planner(entry: Any, where: str) -> PlannerChoice:
    """Return the planner that a mapping describes, or a text "name" or "name:preset"."""
    if isinstance(entry, str):
        name, _, preset = entry.strip().partition(":")
        return PlannerChoice(name, preset)
    return from_dict(PlannerChoice, entry, f"{where}: planners")


def _with_settings(config: CampaignConfig, settings: Mapping[str, Any], where: str) -> CampaignConfig:
    names = [planner.name for planner in config.planners]
    for name in settings:
        if name not in names:
            raise ConfigError(
                f"{where}: parameters of planner {name!r}, which is not in the campaign{suggest(name, names)}"
            )
    changed = (
        replace(planner, overrides=planner.overrides | settings.get(planner.name, {})) for planner in config.planners
    )
    return replace(config, planners=tuple(changed))


def _known_keys() -> list[str]:
    return [*CampaignConfig.__dataclass_fields__, "execution", "out"]
