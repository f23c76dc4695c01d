"""`barn try`: try a planner of your own for ten seconds."""

from __future__ import annotations

import shlex
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from barn_eval.commands.options import (
    console,
    json_option,
    print_json,
    print_notes,
    reporter,
)
from barn_eval.commands.tables import table
from barn_eval.ros.work import require_ros
from barn_eval.running.request import RunRequest, read_request
from barn_worlds.base.errors import ExitCode

if TYPE_CHECKING:
    from barn_eval.ros.attempt import Attempt


@click.command("try")
@click.argument("planner_command", required=False, metavar="[COMMAND]")
@click.option(
    "--planner-package",
    metavar="DIR[:EXECUTABLE] [ARGUMENT]...",
    help="Start the planner from the source of its ROS package instead.",
)
@click.option(
    "--planner-input",
    metavar="TEXT",
    help="Text for the planner's standard input. {goal_x}, {goal_y}, {goal_yaw} and"
    " {frame} are replaced by the goal, here and in COMMAND.",
)
@json_option
def command(as_json: bool, **planner: str | None) -> int:
    """Start a planner beside a simulator and report what prevents trials.

    COMMAND starts the planner, as in `barn run --planner-command`. The test takes ten
    seconds and checks the modules that the planner imports, its topics and its first
    commands. The last line of output is the `barn run` command to type. The exit code
    is 3 if the planner sends no command.
    """
    options = {"mode": "ros", "worlds": "0", **planner}
    if not any((planner["planner_command"], planner["planner_package"])):
        raise click.UsageError("give a COMMAND or --planner-package")
    request = read_request(None, options)
    require_ros(request.config, reporter)
    # Only here: it imports rclpy, which need not be installed.
    from barn_eval.ros.attempt import try_planner  # noqa: PLC0415

    (spec,) = request.trials()
    folder = Path(tempfile.mkdtemp(prefix="barn_try_"))
    attempt = try_planner(request.config, spec.goal, folder)
    # Problems name the planner's log.
    if not attempt.problems:
        shutil.rmtree(folder)
    line = _run_line(request, attempt, planner)
    drives = attempt.first_command_s is not None
    content = {"drives": drives, **asdict(attempt), "run": line}
    if as_json:
        print_json(content)
    else:
        print_notes(*attempt.problems)
        if attempt.topics:
            console.print(table(("", "seen"), _rows(attempt)))
            # In one line, to be copied.
            click.echo(line)
    return ExitCode.DONE if drives else ExitCode.NOT_SCORED


def _rows(attempt: Attempt) -> list[tuple[str, str]]:
    """Return (name, what was seen) rows: topics, and delay and rates if measured."""
    rows = [(name, topic or "none") for name, topic in attempt.topics.items()]
    for topic, kind in attempt.unserved.items():
        rows.append((topic, f"{kind}, which no node publishes here"))
    if attempt.first_command_s is not None:
        rows.append(("first command", f"{attempt.first_command_s:.2f} s after a scan"))
    if attempt.command_rate_hz is not None:
        rows.append(("commands", f"{attempt.command_rate_hz:.1f} Hz"))
    if attempt.scan_rate_hz is not None:
        rows.append(("scans", f"{attempt.scan_rate_hz:.1f} Hz"))
    return rows


def _run_line(
    request: RunRequest, attempt: Attempt, planner: Mapping[str, str | None]
) -> str:
    """Return the `barn run` command line that starts the planner as this test did."""
    words = ["barn run --worlds 0 --protocol challenge --mode ros"]
    for option, text in planner.items():
        if text:
            arguments = "" if option == "planner_input" else attempt.arguments
            flag = option.replace("_", "-")
            words.append(f"--{flag} {shlex.quote(text + arguments)}")
    for key, value in attempt.ros.items():
        words.append(f"--ros {shlex.quote(f'{key}={value}')}")
    (choice,) = request.config.planners
    return " ".join([*words, f"--out out/{choice.name}"])
