"""`barn show`: worlds as pictures, or trials drawn over one."""

from collections.abc import Sequence
from pathlib import Path

import click

from barn_eval.api import worlds as world_sets
from barn_eval.api.results import overlay
from barn_eval.commands.options import (
    FILE,
    PATH,
    course_option,
    print_notes,
    split_names,
)


@click.command("show")
@click.argument("worlds", metavar="WORLDS")
@click.option(
    "--dataset", default="barn300", help="Data set that numbers are looked up in."
)
@click.option(
    "--out",
    type=FILE,
    help="Picture (.png), of trials also .svg or .pdf, of a world that moves also .gif [default: named after WORLDS].",
)
@course_option
@click.option(
    "--trials",
    multiple=True,
    type=PATH,
    help="Draw the trials of this folder in it; repeatable.",
)
@click.option(
    "--by",
    type=click.Choice(("planner", "speed")),
    help="What trials are coloured by [default: planner].",
)
@click.option(
    "--planners", "--planner", help="Only trials of these planners, such as dwa,eband."
)
@click.option("--outcome", help="Only trials that ended so, such as collision.")
def command(
    worlds: str,
    dataset: str,
    out: Path | None,
    course: Sequence[float] | None,
    trials: Sequence[Path],
    **drawn: str | None,
) -> None:
    """Draw a world, several on one sheet, or trials over one.

    WORLDS are numbers in the data set, such as 120, 0:300:60 or all, or a file or folder of worlds. Start, goal and
    path are those that the Jackal drives by: the world's own, else the challenge's. Moving obstacles are drawn at time
    0, with their tracks and arrows along them.
    """
    numbers = worlds == "all" or (worlds[:1].isdecimal() and not Path(worlds).exists())
    if trials:
        if not worlds.isdecimal():
            raise click.UsageError(
                f"--trials needs the number of a world, got {worlds!r}"
            )
        target = out or Path(f"trials_w{int(worlds):04d}.png")
        by, planners, outcome = (
            drawn[name] or "" for name in ("by", "planners", "outcome")
        )
        overlay(
            trials,
            int(worlds),
            by or "planner",
            planners=split_names(planners),
            outcome=outcome,
        ).save(target)
        print_notes(target)
        return
    for option, value in drawn.items():
        if value:
            raise click.UsageError(f"--{option} needs --trials")
    found = world_sets.load(dataset, worlds) if numbers else world_sets.load(worlds)
    first, *others = found
    target = out or Path("worlds.png" if others else f"world_{first}.png")
    world_sets.write_figure(found, target, course=course or ())
    print_notes(target)
