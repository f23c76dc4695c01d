"""`barn ab`: drive BASE and HEAD until it is clear which one is better."""

from pathlib import Path
from typing import Any

import click

from barn_eval.commands.options import (
    PLANNER,
    folder_option,
    json_option,
    print_json,
    print_notes,
    reporter,
    run_option,
)
from barn_eval.studies.ab import ab
from barn_eval.trials.result import exit_code
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import ExitCode


@click.command("ab")
@click.argument("base", type=PLANNER)
@click.argument("head", type=PLANNER)
@click.option(
    "--planner-command",
    default="",
    show_default=False,
    help="Command that starts the planner of a workspace or parameter file.",
)
@click.option(
    "--worlds",
    default="0:300:3",
    help="Worlds to use at most. The comparison stops once its result is clear.",
)
@run_option
@folder_option(
    "--out",
    default="out/ab",
    help="Folder for all trials. The next comparison reuses them.",
)
@json_option
def command(
    base: str,
    head: str,
    planner_command: str,
    worlds: str,
    run: dict[str, Any],
    out: Path,
    as_json: bool,
) -> int:
    """Compare BASE and HEAD in the same worlds; stop once one is significantly better or a difference is unlikely.

    BASE and HEAD can be planners of the suite with settings, such as
    dwa,dwa.path_weight=0.6, files for barn run, or commands. With --planner-command,
    they can also be workspaces (a folder or its setup.bash) or ROS parameter files. A
    version that has not changed is not run again. The output is Markdown for a pull
    request. The exit code is 4 if HEAD is worse.
    """
    # --run may name the same keys as the options; it overrides them.
    options = {"worlds": worlds, "out": out} | run
    result = ab(base, head, planner_command, options, reporter)
    base_folder, head_folder = result.folders
    if as_json:
        print_json(
            {
                "decision": result.decision,
                "worlds": result.worlds,
                "planned": result.planned,
                "base": str(base_folder),
                "head": str(head_folder),
                "comparison": as_dict(result.comparison),
                "markdown": result.markdown(),
            }
        )
    else:
        click.echo(result.markdown())
    # To standard error, so that a job can post the output as it is.
    print_notes(f"BASE in {base_folder}, HEAD in {head_folder}")
    if result.decision == "worse":
        return ExitCode.WORSE
    return exit_code(result.results)
