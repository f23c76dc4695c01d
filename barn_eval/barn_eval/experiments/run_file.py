"""run.json: what a folder of results holds. Written in one schema; the two that were before it are still read.

schema_version 2: `experiment` with all configuration resolved, `worlds` with their checksums, and `sessions`, each with
when it began, how it was run, versions, commit and machine. Version 1 had `campaign`, or a `plan` of one planner's run.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from barn_eval.experiments.experiment import Execution, Experiment
from barn_eval.experiments.provenance import provenance
from barn_eval.trials import identity
from barn_eval.trials.protocol import BUILT_IN
from barn_worlds.base.config import as_dict, from_dict
from barn_worlds.base.errors import ConfigError, shown
from barn_worlds.base.files import write_whole
from barn_worlds.base.text_files import read_json
from barn_worlds.robots.standard import other_name

RUN_FILE = "run.json"
SCHEMA_VERSION = 2


@dataclass(frozen=True, eq=False)
class RunFile:
    """What run.json says, as plain data in today's schema.

    worlds: checksums by number, empty where they were not kept. robot: SHA-256 of its URDF, empty likewise. sessions:
    oldest first.
    """

    path: Path
    experiment: Mapping[str, Any]
    worlds: Mapping[str, str] = field(default_factory=dict)
    robot: str = ""
    sessions: tuple[Mapping[str, Any], ...] = ()

    @classmethod
    def read(cls, folder: Path) -> RunFile:
        """Return what the folder's run.json says; ConfigError if it holds none that is known."""
        path = folder / RUN_FILE
        content = read_json(path)
        found = content if isinstance(content, dict) else {}
        version = found.get("schema_version")
        kinds = ("experiment",) if version == SCHEMA_VERSION else ("campaign", "plan") if version == 1 else ()
        kind = next((name for name in kinds if isinstance(found.get(name), dict)), "")
        if not kind:
            raise ConfigError(
                f"{path}: holds no experiment: schema_version must be {SCHEMA_VERSION} or 1, got {shown(version)}"
            )
        sessions = found.get("sessions", [found.get("provenance")])
        worlds = found.get("worlds")
        return cls(
            path,
            _UPGRADES[kind](found[kind]),
            worlds if isinstance(worlds, dict) else {},
            str(found.get("robot", "")),
            tuple(one for one in sessions if isinstance(one, dict)) if isinstance(sessions, list) else (),
        )

    @classmethod
    def of(cls, folder: Path, experiment: Experiment, worlds: Mapping[int, str]) -> RunFile:
        """Return what the folder of an experiment is to say, before its first session."""
        content = json.loads(json.dumps(as_dict(experiment)))
        checksums = {str(index): checksum for index, checksum in worlds.items()}
        return cls(folder / RUN_FILE, content, checksums, identity.robot(experiment.simulator.chassis))

    def configuration(self) -> Experiment:
        """Return the experiment; ConfigError if this version of the suite does not know its configuration."""
        return configuration(self.experiment, str(self.path))

    def task(self) -> dict[str, Any]:
        """Return what decides the task, with the defaults of keys that came later; ConfigError as `configuration`."""
        experiment = self.configuration()
        return identity.task(experiment.protocol, experiment.simulator, self.robot)

    def robot_name(self) -> str:
        """Return the name of the robot, empty for the standard one; ConfigError as `configuration`."""
        return other_name(self.configuration().simulator.chassis)

    def written_task(self) -> str:
        """Return the fingerprint of the task as it was written, which rows have that belong to it."""
        kept = {key: self.experiment.get(key) for key in ("protocol", "simulator")}
        return identity.fingerprint(kept | {"robot": self.robot})

    def require_same(self, other: RunFile) -> None:
        """Raise ConfigError naming the first key by which what is there differs from what is asked for now."""
        try:
            there = json.loads(json.dumps(as_dict(self.configuration())))  # with the defaults of keys that came later
        except ConfigError:
            there = self.experiment
        self._compare(there, other.experiment, "configuration")
        if self.worlds:
            self._compare(self.worlds, other.worlds, "checksum of world")
        if self.robot:
            self._compare({"robot": self.robot}, {"robot": other.robot}, "robot")

    def with_session(self, execution: Execution) -> RunFile:
        """Return the same with a session that begins now."""
        session = {"started_at": datetime.now(timezone.utc).isoformat(timespec="seconds")}
        return replace(self, sessions=(*self.sessions, session | {"execution": as_dict(execution)} | provenance()))

    def write(self) -> None:
        """Write run.json whole; StoreError if it cannot be written."""
        content = {
            "schema_version": SCHEMA_VERSION,
            "experiment": self.experiment,
            "worlds": self.worlds,
            "robot": self.robot,
            "sessions": self.sessions,
        }
        write_whole(self.path, (json.dumps(content, indent=1) + "\n").encode())

    def _compare(self, there: Mapping[str, Any], here: Mapping[str, Any], what: str) -> None:
        if (found := identity.first_difference(there, here)) is not None:
            key, *values = found
            text = [value if value == identity.MISSING else shown(value) for value in values]
            raise ConfigError(
                f"{self.path.parent}: holds results of another {what}: {key} is {text[0]} there, {text[1]} here;"
                " use another folder, or --overwrite"
            )


def configuration(content: Mapping[str, Any], where: str) -> Experiment:
    """Return the experiment of a run.json, keys that came later with their defaults; ConfigError as `from_dict`.

    The defaults of a built-in protocol are its own rules, not those of a protocol without a base.
    """
    rules = content.get("protocol")
    if isinstance(rules, dict) and (known := BUILT_IN.get(str(rules.get("name")))):
        content = {**content, "protocol": as_dict(known) | rules}
    return from_dict(Experiment, dict(content), where)


def _from_campaign(content: Mapping[str, Any]) -> dict[str, Any]:
    found = dict(content)
    command = found.pop("planner_command", "")
    planners = [one for one in _list(found.get("planners")) if isinstance(one, dict)]
    found["planners"] = [one | {"command": command, "source": ""} for one in planners]
    found["ros"] = {key: value for key, value in _mapping(found.get("ros")).items() if key != "bags"}
    return found


def _from_plan(content: Mapping[str, Any]) -> dict[str, Any]:
    found = dict(content)
    planner = {"name": found.pop("planner", ""), "preset": found.pop("preset", "")}
    planner |= {"overrides": found.pop("overrides", {}), "command": found.pop("planner_command", ""), "source": ""}
    ros = dict(_mapping(found.get("ros")))
    recorded = ros.pop("bags", "all")
    return found | {"planners": [planner], "bags": recorded if found.get("mode") == "ros" else "all", "ros": ros}


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


_UPGRADES: Mapping[str, Callable[[Mapping[str, Any]], Mapping[str, Any]]] = {
    "experiment": dict,
    "campaign": _from_campaign,
    "plan": _from_plan,
}
