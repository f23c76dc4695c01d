"""`barn show`: draw worlds, or trials over a world."""

from pathlib import Path

import click

from barn_eval.api import worlds as api_worlds
from barn_eval.api.results import overlay
from barn_eval.commands.options import (
    PLANNER,
    courses_option,
    dataset_option,
    field_option,
    file_option,
    path_option,
    print_notes,
    split_names,
)
from barn_eval.trials.run_config import RunConfig

_RUN = RunConfig()


@click.command("show")
@click.argument("worlds", metavar="WORLDS")
@dataset_option(help="Data set that contains the worlds.")
@file_option(
    "--out",
    help="File to write: .png, for trials also .svg or .pdf, for a world with moving"
    " obstacles also .gif [default: named after WORLDS].",
)
@courses_option
@field_option(_RUN, "routes")
@field_option(_RUN, "seed")
@path_option(
    "--trials",
    multiple=True,
    help="Draw the trials of this folder over the world; repeatable.",
)
@click.option(
    "--by",
    type=click.Choice(("planner", "speed")),
    help="What the color of a trial represents [default: planner].",
)
@click.option(
    "--planners",
    "--planner",
    type=PLANNER,
    help="Draw only trials of these planners, such as dwa,eband.",
)
@click.option(
    "--outcome", help="Draw only trials with this outcome, such as collision."
)
def command(
    worlds: str,
    dataset: str,
    out: Path | None,
    course: tuple[tuple[float, ...], ...],
    routes: int,
    seed: int,
    trials: tuple[Path, ...],
    by: str | None,
    planners: str | None,
    outcome: str | None,
) -> None:
    """Draw a world, several worlds on one sheet, or trials over a world.

    WORLDS are numbers in the data set, such as 120, 0:300:60 or all, or a file or
    folder of worlds. Start, goal, and path are the world's own, or else those of protocol
    challenge for the Jackal. Moving obstacles are drawn where they start, with arrows
    along their tracks.
    """
    if trials:
        if not worlds.isdecimal():
            raise click.UsageError(
                f"--trials needs the number of a world, got {worlds!r}"
            )
        path = out or Path(f"trials_w{int(worlds):04d}.png")
        overlay(
            trials,
            int(worlds),
            by or "planner",
            planners=split_names(planners or ""),
            outcome=outcome or "",
        ).save(path)
        print_notes(path)
        return

    # Without trials these options have no effect, which the user must know.
    for option, value in (("by", by), ("planners", planners), ("outcome", outcome)):
        if value:
            raise click.UsageError(f"--{option} needs --trials")
    # A file or folder may have a name that begins with a digit.
    are_numbers = worlds == "all" or (
        worlds[:1].isdecimal() and not Path(worlds).exists()
    )
    source = (dataset, worlds) if are_numbers else (worlds,)
    worlds_by_number = api_worlds.load(
        *source, courses=course, routes=routes or 0, seed=seed or 0
    )
    path = out or Path("worlds.png")
    if out is None and len(worlds_by_number) == 1:
        path = Path(f"world_{next(iter(worlds_by_number))}.png")
    api_worlds.write_figure(worlds_by_number, path)
    print_notes(path)
