"""Worlds: data sets, generated worlds, files for other programs, pictures, metrics."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import pandas as pd

from barn_eval.analysis.pandas_tables import pandas_table
from barn_eval.pages.figures import Plot
from barn_eval.results.bags.recorded import read_recorded_trial
from barn_eval.results.bags.sources import Sources
from barn_eval.studies.survey import Survey, survey_course
from barn_eval.trials.protocol import CHALLENGE, DYNABARN
from barn_metrics.metrics import PUBLISHED, as_formula, world_metrics
from barn_metrics.report import MetricsTable
from barn_metrics.report import metrics_table as make_metrics_table
from barn_worlds.base.config import from_dict, replace_dotted
from barn_worlds.base.errors import ConfigError, WorldError, note, suggest
from barn_worlds.base.files import create_folder, write_bytes
from barn_worlds.base.types import Pose2D
from barn_worlds.datasets.dataset import (
    Dataset,
    dataset_files,
    open_dataset,
    select_worlds,
)
from barn_worlds.datasets.generate import (
    TABLE_I,
    DatasetParameters,
    WorldParameters,
    generate_ranked_dataset,
    renumber,
    write_dataset,
)
from barn_worlds.datasets.generate_motion import (
    add_crossings,
    add_motion,
    generate_arenas,
    motion_class,
)
from barn_worlds.drawing.files import write_png
from barn_worlds.drawing.plan import CoursePlan, PlanConfig
from barn_worlds.drawing.worlds import (
    routes_figure,
    sheet_figure,
    world_figure,
    write_animation,
)
from barn_worlds.formats.dataset_file import write_dataset_file
from barn_worlds.formats.map_server import write_map
from barn_worlds.formats.original import write_original
from barn_worlds.formats.sdf import write_sdf
from barn_worlds.formats.single import plan_grid_path
from barn_worlds.formats.world_yaml import write_world_yaml
from barn_worlds.robots.contact import contact_footprint
from barn_worlds.robots.files import load_robot, name_unless_standard
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.course import cell_size_m, fit_to_robot
from barn_worlds.worlds.world import World

__all__ = [
    "datasets",
    "draw",
    "generate",
    "generate_moving",
    "load",
    "metrics",
    "plan",
    "resize",
    "save",
    "survey",
    "write_figure",
]

Form = Literal["sdf", "sdf_classic", "map", "original", "npz", "yaml", "png"]
# The type for users of Python and the choices of the command are the same.
FORMATS: tuple[Form, ...] = get_args(Form)


def datasets() -> list[str]:
    """Return the names of the data sets that come with the suite, such as "barn300"."""
    return list(dataset_files())


def load(
    source: str | Path = "barn300",
    select: str = "all",
    *,
    robot: str | Path = "jackal",
    courses: Sequence[Sequence[float]] = (),
    routes: int = 0,
    seed: int = 0,
) -> dict[int, World]:
    """Read worlds from a data set or file; return `World` objects by number.

    For instance, from a data set of the suite:

        world = barn.worlds.load("barn300", "120")[120]
        world.grid  # (rows, cols) bool, True for filled cells

    Args:
        source: A data set's name, or a file or folder of any known format.
        select: World numbers, such as "0-49" or "0:300:60".
        robot: Robot to plan paths for if the source has none.
        courses: Start x, y, yaw and goal x, y [m, rad] of routes; each route becomes a
            world.
        routes: Number of random routes in each world; each route becomes a world.
        seed: Seed of the random routes.

    Raises:
        BarnError: If the source cannot be read, or has no such world.
    """
    loaded_robot = load_robot(robot)
    dataset = open_dataset(source, loaded_robot)
    if courses or routes:
        worlds = dataset.split_into_routes(loaded_robot, courses, routes, seed)
        return {number: worlds[number] for number in select_worlds(select, worlds)}
    return {
        number: dataset.load_scaled(number, loaded_robot)
        for number in select_worlds(select, dataset.world_numbers)
    }


def generate(
    out: str | Path | None = None,
    *,
    per_set: int = 25,
    seed: int = 2020,
    parameters: Mapping[str, object] | None = None,
    robot: str | Path = "jackal",
    keep: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> dict[int, World]:
    """Generate static worlds, numbered widest first; return them, and write any `out`.

    For instance, generate worlds of your own and run a planner in them:

        fill = {"initial_fill": 0.25}
        worlds = barn.worlds.generate(per_set=3, parameters=fill, seed=1)
        barn.run(worlds, planners="gap")

    Args:
        out: New file (.npz), or new folder in the original layout, for the worlds.
        per_set: Worlds per parameter set.
        seed: Seed of all random numbers.
        parameters: One parameter set of your own, by name (see
            `barn_worlds.datasets.generate.WorldParameters`). Default: the twelve sets
            of the paper's Table I.
        robot: Robot to plan paths for. Unless parameters set the size of cells, it also
            sets that: a robot takes 5 x 5 cells.
        keep: Number of worlds to keep, evenly spread from wide to narrow; 0 for all.
        progress: Called with the number of worlds so far and the number of all worlds.

    Raises:
        BarnError: If a parameter is not allowed, or the file cannot be written.
    """
    path = None
    name = "generated"
    if out is not None:
        path = Path(out)
        name = path.stem
        _require_new(path)
    chassis = load_robot(robot)
    dataset = DatasetParameters(
        name,
        seed,
        per_set,
        keep=keep,
        robot=name_unless_standard(chassis.chassis),
        sets=_parameter_sets(parameters or {}, chassis),
    )
    if path is not None and path.suffix == ".npz":
        write_dataset(path, dataset, progress=progress)
        return load(path)
    worlds = renumber(*generate_ranked_dataset(dataset, progress=progress))
    if path is not None:
        _write_original_layout(path, worlds)
    return worlds


def _parameter_sets(
    changes: Mapping[str, object], robot: Robot
) -> tuple[WorldParameters, ...]:
    """Return Table I, or one set with `changes`, with cells scaled to the robot.

    Sizes of cells and footprint in `changes` are kept.
    """
    sets = TABLE_I
    if changes:
        # Changes make one new set; Table I stays as printed.
        sets = (replace_dotted(WorldParameters(), changes, "world parameters"),)
    # The generator works in cells: any robot takes the same number of them.
    sizes: dict[str, float] = {}
    if not {"resolution_m", "footprint_cells"} & changes.keys():
        sizes["resolution_m"] = cell_size_m(robot)
    if "footprint_cells" not in changes:
        resolution_m = sizes.get("resolution_m", sets[0].resolution_m)
        sizes["footprint_cells"] = robot.footprint_cells(resolution_m)
    return tuple(replace_dotted(item, sizes, "world parameters") for item in sets)


def generate_moving(
    out: str | Path | None = None,
    classes: Sequence[str] = ("easy", "medium", "hard"),
    *,
    per_class: int = 20,
    seed: int = 0,
    parameters: Mapping[str, object] | None = None,
    source: str | Path | None = None,
    select: str = "all",
    crossing: bool = False,
    obstacles: int | None = None,
) -> dict[int, World]:
    """Generate worlds with moving obstacles; return them by number; write any `out`.

    Args:
        out: New file (.npz) for the worlds.
        classes: Classes of motion. Without `source` the worlds are arenas as in
            DynaBARN.
        per_class: Number of arenas of each class.
        seed: Seed of all random numbers.
        parameters: Changes to the classes, by name (see
            `barn_worlds.datasets.generate_motion.MotionParameters`).
        source: Data set whose worlds get moving obstacles, of one class; the worlds keep
            their numbers.
        select: World numbers in the source.
        crossing: Whether these obstacles go back and forth across the path.
        obstacles: Number of moving obstacles per world. Default: drawn by the class.

    Raises:
        BarnError: If a class or parameter is not known, or the file cannot be written.
    """
    path = None
    if out is not None:
        # The original layout has no place for moving obstacles.
        path = Path(out).with_suffix(".npz")
        _require_new(path)
    motions = [
        replace_dotted(motion_class(name), parameters or {}, "parameters of a class")
        for name in classes
    ]
    worlds: dict[int, World] = {}
    if source is None:
        if crossing or obstacles is not None:
            raise ConfigError(
                "crossing and obstacles are for the worlds of a data set; name one as"
                " source"
            )
        arenas: list[World] = []
        for motion in motions:
            arenas += generate_arenas(motion, per_class, seed)
        worlds = dict(enumerate(arenas))
    elif len(motions) != 1:
        raise ConfigError(
            f"the worlds of {source} take one class of motion, got {len(motions)}"
        )
    else:
        # Each world has its own seed, whichever other worlds are selected.
        add_obstacles = add_crossings if crossing else add_motion
        for number, world in load(source, select).items():
            worlds[number] = add_obstacles(world, motions[0], seed + number, obstacles)
    if path is not None:
        write_dataset_file(path, path.stem, worlds, {"seed": seed})
    return worlds


def save(
    worlds: Mapping[int, World],
    out: str | Path,
    form: Form = "npz",
    *,
    movable: bool = False,
) -> Path:
    """Write worlds to a new path in one of seven formats; return it or raise BarnError.

    Args:
        worlds: Worlds by their numbers in a data set.
        out: New file or folder.
        form: npz (one file of the suite's own format), original (the layout of the
            original data set), or a file per world in the folder `out`: sdf (current
            Gazebo), sdf_classic (Gazebo Classic), map (map_server's pgm and yaml), yaml
            (to edit by hand), png.
        movable: Whether obstacles of Gazebo worlds can be pushed.

    Returns:
        The path.

    Raises:
        BarnError: If the format is unknown or cannot hold such worlds, or the file or
            folder exists already.
    """
    if form not in FORMATS:
        raise ConfigError(f"unknown format {form!r}{suggest(form, FORMATS)}")
    # A map or a picture says nothing about what can be pushed.
    if movable and not form.startswith("sdf"):
        raise ConfigError(f"movable obstacles are for Gazebo worlds, not for {form}")
    path = Path(out)
    if form == "npz":
        path = path.with_suffix(".npz")
    _require_new(path)
    if form == "npz":
        write_dataset_file(path, path.stem, dict(worlds))
    elif form == "original":
        _write_original_layout(path, worlds)
    else:
        # The folder appears whole or not at all.
        with create_folder(path) as folder:
            for number, world in worlds.items():
                _write_world(world, folder, number, form, movable=movable)
    return path


def _write_original_layout(path: Path, worlds: Mapping[int, World]) -> None:
    """Write worlds and metrics in the original layout; WorldError if it lacks a part.

    It lacks walls, moving obstacles, arenas and surveyed positions.
    """
    for world in worlds.values():
        if _has_metric_content(world):
            raise WorldError(
                f"{world.name}: the original layout cannot hold walls, moving"
                " obstacles, arenas or surveyed positions"
            )
    # The original data set has metrics by the published formula.
    published_metrics = {
        number: world_metrics(world, PUBLISHED).as_array()
        for number, world in worlds.items()
    }
    write_original(path, dict(worlds), published_metrics)


def _write_world(
    world: World, folder: Path, number: int, form: Form, *, movable: bool
) -> None:
    """Write a world into `folder`, to a file (map: two) named after its number."""
    if form == "png":
        write_png(world_figure(world), folder / f"world_{number}.png")
    elif form == "yaml":
        write_world_yaml(world, folder / f"world_{number}.world.yaml")
    elif form == "map":
        path = folder / f"map_{number}"
        write_map(world.occupancy_map(), path, course=world.course_numbers)
    else:
        is_classic = form == "sdf_classic"
        path = folder / f"world_{number}.{'world' if is_classic else 'sdf'}"
        write_sdf(world, path, "classic" if is_classic else "gz", movable=movable)


def _require_new(path: Path) -> None:
    """Raise WorldError if `path` is a file or a folder that is not empty."""
    if path.is_file() or (path.is_dir() and any(path.iterdir())):
        raise WorldError(f"{path}: exists already")


def resize(worlds: Mapping[int, World], robot: str | Path) -> dict[int, World]:
    """Return copies of worlds in a robot's cells; WorldError if parts are in meters.

    Paths stay if the robot takes as many cells as before. Otherwise they are planned
    again.

    Args:
        worlds: Worlds by their numbers in a data set.
        robot: Name or YAML file of the robot.

    Raises:
        BarnError: If a world is an arena or has walls, moving obstacles or surveyed
            positions, which are in meters, or if it has no path for the robot.
    """
    target_robot = load_robot(robot)
    resolution_m = cell_size_m(target_robot)
    resized: dict[int, World] = {}
    for number, world in worlds.items():
        if _has_metric_content(world):
            raise WorldError(
                f"{world.name}: walls, moving obstacles, arenas and surveyed positions"
                " are in meters and cannot be resized"
            )
        scaled = replace(world, resolution_m=resolution_m)
        resized[number] = _with_footprint(scaled, target_robot)
    return resized


def _with_footprint(world: World, robot: Robot) -> World:
    """Return the world itself if its footprint fits the robot, else with a new path.

    The new path runs from the first to the last column of the grid; start, goal and size
    of cells stay. Raises WorldError if there is no such path.
    """
    cells = robot.footprint_cells(world.resolution_m)
    # A new path may differ from that of the data set, which is kept if possible.
    if cells == world.footprint_cells:
        return world
    path = plan_grid_path(world.grid, cells, world.name)
    return replace(world, footprint_cells=cells, path=path)


def _has_metric_content(world: World) -> bool:
    """Tell whether a world has walls, movers, corner or surveyed positions in meters."""
    in_cells = world.corner_m is None and world.built_m is None
    return bool(world.moving or world.walls or not in_cells)


def metrics(
    source: str | Path = "barn300",
    select: str = "all",
    formula: str = "corrected",
    *,
    robot: str | Path = "",
) -> pd.DataFrame:
    """Return a DataFrame of the five difficulty metrics, a row per world.

    docs/metrics.md explains what they measure, and their units.

    Args:
        source: A data set's name, or a file or folder of worlds.
        select: World numbers, such as "0-49".
        formula: corrected, published (gives the printed numbers) or paper_text (as the
            paper's text states it).
        robot: Robot whose C-space and path are measured, instead of the worlds' own.

    Returns:
        A row per world; its column `world` is the number.

    Raises:
        BarnError: If a world cannot be read, or has no path for the robot.
    """
    metrics_by_world = metrics_table(source, select, formula, robot=robot)
    numbered_rows = zip(metrics_by_world.worlds, metrics_by_world.rows(), strict=True)
    return pandas_table({"world": int(number), **row} for number, row in numbered_rows)


def metrics_table(
    source: str | Path,
    select: str = "all",
    formula: str = "corrected",
    *,
    robot: str | Path = "",
) -> MetricsTable:
    """Return the worlds' difficulty metrics as a `MetricsTable`, with their summary.

    Args:
        source: As for `metrics`.
        select: As for `metrics`.
        formula: As for `metrics`.
        robot: As for `metrics`.
    """
    dataset = open_dataset(source)
    # By default, each world is measured for the robot that it was made for.
    other_robot = load_robot(robot) if robot else None

    def read(number: int) -> World:
        """Return a world by number, with footprint and path of the other robot, if any."""
        world = dataset.load(number)
        if other_robot is not None:
            world = _with_footprint(world, other_robot)
        return world

    readers = {
        number: partial(read, number)
        for number in select_worlds(select, dataset.world_numbers)
    }
    return make_metrics_table(Dataset(dataset.name, readers), as_formula(formula))


def draw(
    worlds: World | Mapping[int, World],
    *,
    robot: str | Path = "jackal",
    course: Sequence[float] = (),
) -> Plot:
    """Return a plot of one world with its course, or of several worlds on a sheet.

    Start, goal and path of a single world are its own, or else those of protocol
    challenge or, in an arena, dynabarn.

    Args:
        worlds: One world, or several by their numbers in a data set.
        robot: Robot that drives.
        course: Start x, y, yaw and goal x, y [m, rad] instead of the world's own.

    Raises:
        BarnError: If start or goal is blocked, no path connects them, or several worlds
            get a course.
    """
    if isinstance(worlds, Mapping):
        if course:
            raise ConfigError("a course is drawn in one world, not in several")
        # Routes through one map are drawn over that map.
        first, *others = worlds.values()
        shares_map = first.start is not None and all(
            np.array_equal(world.grid, first.grid) for world in others
        )
        figure = routes_figure(worlds) if shares_map else sheet_figure(worlds)
        return Plot(figure, f"{len(worlds)} worlds")
    world, start, goal, distance_m = _with_course(worlds, load_robot(robot), course)
    return Plot(world_figure(world, start, goal, distance_m), worlds.name)


def _with_course(
    world: World, robot: Robot, course: Sequence[float]
) -> tuple[World, Pose2D, Pose2D, float]:
    """Return (world fitted to a robot, start, goal, distance of arrival [m])."""
    world = fit_to_robot(world, robot, course)
    # A world with a corner in meters is an arena, whose course is DynaBARN's.
    protocol = DYNABARN if world.corner_m is not None else CHALLENGE
    protocol = protocol.scaled_to(world, robot.chassis)
    ends = protocol.course(world)
    return world, ends.start, ends.goal, protocol.goal_distance_m


def plan(
    world: World,
    out: str | Path,
    *,
    robot: str | Path = "jackal",
    course: Sequence[float] = (),
    **config: Any,
) -> None:
    """Write a PDF plan for building a world: coordinates, counts, and tiles to scale.

    Args:
        world: World to build.
        out: The PDF.
        robot: Robot that will drive there.
        course: As for `draw`.
        config: Fields of `barn_worlds.drawing.plan.PlanConfig`: parts to build the world
            of, and how the plan is printed (by default, 1:10).

    Raises:
        BarnError: If the world cannot be built of these parts.
    """
    details = load_robot(robot)
    outline_m = contact_footprint(details.chassis).corners_m
    parts = from_dict(PlanConfig, config, "plan")
    ends = _with_course(world, details, course)
    write_bytes(Path(out), CoursePlan(*ends, outline_m, parts).pdf())


def survey(
    bag: str | Path,
    world: World,
    *,
    robot: str | Path = "jackal",
    course: Sequence[float] = (),
    tolerance_m: float = 0.02,
    pose: str = "",
    namespace: str = "",
) -> Survey:
    """Locate a built world's obstacles from the scans of a drive; return a `Survey`.

    Args:
        bag: The drive, with scans and odometry.
        world: The plan.
        robot: Robot that drove.
        course: As for `draw`; its start is used unless poses are in the world's frame.
        tolerance_m: Expected standard deviation of misplacements [m].
        pose: Topic of poses, or frames of tf, such as "/tf:odom.base_link"; by default
            the true poses or, without them, the odometry.
        namespace: Namespace of the topics.

    Raises:
        BarnError: If the bag cannot be read, or its scans do not fit the plan.
    """
    _, start, _, _ = _with_course(world, load_robot(robot), course)
    trial = read_recorded_trial(Path(bag), Sources(pose, namespace=namespace))
    for problem in trial.problems:
        note(f"{bag}: {problem}")
    return survey_course(trial, world, start, tolerance_m)


def write_figure(
    worlds: Mapping[int, World], path: str | Path, *, course: Sequence[float] = ()
) -> None:
    """Write a PNG of one world or a sheet of several or, for .gif, an animation of one.

    Args:
        worlds: Worlds by their numbers in a data set.
        path: Picture (.png) or animation (.gif).
        course: As for `draw`.

    Raises:
        BarnError: If an animation is to show several worlds, or one without moving
            obstacles.
    """
    first = next(iter(worlds.values()))
    is_single = len(worlds) == 1
    if Path(path).suffix != ".gif":
        figure = draw(first if is_single else worlds, course=course).figure
        write_png(figure, Path(path))
    elif is_single:
        write_animation(first, Path(path))
    else:
        raise WorldError(
            f"an animation shows one world, got {len(worlds)}; select one with --worlds"
        )
