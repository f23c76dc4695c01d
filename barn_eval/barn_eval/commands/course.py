"""`barn course`: plan a course to build it on a floor, and survey it as built."""

from pathlib import Path
from typing import Any

import click

from barn_eval.api import worlds as api_worlds
from barn_eval.commands.options import (
    course_option,
    dataset_option,
    field_option,
    file_option,
    json_option,
    parameters_option,
    path_argument,
    print_notes,
    print_output,
    robot_option,
)
from barn_eval.commands.tables import decimals_text, table
from barn_eval.running.judge import JudgeOptions
from barn_worlds.drawing.plan import PlanConfig
from barn_worlds.formats.world_yaml import ENDING, write_world_yaml
from barn_worlds.worlds.world import World

_JUDGE_OPTIONS = JudgeOptions()
_MOST_ROWS = 10


@click.group("course")
def command() -> None:
    """Plan how to build a world on a floor, and survey where its obstacles stand."""


def _load(dataset: str, number: int) -> World:
    """Return the world with a number, read from a data set; BarnError if it has none."""
    return api_worlds.load(dataset, str(number))[number]


@command.command()
@click.argument("world", type=int)
@dataset_option(help="Data set or file that contains the world.")
@file_option("--out", default="plan.pdf", help="PDF to write the plan to.")
@click.option(
    "--box", type=float, help="Build the world from boxes with this side [m]."
)
@click.option(
    "--post", type=float, help="Build the world from posts with this diameter [m]."
)
@parameters_option("--set", "config", "Setting of the plan", PlanConfig())
@course_option
@robot_option
def plan(
    world: int,
    dataset: str,
    out: Path,
    box: float | None,
    post: float | None,
    config: dict[str, Any],
    course: tuple[float, ...] | None,
    robot: str,
) -> None:
    """Write a plan for building WORLD: coordinates, counts, tape distances, and tiles to scale."""
    if box is not None and post is not None:
        raise click.UsageError("--box and --post cannot be used together")
    for shape, size_m in (("box", box), ("post", post)):
        if size_m is not None:
            config |= {"shape": shape, "size_m": size_m}
    details = _load(dataset, world)
    api_worlds.plan(details, out, robot=robot, course=course or (), **config)
    print_notes(out)


@command.command()
@path_argument("bag")
@click.option(
    "--world",
    "number",
    type=int,
    required=True,
    help="Number of the world that was built.",
)
@dataset_option(help="Data set or file that contains the world.")
@file_option(
    "--out", help=f"File to write the built world to (NAME{ENDING}), for barn run."
)
@course_option
@robot_option
@click.option(
    "--tolerance",
    default=0.02,
    type=click.FloatRange(0.001, 0.1),
    help="Expected standard deviation of placement errors [m].",
)
@field_option(_JUDGE_OPTIONS, "pose")
@field_option(_JUDGE_OPTIONS, "namespace")
@json_option
def survey(
    bag: Path,
    number: int,
    dataset: str,
    out: Path | None,
    course: tuple[float, ...] | None,
    robot: str,
    tolerance: float,
    as_json: bool,
    pose: str | None,
    namespace: str | None,
) -> None:
    """Locate the obstacles of a built world from the scans of a drive in BAG.

    The survey measures where obstacles stand relative to each other. Poses in the frame
    map or world locate the course as a whole. Without them, the survey places the course
    where it fits the plan best. The output lists obstacles with an uncertain position.
    The world that --out writes has these obstacles at their planned positions.
    """
    if out is not None and not out.name.endswith(ENDING):
        raise click.UsageError(f"--out must end in {ENDING}, got {out}")
    world = _load(dataset, number)
    result = api_worlds.survey(
        bag,
        world,
        robot=robot,
        course=course or (),
        tolerance_m=tolerance,
        pose=pose or "",
        namespace=namespace or "",
    )
    content = result.table()
    records = content.to_dict("index")
    is_sure = content.unsure == ""
    farthest = content[is_sure].nlargest(_MOST_ROWS, "off_mm").drop(columns="unsure")
    doubts = [
        (reason, str(len(rows)), ", ".join(map(str, rows.index)))
        for reason, rows in content[~is_sure].groupby("unsure")
    ]
    print_output(
        as_json,
        {"world": world.name, "datum": result.datum, "obstacles": records},
        table(
            ("number", *(f">{name}" for name in farthest.columns)),
            [list(map(decimals_text, row)) for row in farthest.itertuples()],
            title=f"{world.name}: {is_sure.sum()} of {len(content)} located",
            caption=f"the {len(farthest)} farthest off; the course as a whole is placed"
            f" by the {result.datum}",
        ),
        table(("unsure", ">count", "numbers"), doubts),
    )
    if out is not None:
        write_world_yaml(result.built_world(), out)
        print_notes(out)
