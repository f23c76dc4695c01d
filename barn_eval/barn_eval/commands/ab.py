"""`barn ab`: is HEAD better than BASE, driven until that is clear."""

from pathlib import Path
from typing import Any

import click

from barn_eval.commands.options import (
    FOLDER,
    json_option,
    print_json,
    print_notes,
    reporter,
    run_option,
)
from barn_eval.studies.ab import ab
from barn_worlds.base.config import as_dict

WORSE = 4  # the exit code


@click.command("ab")
@click.argument("base")
@click.argument("head")
@click.option(
    "--planner-command",
    default="",
    show_default=False,
    help="Starts the planner of a workspace or a file.",
)
@click.option(
    "--worlds", default="0:300:3", help="Which, at most; it stops earlier where it can."
)
@run_option
@click.option(
    "--out",
    default="out/ab",
    type=FOLDER,
    help="Folder of all that was driven, kept for next time.",
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
    """Drive BASE and HEAD through the same worlds until one is clearly better, or neither would hardly become so.

    Each is a workspace (its folder or setup.bash) or a file of ROS parameters, for --planner-command; a planner of the
    suite with settings, such as dwa,dwa.path_weight=0.6; a file as for barn run; or a command. What has not changed
    since is not driven again. Prints Markdown for a pull request. Exit code 4 if HEAD is worse.
    """
    found = ab(
        base, head, planner_command, {"worlds": worlds, "out": out} | run, reporter
    )
    if as_json:
        folders = dict(zip(("base", "head"), map(str, found.folders), strict=True))
        counts = {
            "decision": found.decision,
            "worlds": found.worlds,
            "planned": found.planned,
        }
        print_json(
            counts
            | folders
            | {"comparison": as_dict(found.comparison), "markdown": found.markdown()}
        )
    else:
        click.echo(found.markdown())
    print_notes("BASE in {}, HEAD in {}".format(*found.folders))
    return WORSE if found.decision == "worse" else 0
