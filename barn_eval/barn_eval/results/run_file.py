"""run.json: what a folder of results holds, and what it was made with."""

import json
import os
import platform
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from barn_eval.trials import identity
from barn_eval.trials.run_config import Execution, Experiment
from barn_worlds import __version__
from barn_worlds.base.config import as_dict, from_dict
from barn_worlds.base.errors import ConfigError, format_value
from barn_worlds.base.files import write_durably
from barn_worlds.base.text_files import read_json
from barn_worlds.robots.files import other_name

SUITE = ("barn_worlds", "barn_sim", "barn_planners", "barn_metrics", "barn_eval")
LIBRARIES = ("numpy", "numba", "scipy", "pybullet", "mcap", "rosbags", "rclpy")


def versions() -> dict[str, str]:
    """Return the version of Python, of the suite's packages and of the libraries that decide results."""
    suite = dict.fromkeys(SUITE, __version__)
    return {"python": platform.python_version(), **suite} | {
        name: _version(name) for name in LIBRARIES
    }


def commit() -> str:
    """Return the commit of the source tree, "+changes" added where files differ from it; empty if not known.

    A wheel and an archive of the source have it in a file (build_backend.py).
    """
    built = Path(__file__).parents[1] / "data" / "commit"
    return commit_of(Path(__file__).parent) or (
        built.read_text("utf-8").strip() if built.exists() else ""
    )


def commit_of(folder: Path) -> str:
    """Return the commit of the repository around a folder; empty if that is not this suite's."""
    if not _git(folder, "ls-files", ":(top,glob)**/barn_eval/package.xml"):
        return ""
    changes = _git(folder, "status", "--porcelain", "--untracked-files=no")
    return _git(folder, "rev-parse", "HEAD") + ("+changes" if changes else "")


def machine() -> dict[str, Any]:
    """Return what wall-clock figures depend on."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": platform.platform(),
    }


def ros_problem() -> str:
    """Return why there is no ROS for this Python, empty if there is: not installed, or that of another Python."""
    spec = find_spec("rclpy")
    if spec is None or not spec.submodule_search_locations:
        return "rclpy is not installed"
    (folder, *_) = map(Path, spec.submodule_search_locations)
    built = sorted(
        path.name.partition(".")[2] for path in folder.glob("_rclpy_pybind11.*")
    )
    if not built or any(f".{ending}" in EXTENSION_SUFFIXES for ending in built):
        return ""
    return f"rclpy of {folder} is of another Python ({', '.join(built)}); this is {platform.python_version()}"


@cache
def isolation() -> str:
    """Return what keeps a planner's processes over ROS from the suite's, or why nothing does.

    "apart": in namespaces of their own they neither see nor signal these; "visible": they only see them.
    """
    script = Path(__file__).parents[1] / "ros" / "supervision" / "guard.py"
    asked = subprocess.run(  # noqa: S603
        [sys.executable, "-I", "-S", str(script), "probe"],
        capture_output=True,
        text=True,
        check=False,
    )
    return asked.stdout.strip() or "cannot be asked"


def isolated() -> bool:
    """Tell whether no planner over ROS can signal the suite's processes."""
    return isolation() in ("apart", "visible")


def provenance() -> dict[str, Any]:
    """Return versions, commit and machine."""
    return {"versions": versions(), "commit": commit(), "machine": machine()}


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def _git(folder: Path, *arguments: str) -> str:
    try:
        done = subprocess.run(  # noqa: S603
            ["git", "--no-optional-locks", "-C", str(folder), *arguments],  # noqa: S607
            capture_output=True,
            text=True,
            timeout=10,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next(
        (
            line.split(":", 1)[1].strip()
            for line in lines
            if line.startswith("model name")
        ),
        platform.machine(),
    )


RUN_FILE = "run.json"
WORLDS = "worlds.npz"  # of worlds that were given as Python objects
SCHEMA_VERSION = 2


@dataclass(frozen=True, eq=False)
class RunFile:
    """What run.json says, as plain data."""

    path: Path
    experiment: Mapping[str, Any]
    worlds: Mapping[str, str] = field(default_factory=dict)  # checksums by number
    robot: str = ""  # SHA-256 of its URDF
    sessions: tuple[Mapping[str, Any], ...] = ()  # oldest first

    @classmethod
    def read(cls, folder: Path) -> "RunFile":
        """Return what the folder's run.json says; ConfigError if it holds none that is known."""
        path = folder / RUN_FILE
        content = read_json(path)
        found = content if isinstance(content, dict) else {}
        experiment, worlds, sessions = (
            found.get(key) for key in ("experiment", "worlds", "sessions")
        )
        if found.get("schema_version") != SCHEMA_VERSION or not isinstance(
            experiment, dict
        ):
            got = format_value(found.get("schema_version"))
            raise ConfigError(
                f"{path}: holds no experiment: schema_version must be {SCHEMA_VERSION}, got {got}"
            )
        if experiment.get("dataset") == WORLDS and (folder / WORLDS).is_file():
            experiment |= {"dataset": str((folder / WORLDS).absolute())}
        worlds, sessions = (
            worlds if isinstance(worlds, dict) else {},
            sessions if isinstance(sessions, list) else [],
        )
        sessions = tuple(one for one in sessions if isinstance(one, dict))
        return cls(path, experiment, worlds, str(found.get("robot", "")), sessions)

    @classmethod
    def of(
        cls, folder: Path, experiment: Experiment, worlds: Mapping[int, str]
    ) -> "RunFile":
        """Return what the folder of an experiment is to say, before its first session."""
        content = json.loads(json.dumps(as_dict(experiment)))
        checksums = {str(index): checksum for index, checksum in worlds.items()}
        return cls(
            folder / RUN_FILE,
            content,
            checksums,
            identity.robot(experiment.simulator.chassis),
        )

    def configuration(self) -> Experiment:
        """Return the experiment; ConfigError if its configuration is none."""
        return from_dict(Experiment, dict(self.experiment), str(self.path))

    def task(self) -> dict[str, Any]:
        """Return what decides the task; ConfigError as `configuration`."""
        experiment = self.configuration()
        return identity.task(experiment.protocol, experiment.simulator, self.robot)

    def robot_name(self) -> str:
        """Return the name of the robot, empty for the standard one; ConfigError as `configuration`."""
        return other_name(self.configuration().simulator.chassis)

    def written_task(self) -> str:
        """Return the fingerprint of the task as it was written, which rows have that belong to it."""
        kept = {key: self.experiment.get(key) for key in ("protocol", "simulator")}
        return identity.fingerprint(kept | {"robot": self.robot})

    def require_same(self, other: "RunFile") -> None:
        """Raise ConfigError naming the first key by which what is there differs from what is asked for now."""
        for key, what in (
            ("experiment", "configuration"),
            ("worlds", "checksum of world"),
            ("robot", "robot"),
        ):
            there, here = ({key: getattr(one, key)} for one in (self, other))
            if (found := identity.first_difference(there, here)) is not None:
                name, *values = found
                text = [
                    value if value == identity.MISSING else format_value(value)
                    for value in values
                ]
                told = (
                    f"{name.removeprefix(f'{key}.')} is {text[0]} there, {text[1]} here"
                )
                told += "; use another folder, or --overwrite"
                raise ConfigError(
                    f"{self.path.parent}: holds results of another {what}: {told}"
                )

    def with_session(self, execution: Execution) -> "RunFile":
        """Return the same with a session that begins now."""
        session = {
            "started_at": datetime.now(timezone.utc).isoformat(timespec="seconds")
        }
        if self.experiment.get("mode") == "ros":
            session["isolation"] = (
                isolation() if self.experiment["ros"]["isolate"] else "not asked for"
            )
        return replace(
            self,
            sessions=(
                *self.sessions,
                session | {"execution": as_dict(execution)} | provenance(),
            ),
        )

    def write(self) -> None:
        """Write run.json whole; StoreError if it cannot be written."""
        kept = self.experiment["dataset"] == str((self.path.parent / WORLDS).absolute())
        experiment = {**self.experiment, "dataset": WORLDS} if kept else self.experiment
        content = {
            "schema_version": SCHEMA_VERSION,
            "experiment": experiment,
            "worlds": self.worlds,
        }
        content |= {"robot": self.robot, "sessions": self.sessions}
        write_durably(self.path, (json.dumps(content, indent=1) + "\n").encode())
