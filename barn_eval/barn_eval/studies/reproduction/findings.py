"""What a reproduction consists of and all that it has found, as plain data: page and figures come from it alone."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from barn_eval.experiments.run_file import provenance
from barn_eval.studies.reproduction.paper import REPETITIONS
from barn_eval.studies.reproduction.trials import MetricsFinding, TrialsFinding
from barn_metrics.model.evaluation import Evaluation
from barn_worlds.base.config import Checked, as_dict, from_dict, quantity
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.text_files import finite, read_json

SCHEMA_VERSION = 4


@dataclass(frozen=True)
class ReproduceConfig(Checked):
    """What decides the outcome.

    strata: the worlds, in the order of the data set, are cut into so many parts, one drawn from each; 0 takes all.
    """

    dataset: str = quantity("barn300", "data set: a name, folder or file")
    strata: int = quantity(0, "parts of the order of which one world each is taken, 0 for all", "", 0, 10_000)
    repetitions: int = quantity(REPETITIONS, "trials per world and planner", "", 2, 99)
    seed: int = quantity(0, "all randomness comes from it", "", 0, 2**31)
    folds: int = quantity(10, "parts that held-out worlds are taken in", "", 2, 100)
    repeats: int = quantity(5, "how often they are drawn anew", "", 1, 100)


QUICK = ReproduceConfig(strata=40, folds=5, repeats=1)


@dataclass(frozen=True)
class Scope:
    """What was run.

    dataset_worlds: number of worlds of the data set; worlds: number of those with trials.
    """

    config: ReproduceConfig
    dataset_checksum: str
    dataset_worlds: int
    worlds: int
    protocol: str


@dataclass(frozen=True)
class Findings:
    """The outcome of a reproduction; equal configurations and code give equal findings, bit for bit."""

    scope: Scope
    metrics: MetricsFinding
    trials: TrialsFinding
    learning: Evaluation
    schema_version: int = SCHEMA_VERSION


@dataclass(frozen=True)
class Origin:
    """Commits, versions and machines of all sessions of the campaign and of this analysis, each named once."""

    commits: tuple[str, ...]
    versions: tuple[dict[str, str], ...]
    machines: tuple[dict[str, Any], ...]

    @classmethod
    def of(cls, earlier: Iterable[Mapping[str, Any]]) -> Origin:
        """Return what the sessions of a campaign and this process have been made with."""
        sessions = [*earlier, provenance()]
        return cls(
            tuple(dict.fromkeys(str(session["commit"] or "not known") for session in sessions)),
            _distinct(session["versions"] for session in sessions),
            _distinct(session["machine"] for session in sessions),
        )


def to_json(found: Findings | Origin) -> str:
    """Return findings, or their origin, as JSON; numbers that JSON does not have become null."""
    return json.dumps(finite(as_dict(found)), indent=1, allow_nan=False) + "\n"


def read_findings(path: Path) -> Findings:
    """Return the findings of a file that `to_json` made; ConfigError in one line if it is none."""
    content = read_json(path)
    version = content.get("schema_version") if isinstance(content, dict) else None
    if version != SCHEMA_VERSION:
        raise ConfigError(f"{path}: schema_version must be {SCHEMA_VERSION}, got {version!r}")
    return from_dict(Findings, content, str(path))


def _distinct(entries: Iterable[dict[str, Any]]) -> tuple[dict[str, Any], ...]:
    return tuple({json.dumps(entry, sort_keys=True): entry for entry in entries}.values())
