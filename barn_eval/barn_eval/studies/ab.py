"""A/B tests: drive HEAD and BASE until it is clear whether HEAD is better.

Each side is a build, a command or a setting of a planner.
"""

import shlex
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from shutil import which
from typing import Any

from barn_eval.analysis.compare import Comparison, compare, trial_values
from barn_eval.analysis.entries import read_entries
from barn_eval.analysis.measures import MEASURES, SHOWN, ranking_measure
from barn_eval.analysis.notes import find_mixture
from barn_eval.analysis.sequential import Decision, decide, plan_looks
from barn_eval.analysis.verdict import list_cautions
from barn_eval.pages.template import render
from barn_eval.results.folder import order_worlds_fairly
from barn_eval.results.provenance import SUITE
from barn_eval.ros.work import require_ros, work_of
from barn_eval.running.command_files import hash_command_files, hash_folder
from barn_eval.running.planner_choices import parse_planner_command, split_command
from barn_eval.running.reporting import Reporter
from barn_eval.running.request import RunRequest, parse_parameters, read_request
from barn_eval.running.run import make_shared_pool, open_run
from barn_eval.trials import identity
from barn_eval.trials.result import Rows
from barn_eval.trials.run_config import PlannerChoice
from barn_planners.registry import planner_entry, planner_names
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import ConfigError, format_value

_SETUP_FILES = ("install/setup.bash", "setup.bash", "local_setup.bash")
_DECISIONS = {
    "better": "HEAD is better than BASE",
    "worse": "HEAD is worse than BASE",
    "futile": "no difference is significant, and the planned worlds are unlikely to show one",
    "open": "no difference is significant",
}


@dataclass(frozen=True)
class AbResult:
    """The decision between HEAD and BASE, with the trials that led to it."""

    # HEAD is "better" or "worse". "futile": stopped because neither is likely to be
    # shown. "open": all planned worlds were driven without a decision.
    decision: Decision
    # Number of worlds that were driven, and planned.
    worlds: int
    planned: int
    # BASE and HEAD as the user typed them, and their folders, named by content.
    sides: tuple[str, str]
    folders: tuple[Path, Path]
    # HEAD (a) compared with BASE (b).
    comparison: Comparison
    # Scored rows of both.
    results: Rows

    def markdown(self) -> str:
        """Return the result as Markdown for a pull request."""
        return render("ab.md", result=self, measures=MEASURES, decisions=_DECISIONS)


def ab(
    base: str,
    head: str,
    command: str,
    options: Mapping[str, object],
    reporter: Reporter,
) -> AbResult:
    """Drive BASE and HEAD until a sequential test decides; ConfigError if equal.

    Args:
        base: A workspace (its folder or setup.bash) in which `command` starts the
            planner; a file of ROS parameters that override those of `command`; a file
            as for `barn run`; a planner of the suite with parameters, such as
            "dwa,dwa.path_weight=0.6"; or a command.
        head: The other side, likewise.
        command: Starts the planner of a workspace or parameter file; may be empty.
        options: Options of the runs, as `read_request` takes them. Each side has its
            own folder below `out`.
        reporter: Receives notices and progress.

    Returns:
        The decision and the comparison.

    Raises:
        BarnError: If an option or a side is wrong, or a trial fails through no fault of
            its planner.
    """
    sides = [read_side(text, base, command, options) for text in (base, head)]
    configs = [side.config for side in sides]
    # No test can separate equal sides.
    fingerprints = {
        config.resolve_planner(config.planners[0]).planner_config for config in configs
    }
    if len(fingerprints) == 1:
        raise ConfigError(
            f"BASE and HEAD are the same, {format_value(base)}: their settings and files"
            " do not differ"
        )

    # The first look would mislead if its worlds were not like the rest.
    worlds = order_worlds_fairly(spec.world_number for spec in sides[0].trials())
    looks = plan_looks(len(worlds))
    with ExitStack() as stack:
        pool = stack.enter_context(make_shared_pool(*sides))
        for config in configs:
            require_ros(config, reporter)
        base_run, head_run = (
            stack.enter_context(open_run(side, reporter, work_of, pool=pool))
            for side in sides
        )
        for look in looks:
            base_results = base_run.drive_scored(worlds[:look])
            head_results = head_run.drive_scored(worlds[:look])
            measure = ranking_measure(base_results)
            decision = decide(
                trial_values(base_results, measure),
                trial_values(head_results, measure),
                worlds,
                looks,
                larger_is_better=measure.better == "larger",
            ).decision
            if decision != "continue":
                break

    base_entry, head_entry = read_entries([side.out for side in sides])
    entries = [replace(base_entry, label="BASE"), replace(head_entry, label="HEAD")]
    comparison = compare(head_results, base_results, "HEAD", "BASE", SHOWN["ab"])
    return AbResult(
        decision,
        look,
        len(worlds),
        (base, head),
        (sides[0].out, sides[1].out),
        replace(comparison, notes=(*list_cautions(look), *find_mixture(entries))),
        [*base_results, *head_results],
    )


def read_side(
    text: str, base: str, command: str, options: Mapping[str, object]
) -> RunRequest:
    """Return a side's run, in a folder named after its content; ConfigError if no side.

    Args:
        text: The side, as `ab` takes it.
        base: Text of BASE. A planner that a command starts is named after BASE on both
            sides, so that their seeds are equal.
        command: Starts the planner of a workspace or parameter file.
        options: Options of the run.

    Raises:
        ConfigError: If the text is not a side, or names several planners.
    """
    planner_name = ""
    if command:
        planner_name, command = parse_planner_command(command)
    path = Path(text)
    side_options = _side_options(text, command)
    run_options: dict[str, Any] = {**options, **side_options}
    # Only a file for `barn run` gives no options.
    run_file = None if side_options else path
    side_command = run_options.get("planner_command")
    if side_command:
        planner_name = planner_name or parse_planner_command(base)[0]
        run_options["planner_command"] = f"{planner_name}={side_command}"
        run_options.setdefault("mode", "ros")
        run_file = None

    request = read_request(run_file, run_options)
    planner, *others = request.config.planners
    if others:
        count = 1 + len(others)
        raise ConfigError(f"{format_value(text)}: must name one planner, got {count}")
    if _is_workspace(path):
        # The command alone does not determine the content of a workspace.
        folder = _find_setup(path, command).parent
        files = hash_command_files(split_command(command))
        files = {str(folder): hash_folder(folder)} | files
        planners = (replace(planner, files=files),)
        request = replace(request, config=replace(request.config, planners=planners))
    # The folder's name, PLANNER_HASH, changes with anything that may matter: the
    # configuration and, for registered planners, their code.
    planner = request.config.planners[0]
    content = {
        "experiment": as_dict(request.config),
        "code": _hash_code(planner) if planner.registered else {},
    }
    name = f"{planner.name}_{identity.fingerprint(content)}"
    return replace(request, out=request.out / name)


def _side_options(text: str, command: str) -> dict[str, Any]:
    """Return a side's own options of a run, {} for a YAML file; ConfigError if no side.

    Args:
        text: The side, as `ab` takes it.
        command: Starts the planner of a workspace or parameter file; may be empty.
    """
    path = Path(text)
    is_yaml = path.suffix in (".yaml", ".yml")
    name, *parameters = text.split(",")
    if _is_workspace(path):
        return {"planner_command": _in_workspace(_find_setup(path, command), command)}
    if is_yaml and command:
        return {"planner_command": _with_parameter_file(command, path)}
    if name.partition(":")[0] in planner_names():
        settings = parse_parameters(parameters, format_value(text))
        return {"planners": name, "settings": settings}
    if is_yaml:
        return {}
    if which(split_command(text)[0]) is not None:
        return {"planner_command": text}
    raise ConfigError(
        f"{format_value(text)}: is not a workspace, file, planner of the suite or command"
    )


def _is_workspace(path: Path) -> bool:
    """Tell whether a path is a folder or a setup file."""
    return path.is_dir() or (path.is_file() and path.suffix in (".bash", ".sh"))


def _find_setup(path: Path, command: str) -> Path:
    """Return a workspace's absolute setup file; ConfigError without file or command."""
    for file in (path, *(path / name for name in _SETUP_FILES)):
        if file.is_file():
            if not command:
                raise ConfigError(f"{path}: a workspace needs --planner-command")
            return file.resolve()
    raise ConfigError(f"{path}: no setup.bash")


def _in_workspace(setup: Path, command: str) -> str:
    """Return a `bash -c` command that sources `setup` and then executes `command`."""
    words = shlex.join(split_command(command))
    # exec, so that signals reach the planner and not a shell around it.
    script = f". {shlex.quote(str(setup))} && exec {words}"
    return shlex.join(["bash", "-c", script])


def _with_parameter_file(command: str, file: Path) -> str:
    """Return a command with `--params-file FILE` appended, which overrides its files."""
    words = split_command(command)
    if "--ros-args" not in words:
        words.append("--ros-args")
    return shlex.join([*words, "--params-file", str(file.resolve())])


def _hash_code(planner: PlannerChoice) -> dict[str, str]:
    """Return a hash of the code by package: the suite's packages and the planner's."""
    config_module = planner_entry(planner.entry_name).config_class.__module__
    hashes = {}
    for name in sorted({*SUITE, config_module.partition(".")[0]}):
        spec = find_spec(name)
        if spec is not None and spec.origin:
            hashes[name] = hash_folder(Path(spec.origin).parent)
    return hashes
