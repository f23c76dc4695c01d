"""How the results of a folder are made again: the command, and the files it needs."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import yaml

from barn_eval.analysis.sources import Source
from barn_eval.experiments.config import CampaignConfig
from barn_eval.experiments.runs import RunPlan
from barn_eval.trials.protocol import PROTOCOLS, Protocol
from barn_eval.trials.spec import simulator_config
from barn_worlds.config import as_dict, fields_of, from_dict
from barn_worlds.errors import BarnError


@dataclass(frozen=True)
class Repeat:
    """A command; the protocol as YAML where it is none of the suite's own; what the command cannot say."""

    command: str
    protocol_yaml: str = ""
    note: str = ""


def repeat(source: Source) -> Repeat:
    """Return how the results of a source are made again."""
    try:
        if source.kind == "campaign":
            return _repeat_campaign(from_dict(CampaignConfig, dict(source.configuration), str(source.path)))
        return _repeat_run(from_dict(RunPlan, dict(source.configuration), str(source.path)))
    except BarnError as error:
        return Repeat("", note=f"this version of the suite does not read the configuration: {error}")


def _repeat_run(plan: RunPlan) -> Repeat:
    words = ["barn", "run", *_common(plan), "--planner", plan.planner]
    words += ["--preset", plan.preset] if plan.preset else []
    words += _settings("--set", plan.overrides)
    return _finished(plan, words)


def _repeat_campaign(config: CampaignConfig) -> Repeat:
    planners = ",".join(f"{one.name}:{one.preset}" if one.preset else one.name for one in config.planners)
    words = ["barn", "campaign", *_common(config), "--planners", planners]
    for one in config.planners:
        words += _settings("--set", {f"{one.name}.{key}": value for key, value in one.overrides.items()})
    words += ["--bags", config.bags]
    return _finished(config, words)


def _common(plan: RunPlan | CampaignConfig) -> Iterator[str]:
    yield from ("--dataset", plan.dataset, "--worlds", plan.worlds, "--repetitions", str(plan.repetitions))
    yield from ("--seed", str(plan.seed), "--mode", plan.mode)
    if plan.planner_command:
        yield from ("--planner-command", plan.planner_command)


def _finished(plan: RunPlan | CampaignConfig, words: list[str]) -> Repeat:
    own = PROTOCOLS.get(plan.protocol.name) == plan.protocol
    words += ["--protocol", plan.protocol.name if own else "protocol.yaml"]
    standard = {name: value for name, _, value in fields_of(simulator_config(plan.protocol))}
    changed = {name: value for name, _, value in fields_of(plan.simulator) if standard.get(name) != value}
    words += [*_settings("--sim", changed), "--out", "results"]
    note = "" if plan.mode == "direct" else "How ROS nodes were run is in the configuration below."
    return Repeat(shlex.join(words), "" if own else _yaml(plan.protocol), note)


def _settings(option: str, values: Mapping[str, Any]) -> list[str]:
    return [word for key, value in values.items() for word in (option, f"{key}={json.dumps(value)}")]


def _yaml(protocol: Protocol) -> str:
    return yaml.safe_dump({"schema_version": 1} | as_dict(protocol), sort_keys=False)
