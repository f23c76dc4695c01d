"""Is HEAD better than BASE: builds, commands or settings of a planner, driven world by world until that is clear."""

import shlex
from collections.abc import Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from shutil import which
from typing import Any

from barn_eval.analysis.compare import Comparison, compare, trial_values
from barn_eval.analysis.measures import MEASURES, ranking_measure
from barn_eval.analysis.sequential import Decision, decide, plan_looks
from barn_eval.analysis.text_table import count_noun
from barn_eval.results.folder import order_worlds_fairly
from barn_eval.results.provenance import SUITE
from barn_eval.ros.work import require_ros, work_of
from barn_eval.running.command_files import hash_command_files, hash_folder
from barn_eval.running.planner_choices import parse_planner_command, split_command
from barn_eval.running.reporting import Reporter
from barn_eval.running.request import RunRequest, parse_parameters, read_request
from barn_eval.running.run import make_shared_pool, open_run
from barn_eval.trials import identity
from barn_eval.trials.run_config import PlannerChoice
from barn_planners.registry import planner_entry, planner_names
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import ConfigError, format_value
from barn_worlds.base.text_files import markdown_table

_SHOWN = ("success", "traversal_time_s", "min_clearance_m", "compute_p95_ms")
_SETUPS = ("install/setup.bash", "setup.bash", "local_setup.bash")
_WORDS = {
    "better": "HEAD is better than BASE",
    "worse": "HEAD is worse than BASE",
    "futile": "no difference is clear, and none would hardly become so",
    "open": "no difference is clear",
}


@dataclass(frozen=True)
class AbResult:
    """What trials say of HEAD against BASE.

    decision: HEAD is "better" or "worse"; "futile": it was stopped, as neither would hardly come out any more; "open":
    the plan was driven to its end. worlds: that it took, of those planned. given: BASE and HEAD. folders: of each, that
    its content names. comparison: HEAD (a) with BASE (b).
    """

    decision: Decision
    worlds: int
    planned: int
    given: tuple[str, str]
    folders: tuple[Path, Path]
    comparison: Comparison

    def markdown(self) -> str:
        """Return it as a comment on a pull request."""
        found = self.comparison
        metric, digits = MEASURES[found.metric], MEASURES[found.metric].digits
        row = found.row(metric.key).paired
        percent = (
            f" or {row.difference.estimate / row.mean_b:+.1%}" if row.mean_b else ""
        )
        head = (
            f"**{_WORDS[self.decision]}**, by the {metric.title}: {metric.number(row.mean_a)} against"
            f" {metric.number(row.mean_b)}, a difference of {row.difference.text(digits)}{percent}, after"
            f" {self.worlds} of {count_noun(self.planned, 'world')}."
        )
        rows = [
            (
                one.heading,
                one.number(pair.mean_b),
                one.number(pair.mean_a),
                one.text(pair.difference),
            )
            for one, pair in ((MEASURES[row.key], row.paired) for row in found.rows)
        ]
        table = markdown_table(
            ("mean", "BASE", "HEAD", "HEAD - BASE and its 95 % interval"), rows
        )
        about = (
            f"BASE: `{self.given[0]}`, HEAD: `{self.given[1]}`; {count_noun(row.trials, 'pair')} of trials, protocol"
            f" {found.protocol}, task {found.task}. Looked at after each fifth of the worlds, with 5 % false alarms"
            " over all looks; intervals are those of a single look."
        )
        return "\n\n".join((head, table.rstrip("\n"), about))


def ab(
    base: str,
    head: str,
    command: str,
    options: Mapping[str, object],
    reporter: Reporter,
) -> AbResult:
    """Drive both sides in as many worlds as a verdict takes, each in a folder of its own below `options["out"]`.

    base, head: each a workspace (its folder or setup.bash) in which `command` starts the planner; a file of ROS
    parameters that count most for `command`; a file as for `barn run`; a planner of the suite with settings, as
    "dwa,dwa.path_weight=0.6"; or a command. options: as of `read_request`. Raises BarnError for what is not possible,
    also if a trial fails by no fault of the planner.
    """
    sides = _side(base, base, command, options), _side(head, base, command, options)
    experiments = [one.config for one in sides]
    if (
        len({one.resolve_planner(one.planners[0]).fingerprint for one in experiments})
        == 1
    ):
        raise ConfigError(
            f"BASE and HEAD are the same, {format_value(base)}: neither settings nor files differ"
        )
    worlds = order_worlds_fairly(spec.world_number for spec in sides[0].trials())
    looks = plan_looks(len(worlds))
    with ExitStack() as kept:
        direct = all(one.mode == "direct" for one in experiments)
        engine = (
            kept.enter_context(closing(make_shared_pool(sides[0].execution)))
            if direct
            else None
        )
        for experiment in experiments:
            require_ros(experiment, reporter)
        runs = [
            kept.enter_context(open_run(one, reporter, work_of, pool=engine))
            for one in sides
        ]
        for look in looks:
            of_base, of_head = (run.drive_scored(worlds[:look]) for run in runs)
            metric = ranking_measure(of_base)
            a, b = (trial_values(one, metric) for one in (of_base, of_head))
            found = decide(
                a, b, worlds, looks, larger_is_better=metric.better == "larger"
            ).decision
            if found != "continue":
                break
    compared = compare(of_head, of_base, "HEAD", "BASE", _SHOWN)
    return AbResult(
        found, look, len(worlds), (base, head), (sides[0].out, sides[1].out), compared
    )


def _side(
    text: str, base: str, command: str, options: Mapping[str, object]
) -> RunRequest:
    """Return what a text stands for; ConfigError if that is nothing."""
    path, settings, asked, files = Path(text), {}, dict[str, Any](options), {}
    name, *changes = text.split(",")
    label, command = parse_planner_command(command) if command else ("", "")
    if path.is_dir() or (path.is_file() and path.suffix in (".bash", ".sh")):
        setup = next(
            (one for one in (path, *map(path.joinpath, _SETUPS)) if one.is_file()), None
        )
        if setup is None or not command:
            raise ConfigError(
                f"{path}: {'a workspace needs --planner-command' if setup else 'has no setup.bash'}"
            )
        inner = f". {shlex.quote(str(setup.resolve()))} && exec {shlex.join(split_command(command))}"
        files = {str(setup.resolve().parent): hash_folder(setup.resolve().parent)}
        asked["planner_command"] = shlex.join(["bash", "-c", inner])
    elif path.suffix in (".yaml", ".yml") and command:
        words = split_command(command)
        words += [] if "--ros-args" in words else ["--ros-args"]
        asked["planner_command"] = shlex.join(
            [*words, "--params-file", str(path.resolve())]
        )
    elif name.partition(":")[0] in planner_names():
        asked["planners"] = name
        settings = parse_parameters(changes, format_value(text))
    elif path.suffix not in (".yaml", ".yml"):
        if which(split_command(text)[0]) is None:
            raise ConfigError(
                f"{format_value(text)}: is no workspace, file, planner of the suite or command"
            )
        asked["planner_command"] = text
    if started := asked.get("planner_command"):
        asked = (
            {"mode": "ros"}
            | asked
            | {
                "planner_command": f"{label or parse_planner_command(base)[0]}={started}"
            }
        )
    request = read_request(
        path if path.suffix in (".yaml", ".yml") and not started else None,
        asked | {"settings": settings},
    )
    planner, *others = request.config.planners
    if others:
        raise ConfigError(
            f"{format_value(text)}: must be one planner, got {1 + len(others)}"
        )
    if files:
        planner = replace(
            planner, files=files | hash_command_files(split_command(command))
        )
        request = replace(request, config=replace(request.config, planners=(planner,)))
    experiment = request.config
    code = _code(planner) if planner.registered else {}
    out = (
        request.out
        / f"{planner.name}_{identity.fingerprint({'experiment': as_dict(experiment), 'code': code})}"
    )
    return replace(request, out=out)


def _code(planner: PlannerChoice) -> dict[str, str]:
    """Return digests of the code that drives a planner of the suite: the suite's own and that of its package."""
    names = sorted(
        {*SUITE, planner_entry(planner.name).config_class.__module__.partition(".")[0]}
    )
    return {
        one.name: hash_folder(Path(one.origin).parent)
        for one in map(find_spec, names)
        if one and one.origin
    }
