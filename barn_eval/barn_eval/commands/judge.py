"""`barn judge`: judge trials of any simulator or robot from their bags."""

from pathlib import Path
from typing import Any

import click

from barn_eval.commands.options import (
    course_option,
    field_option,
    flag_option,
    folder_option,
    json_option,
    notes,
    path_argument,
    print_notes,
)
from barn_eval.commands.run import print_results
from barn_eval.running.judge import JudgeOptions, judge
from barn_eval.running.reporting import describe_end
from barn_worlds.base.config import fields_of

_OPTIONS = JudgeOptions()


def _judge_options(command: Any) -> Any:
    """Return a command with an option added for each field of `JudgeOptions`."""
    for name, _, _ in reversed(list(fields_of(_OPTIONS))):
        command = field_option(_OPTIONS, name)(command)
    return command


@click.command("judge")
@path_argument("bags", nargs=-1, required=True)
@_judge_options
@course_option
@folder_option("--out", required=True, help="Folder for the results.")
@flag_option("--overwrite", help="Delete other results in that folder first.")
@json_option
def command(
    bags: tuple[Path, ...],
    course: tuple[float, ...] | None,
    out: Path,
    overwrite: bool,
    as_json: bool,
    **values: Any,
) -> int:
    """Judge trials of other simulators or robots from BAGS and write results.

    A bag is a rosbag2 folder or file (MCAP or SQLite, also compressed) or a ROS 1 bag.
    Each goal in a bag starts a trial. A measure stays empty if the bag lacks its data.
    """
    options = {name: value for name, value in values.items() if value is not None}
    with notes.status("judging"):
        run, results = judge(
            bags, out, JudgeOptions(**options), course or (), overwrite=overwrite
        )
    for row in results:
        print_notes(f"{row.trial_id}: {describe_end(row)}")
        if row.remarks:
            print_notes(f"  {row.remarks}")
    return print_results(run, results, as_json, show_all=False)
