"""How the results of a folder are made again: the command, and the files it needs."""

import json
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import yaml

from barn_eval.analysis.sources import Source
from barn_eval.experiments.experiment import Experiment
from barn_eval.experiments.ros_config import RosSetup
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
        return _repeat(from_dict(Experiment, dict(source.configuration), str(source.path)))
    except BarnError as error:
        return Repeat("", note=f"this version of the suite does not read the configuration: {error}")


def _repeat(experiment: Experiment) -> Repeat:
    words = ["barn", "campaign", "--dataset", experiment.dataset, "--worlds", experiment.worlds]
    words += ["--repetitions", str(experiment.repetitions), "--seed", str(experiment.seed), "--mode", experiment.mode]
    names = [f"{one.name}:{one.preset}" if one.preset else one.name for one in experiment.planners]
    words += ["--planners", ",".join(names), "--bags", experiment.bags]
    for one in experiment.planners:
        words += _settings("--set", {f"{one.name}.{key}": value for key, value in one.overrides.items()})
        words += ["--planner-command", f"{one.name}={one.command}"] if one.command else []
    own = PROTOCOLS.get(experiment.protocol.name) == experiment.protocol
    words += ["--protocol", experiment.protocol.name if own else "protocol.yaml"]
    words += _settings("--sim", _changed(experiment.simulator, simulator_config(experiment.protocol)))
    words += [*_settings("--ros", _changed(experiment.ros, RosSetup())), "--out", "results"]
    live = [one.name for one in experiment.planners if one.source]
    note = f"Given as Python objects, not by a command: {', '.join(live)}." if live else ""
    return Repeat(shlex.join(words), "" if own else _yaml(experiment.protocol), note)


def _changed(config: Any, standard: Any) -> dict[str, Any]:
    """Return the fields of a configuration that differ from the standard one, by dotted name."""
    known = {name: value for name, _, value in fields_of(standard)}
    return {name: value for name, _, value in fields_of(config) if known[name] != value}


def _settings(option: str, values: Mapping[str, Any]) -> list[str]:
    return [word for key, value in values.items() for word in (option, f"{key}={json.dumps(value)}")]


def _yaml(protocol: Protocol) -> str:
    return yaml.safe_dump({"schema_version": 1} | as_dict(protocol), sort_keys=False)
