"""The options of a run as Python, YAML files and the command line give them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias, TypedDict

from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.world import World

if TYPE_CHECKING:
    from barn_eval.running.planner_objects import Planners
    from barn_eval.trials.protocol import Protocol

Worlds: TypeAlias = (
    "str | int | World | Iterable[int] | Iterable[World] | Mapping[int, World]"
)
Parameters: TypeAlias = "Mapping[str, object]"


class RunKeywords(TypedDict, total=False):
    """Options of a run that `barn.run` takes by keyword.

    Most are fields of `RunConfig` or `ExecutionConfig`, which declare their defaults
    and allowed values. None stands for an option that is not given.
    """

    dataset: str | Path | None
    """Data set: a name, folder or file. Default: "barn300"."""

    robot: str | Path | Robot | None
    """Name, YAML file or object of the robot. Default: "jackal"."""

    course: Sequence[float] | Sequence[Sequence[float]] | None
    """Start x, y, yaw and goal x, y of every world [m, rad]; each of several courses
    becomes a world of the run. Default: the world's own course, else the protocol's."""

    routes: int | None
    """Number of routes to draw in each world from the seed; each is a world of the run.
    Default: 0, the world's own course."""

    repetitions: int | None
    """Trials per world and planner. Default: 1."""

    seed: int | None
    """Seed of all random numbers; equal seeds give equal trials. Default: 0."""

    settings: Parameters | None
    """Planner parameters, such as {"dwa": {"dwa.max_speed_mps": 0.4}}. With only one
    planner, its name can be left out."""

    compute: Literal["declared", "measured"] | None
    """Computing time that a trial charges: what the planner declares or what is
    measured. Default: "declared"."""

    simulator: Parameters | None
    """Simulator parameters by dotted name."""

    mode: Literal["direct", "ros"] | None
    """One process ("direct") or ROS 2 nodes ("ros"). Default: "direct"."""

    planner_command: str | Sequence[str] | None
    """Command that starts a planner of your own in mode ros, or several as
    "NAME=COMMAND"."""

    planner_package: str | Sequence[str] | None
    """Package of a planner of your own, started from its source in mode ros:
    "DIR:EXECUTABLE", or several as "NAME=DIR:EXECUTABLE"."""

    planner_input: str | Sequence[str] | None
    """Text for the standard input of such a planner, or several as "NAME=TEXT"."""

    ros: Parameters | None
    """Parameters of mode ros by dotted name."""

    bags: Literal["all", "failed", "none"] | None
    """Trials whose bag is kept. Default: "none"."""

    workers: int | None
    """Trials at a time; 0 is one per processor. Default: 0."""

    engine: Literal["local", "ray", "inline"] | None
    """Where trials run: worker processes on this machine ("local"), a Ray cluster
    ("ray") or the calling process ("inline"). Default: "local"."""

    address: str | None
    """Address of the Ray cluster. By default, Ray starts on this machine."""

    trial_limit_s: float | None
    """Wall-clock time after which a trial is given up [s]; 0 is no limit. Default:
    600."""

    attempts: int | None
    """Attempts at a trial whose worker dies or exceeds the limit. Default: 3."""

    losses: int | None
    """Trials lost in a row after which the run stops. Default: 20."""

    out: str | Path | None
    """Folder of the results. A run with the same folder resumes there. Default: a new
    folder under out/, named by the time."""


class RunOptions(RunKeywords, total=False):
    """All options of a run: `RunKeywords` and positional arguments of `barn.run`."""

    worlds: Worlds | None
    """World numbers, such as 3, [0, 60] or "0:300:60", or `World` objects."""

    planners: Planners | None
    """Planner names, `PlannerChoice` or Python objects."""

    protocol: str | Path | Protocol | None
    """Name, YAML file or object of the protocol. Default: "challenge"."""
