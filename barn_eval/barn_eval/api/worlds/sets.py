"""Data sets: those that there are, read, changed, measured, drawn and written."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal

import pandas as pd

from barn_eval.analysis.pandas_tables import pandas_table
from barn_eval.pages.figures import Plot
from barn_eval.trials.protocol import CHALLENGE, DYNABARN
from barn_metrics.metrics import PUBLISHED, as_formula, world_metrics
from barn_metrics.report import MetricsTable
from barn_metrics.report import metrics_table as table_of
from barn_worlds.base.errors import ConfigError, WorldError, suggest
from barn_worlds.base.files import create_folder
from barn_worlds.datasets.dataset import (
    Dataset,
    dataset_files,
    open_dataset,
    select_worlds,
)
from barn_worlds.datasets.generate import cell_size_m
from barn_worlds.drawing.files import write_png
from barn_worlds.drawing.worlds import sheet_figure, world_figure, write_animation
from barn_worlds.formats.dataset_file import write_dataset_file
from barn_worlds.formats.map_server import write_map
from barn_worlds.formats.original import write_original
from barn_worlds.formats.sdf import write_sdf
from barn_worlds.formats.single import plan_grid_path
from barn_worlds.formats.world_yaml import write_world_yaml
from barn_worlds.robots.files import load_robot
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.course import fit_to_robot
from barn_worlds.worlds.world import World

Course = Sequence[float]
Form = Literal["sdf", "sdf_classic", "map", "original", "npz", "yaml", "png"]
FORMATS: tuple[Form, ...] = (
    "sdf",
    "sdf_classic",
    "map",
    "original",
    "npz",
    "yaml",
    "png",
)


def datasets() -> list[str]:
    """Return the names of the data sets that come with the suite, such as "barn300"."""
    return list(dataset_files())


def load(
    source: str | Path = "barn300", select: str = "all", *, robot: str | Path = "jackal"
) -> dict[int, World]:
    """Return worlds by number.

    For instance, of the shipped data set:

        world = barn.worlds.load("barn300", "120")[120]
        world.grid  # (rows, cols) bool, True where it is filled

    Args:
        source: A data set's name, or a file or folder of any known format.
        select: Which, such as "0-49" or "0:300:60".
        robot: What paths are planned for where a source has none.

    Raises:
        BarnError: The source cannot be read, or has no such world.
    """
    dataset = open_dataset(source, load_robot(robot))
    return {
        index: dataset.load(index)
        for index in select_worlds(select, dataset.world_numbers)
    }


def save(
    chosen: Mapping[int, World],
    out: str | Path,
    form: Form = "npz",
    *,
    movable: bool = False,
) -> Path:
    """Write worlds for other programs, or as a data set.

    Args:
        chosen: The worlds by number.
        out: File or folder, which must not be there.
        form: npz (one file of the suite's own), original (the layout of the original data set), or a file per world in
            the folder `out`: sdf (current Gazebo), sdf_classic (Gazebo Classic), map (map_server's pgm and yaml), yaml
            (to edit by hand), png.
        movable: Whether obstacles of Gazebo worlds can be pushed.

    Returns:
        The path.

    Raises:
        BarnError: The format is not known or has no place for such worlds, or something is there already.
    """
    if form not in FORMATS:
        raise ConfigError(f"unknown format {form!r}{suggest(form, FORMATS)}")
    if movable and not form.startswith("sdf"):
        raise ConfigError(f"movable obstacles are for Gazebo worlds, not for {form}")
    target = Path(out).with_suffix(".npz") if form == "npz" else Path(out)
    require_new(target)
    if form == "npz":
        write_dataset_file(target, target.stem, dict(chosen))
    elif form == "original":
        write_layout(target, chosen)
    else:
        _write_each(target, chosen, form, movable)
    return target


def write_layout(target: Path, chosen: Mapping[int, World]) -> None:
    """Write worlds in the layout of the original data set; WorldError for those that it has no place for."""
    for world in chosen.values():
        if _in_metres(world):
            raise WorldError(
                f"{world.name}: the original layout has no place for walls and moving obstacles"
            )
    metrics_of = {
        index: world_metrics(world, PUBLISHED).as_array()
        for index, world in chosen.items()
    }
    write_original(target, dict(chosen), metrics_of)


def require_new(target: Path) -> None:
    """Raise WorldError where something is there already."""
    if target.is_file() or (target.is_dir() and any(target.iterdir())):
        raise WorldError(f"{target}: exists already")


def new_npz(out: str | Path) -> Path:
    """Return the .npz file of that name; WorldError where it is there already."""
    target = Path(out).with_suffix(".npz")
    require_new(target)
    return target


def resize(chosen: Mapping[int, World], robot: str | Path) -> dict[int, World]:
    """Return worlds with the same grids, their cells in the size that `generate` gives them for a robot.

    Paths stay where the robot takes as many cells as before; else they are planned anew.

    Args:
        chosen: The worlds by number.
        robot: Its name or its YAML file.

    Raises:
        BarnError: A world has walls, moving obstacles or an arena, which are in metres, or no way for the robot.
    """
    driven = load_robot(robot)
    side_m = cell_size_m(driven)
    for world in chosen.values():
        if _in_metres(world):
            raise WorldError(
                f"{world.name}: walls, moving obstacles and arenas are in metres and cannot be resized"
            )
    return {
        index: fitting(replace(world, resolution_m=side_m), driven)
        for index, world in chosen.items()
    }


def fitting(world: World, robot: Robot) -> World:
    """Return a world with a robot's footprint, and a path for it where that is another one than the world's own."""
    cells = robot.footprint_cells(world.resolution_m)
    if cells == world.footprint_cells:
        return world
    return replace(
        world, footprint_cells=cells, path=plan_grid_path(world.grid, cells, world.name)
    )


def metrics(
    source: str | Path = "barn300",
    select: str = "all",
    formula: str = "corrected",
    *,
    robot: str | Path = "",
) -> pd.DataFrame:
    """Return the five difficulty metrics of worlds; docs/metrics.md says what they measure, and their units.

    Args:
        source: A data set's name, or a file or folder of worlds.
        select: Which worlds, such as "0-49".
        formula: corrected, published (the numbers in print) or paper_text.
        robot: Whose C-space and path they are taken from, in place of the worlds' own.

    Returns:
        A row per world; its column `world` is the number.

    Raises:
        BarnError: A world cannot be read, or has no way for the robot.
    """
    table = metrics_table(source, select, formula, robot=robot)
    return pandas_table(
        {"world": int(world), **row}
        for world, row in zip(table.worlds, table.rows(), strict=True)
    )


def metrics_table(
    source: str | Path,
    select: str = "all",
    formula: str = "corrected",
    *,
    robot: str | Path = "",
) -> MetricsTable:
    """Return the same with its summary, as in the paper's Table II."""
    chosen, dataset = as_formula(formula), open_dataset(source)
    driven = load_robot(robot) if robot else None

    def read(index: int) -> World:
        return (
            dataset.load(index)
            if driven is None
            else fitting(dataset.load(index), driven)
        )

    readers = {
        index: partial(read, index)
        for index in select_worlds(select, dataset.world_numbers)
    }
    return table_of(Dataset(dataset.name, readers), chosen)


def draw(
    shown: World | Mapping[int, World],
    *,
    robot: str | Path = "jackal",
    course: Course = (),
) -> Plot:
    """Return a figure of one world, or of many on a sheet.

    Start, goal and path of one world are those that are driven: its own, else those of protocol challenge (of an arena,
    dynabarn).

    Args:
        shown: The world, or worlds by number.
        robot: What drives.
        course: Start x, y, yaw and goal x, y [m, rad] in place of the world's own.

    Raises:
        BarnError: Start or goal is blocked, or no way leads from one to the other. A course is asked for of several
            worlds.
    """
    if isinstance(shown, Mapping):
        if course:
            raise ConfigError("a course is drawn in one world, not in several")
        return Plot(sheet_figure(shown), f"{len(shown)} worlds")
    driven = fit_to_robot(shown, load_robot(robot), course)
    rules = DYNABARN if driven.corner_m is not None else CHALLENGE
    ends = rules.course(driven)
    return Plot(
        world_figure(driven, ends.start, ends.goal, rules.goal_distance_m), shown.name
    )


def write_figure(
    shown: Mapping[int, World], target: str | Path, *, course: Course = ()
) -> None:
    """Write a picture of worlds, on a sheet if they are several, or an animation of one that moves.

    Args:
        shown: The worlds by number.
        target: File, .png or .gif.
        course: As for `draw`.

    Raises:
        BarnError: An animation is asked for of several worlds or of one that does not move.
    """
    first, *others = shown.values()
    if Path(target).suffix != ".gif":
        write_png(draw(shown if others else first, course=course).figure, Path(target))
    elif others:
        raise WorldError(
            f"an animation shows one world, got {len(shown)}; select one with --worlds"
        )
    else:
        write_animation(first, Path(target))


def _in_metres(world: World) -> bool:
    return bool(world.moving or world.walls or world.corner_m is not None)


def _write_each(
    target: Path, chosen: Mapping[int, World], form: Form, movable: bool
) -> None:
    """Write a file per world into a folder that is there whole or not at all."""
    with create_folder(target) as folder:
        for index, world in chosen.items():
            if form == "png":
                write_png(world_figure(world), folder / f"world_{index}.png")
            elif form == "yaml":
                write_world_yaml(world, folder / f"world_{index}.world.yaml")
            elif form == "map":
                write_map(
                    world.occupancy_map(),
                    folder / f"map_{index}",
                    course=world.course_numbers,
                )
            else:
                flavour, ending = (
                    ("classic", ".world") if form == "sdf_classic" else ("gz", ".sdf")
                )
                write_sdf(
                    world, folder / f"world_{index}{ending}", flavour, movable=movable
                )
