"""Read and write run.json: the configuration, worlds and sessions of a run."""

import json
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from functools import cached_property
from pathlib import Path
from typing import Any

from barn_eval.results.provenance import commit, provenance
from barn_eval.trials import identity
from barn_eval.trials.result import SCHEMA_VERSION, require_schema
from barn_eval.trials.run_config import ExecutionConfig, RunConfig
from barn_eval.trials.spec import TrialSpec
from barn_sim.config import chassis_in
from barn_worlds.base.config import as_dict, from_dict
from barn_worlds.base.errors import ConfigError, format_value
from barn_worlds.base.files import as_mapping, read_json, write_durably

# Describes a submission. An unpacked submission has commands instead of bags.
SUBMISSION_FILE = "submission.json"
# What a submission states and nobody can verify.
CLAIMED = (
    "versions, commit, machine and container",
    "sessions and wall-clock times",
    "measured computing",
    "who drove, except planners of the suite",
)

RUN_FILE = "run.json"
# As `barn_eval.results.provenance.commit` returns it. Messages show no other text.
_COMMIT = re.compile(r"[0-9a-f]{8,64}(\+changes)?")
WORLDS = "worlds.npz"  # of worlds that were given as Python objects
WORLDS_MANIFEST = "worlds.manifest.json"  # which is written with them


@dataclass(frozen=True, eq=False)
class RunFile:
    """The content of run.json, as plain data."""

    path: Path
    # A `RunConfig` as it was written, which this version may not be able to read.
    config: Mapping[str, Any]
    # Checksums of the worlds by their numbers, which are texts in JSON.
    worlds: Mapping[str, str] = field(default_factory=dict)
    robot: str = ""  # SHA-256 of its URDF
    # `identity.CODE_VERSIONS` of the suite that wrote it.
    code_versions: Mapping[str, Any] = field(default_factory=dict)
    sessions: tuple[Mapping[str, Any], ...] = ()  # oldest first
    schema_version: int = SCHEMA_VERSION

    @classmethod
    def read(cls, folder: Path) -> "RunFile":
        """Read a folder's run.json; ConfigError if there is none or it has no run."""
        path = folder / RUN_FILE
        content = as_mapping(read_json(path))
        config = as_mapping(content.get("experiment"))
        run_file = cls(
            path,
            config,
            as_mapping(content.get("worlds")),
            _robot_sha256(str(content.get("robot", "")), config),
            as_mapping(content.get("code_versions")),
            _read_sessions(content),
            content.get("schema_version", 0),
        )
        # Even a file of another schema may say which commit wrote it.
        try:
            require_schema(content, f"{path}: describes no run")
        except ConfigError as error:
            raise ConfigError(f"{error}{run_file.origin_note()}") from None
        if not config:
            raise ConfigError(f"{path}: describes no run: key experiment is missing")

        # The folder may have been moved since it was written.
        if config.get("dataset") == WORLDS and (folder / WORLDS).is_file():
            config["dataset"] = str((folder / WORLDS).absolute())
        return run_file

    @classmethod
    def for_run(
        cls, folder: Path, config: RunConfig, specs: Iterable[TrialSpec]
    ) -> "RunFile":
        """Return a new run's `RunFile`, without sessions; no file is written.

        Args:
            folder: Folder of the results.
            config: Configuration of the run.
            specs: Trials of the run.
        """
        # As read from the file, in which tuples are lists.
        plain_config = json.loads(json.dumps(as_dict(config)))
        worlds = {str(spec.world_number): spec.world.checksum for spec in specs}
        robot = identity.robot_sha256(config.simulator.chassis)
        path = folder / RUN_FILE
        return cls(path, plain_config, worlds, robot, identity.CODE_VERSIONS)

    def run_config(self) -> RunConfig:
        """Parse and return the configuration; ConfigError if it cannot be read."""
        try:
            return from_dict(RunConfig, dict(self.config), str(self.path))
        except ConfigError as error:
            raise ConfigError(f"{error}{self.origin_note()}") from None

    def task(self) -> dict[str, Any]:
        """Return the fingerprint's content, defaults added; ConfigError if unreadable.

        Raises:
            ConfigError: As in `run_config`.
        """
        config = as_dict(self.run_config())
        return identity.plain_task(config, self.robot, self.code_versions)

    @cached_property
    def task_fingerprint(self) -> str:
        """Task fingerprint of the data as written, which the folder's rows have."""
        content = identity.plain_task(self.config, self.robot, self.code_versions)
        return identity.fingerprint(content)

    def has_task(self, task: str) -> bool:
        """Tell whether a row's task is the folder's, or empty as in early rows."""
        if task in ("", self.task_fingerprint):
            return True
        # Earlier versions also hashed the name of a user's robot.
        simulator = self.config.get("simulator")
        robot = identity.named_robot_sha256(chassis_in(simulator))
        content = identity.plain_task(self.config, self.robot, self.code_versions)
        content |= {"simulator": simulator, "robot": robot}
        return task == identity.fingerprint(content)

    def origin_note(self) -> str:
        """Return " (written at COMMITS, this is COMMIT)", or "" if only this one wrote it."""
        current = commit()
        commits = dict.fromkeys(map(read_commit, self.sessions))
        if not commits or list(commits) == [current]:
            return ""
        names = " and ".join(map(shorten_commit, commits))
        return f" (written at {names}, this is {shorten_commit(current)})"

    def deciding_config(self) -> dict[str, Any]:
        """Return the plain configuration without values that do not affect results.

        These are the name of a user's robot and, in mode direct, `ros`.
        """
        config = dict(self.config)
        config["simulator"] = identity.without_own_name(config.get("simulator"))
        if config.get("mode") == "direct":
            # They are defaults, to which later versions add fields.
            config.pop("ros", None)
        return config

    def require_same_run(self, other: "RunFile") -> None:
        """Raise ConfigError if configuration, worlds, robot or code versions differ.

        The message names the first different key. Sessions may differ.
        """
        parts = (
            ("configuration", self.deciding_config(), other.deciding_config()),
            ("checksum of world", self.worlds, other.worlds),
            ("robot", {"robot": self.robot}, {"robot": other.robot}),
            ("version", self.code_versions, other.code_versions),
        )
        for what, content, other_content in parts:
            difference = identity.first_difference(content, other_content)
            if difference is None:
                continue
            key, *values = difference
            texts = []
            for value in values:
                is_missing = value == identity.NOT_SET
                texts.append(value if is_missing else format_value(value))
            raise ConfigError(
                f"{self.path.parent}: holds results of a different {what}: {key} is"
                f" {texts[0]} there, {texts[1]} here; use a different folder, or"
                f" --overwrite{self.origin_note()}"
            )

    def with_session(self, execution: ExecutionConfig, isolation: str) -> "RunFile":
        """Return a copy with a session that begins now; no file is written.

        Args:
            execution: How the session executes the run.
            isolation: What keeps planners' processes apart in a run over ROS.
        """
        now = datetime.now(timezone.utc)
        session: dict[str, Any] = {"started_at": now.isoformat(timespec="seconds")}
        if self.config.get("mode") == "ros":
            session["isolation"] = isolation
        session["execution"] = as_dict(execution)
        session |= provenance()
        return replace(self, sessions=(*self.sessions, session))

    def write(self) -> None:
        """Replace run.json atomically; StoreError if it cannot be written."""
        config = dict(self.config)
        # A relative name, so that the folder can be moved with its worlds.
        if config["dataset"] == str((self.path.parent / WORLDS).absolute()):
            config["dataset"] = WORLDS
        content = {
            "schema_version": SCHEMA_VERSION,
            "experiment": config,
            "worlds": self.worlds,
            "robot": self.robot,
            "code_versions": dict(self.code_versions),
            "sessions": self.sessions,
        }
        write_durably(self.path, (json.dumps(content, indent=1) + "\n").encode())


def _robot_sha256(robot: str, config: Mapping[str, Any]) -> str:
    """Return a stored robot's SHA-256, converted if an earlier version hashed its name."""
    # An unreadable configuration is refused where it is used.
    with suppress(ConfigError):
        chassis = chassis_in(config.get("simulator"))
        if robot == identity.named_robot_sha256(chassis):
            return identity.robot_sha256(chassis)
    return robot


def _read_sessions(content: Mapping[str, Any]) -> tuple[Mapping[str, Any], ...]:
    """Return the sessions in run.json's content; entries that are no mapping are left out."""
    sessions = content.get("sessions")
    if not isinstance(sessions, list):
        return ()
    return tuple(session for session in sessions if isinstance(session, dict))


def read_commit(session: Mapping[str, Any]) -> str:
    """Return the commit in a session, or "" if it is missing or not a commit."""
    revision = str(session.get("commit", ""))
    return revision if _COMMIT.fullmatch(revision) else ""


def shorten_commit(revision: str) -> str:
    """Return the first 8 digits of a commit with any "+changes", or "an unknown commit"."""
    sha, plus, changes = revision.partition("+")
    return f"{sha[:8]}{plus}{changes}" if sha else "an unknown commit"
