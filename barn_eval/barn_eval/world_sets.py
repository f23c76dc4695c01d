"""Worlds from Python: data sets, generated worlds, files for other programs, metrics and predicted difficulty."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from barn_worlds.base.config import replace_dotted
from barn_worlds.base.errors import ConfigError, WorldError, suggest
from barn_worlds.robots.files import load_robot
from barn_worlds.robots.standard import other_name
from barn_worlds.worlds.dataset import Dataset, open_dataset, shipped
from barn_worlds.worlds.selection import select_worlds

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from barn_eval.pages.figures import Plot
    from barn_metrics.report import MetricsTable
    from barn_worlds.robots.robot import Robot
    from barn_worlds.worlds.world import World

FORMATS = ("sdf", "sdf_classic", "map", "original", "npz", "yaml", "tracks", "png")
Progress = Callable[[int, int], None]


def datasets() -> list[str]:
    """Return the names of the data sets that come with the suite, such as "barn300"."""
    return list(shipped())


def worlds(source: str | Path = "barn300", select: str = "all", *, robot: str = "jackal") -> dict[int, World]:
    """Return worlds by number; WorldError in one line for what cannot be read.

    For instance, of the shipped data set:

        world = barn.worlds("barn300", "120")[120]
        world.grid  # (rows, cols) bool, True where it is filled

    source: a data set's name, a file or folder of any known format. select: which, such as "0-49" or "0:300:60". robot:
    what paths are planned for where a source has none.
    """
    dataset = open_dataset(source, load_robot(robot))
    return {index: dataset.load(index) for index in select_worlds(select, dataset.indices)}


def generate_worlds(
    out: str | Path | None = None,
    *,
    per_set: int = 25,
    seed: int = 2020,
    parameters: Mapping[str, Any] | None = None,
    robot: str = "jackal",
    keep: int = 0,
    progress: Progress | None = None,
) -> dict[int, World]:
    """Generate worlds and return them by number, the easiest (widest) first.

    For instance, worlds of one's own, and a planner in them:

        barn.generate_worlds("mine.npz", per_set=3, parameters={"initial_fill": 0.25}, seed=1)
        barn.run(dataset="mine.npz", planners="gap")

    out: file (.npz) or folder in the original layout to write them to; it must not be there. per_set: worlds per
    parameter set. parameters: one set of your own, by name; without, the twelve of the paper's Table I. robot: what
    paths are planned for; cells are in its size, 5 x 5 of them to a robot, unless parameters say how large they are.
    keep: how many to keep, evenly spread over the order from wide to narrow; 0 for all. progress: called with the
    numbers of worlds made and of all.
    """
    from barn_worlds.worlds.generate import (  # noqa: PLC0415
        DatasetParameters,
        ranked_dataset,
        reordered,
        write_dataset,
    )
    from barn_worlds.worlds.parameters import TABLE_I, WorldParameters, cell_m  # noqa: PLC0415

    target = Path(out) if out is not None else None
    if target is not None:
        require_new(target)
    changes = dict(parameters or {})
    sets = (replace_dotted(WorldParameters(), changes, "world parameters"),) if changes else TABLE_I
    driven, sized = load_robot(robot), {}
    if not {"resolution_m", "footprint_cells"} & set(changes):
        sized["resolution_m"] = cell_m(driven)
    if "footprint_cells" not in changes:
        sized["footprint_cells"] = driven.footprint_cells(sized.get("resolution_m", sets[0].resolution_m))
    sets = tuple(replace_dotted(one, sized, "world parameters") for one in sets)
    name = target.stem if target else "generated"
    asked = DatasetParameters(name, seed, per_set, keep=keep, robot=other_name(driven.chassis), sets=sets)
    if target is not None and target.suffix == ".npz":
        write_dataset(target, asked, progress=progress)
        return worlds(target)
    numbered = reordered(*ranked_dataset(asked, progress=progress))
    if target is not None:
        save_worlds(numbered, target, "original")
    return numbered


def save_worlds(chosen: Mapping[int, World], out: str | Path, form: str = "npz", *, movable: bool = False) -> Path:
    """Write worlds for other programs, or as a data set, and return the path; it must not be there.

    form: npz (one file of the suite's own), original (the layout of the original data set), or a file per world in the
    folder `out`: sdf (current Gazebo), sdf_classic (Gazebo Classic), map (map_server's pgm and yaml), yaml (to edit by
    hand), tracks (CSV of where moving obstacles are in the first 100 s), png. movable: obstacles of Gazebo worlds can
    be pushed.
    """
    if form not in FORMATS:
        raise ConfigError(f"unknown format {form!r}{suggest(form, FORMATS)}")
    if movable and not form.startswith("sdf"):
        raise ConfigError(f"movable obstacles are for Gazebo worlds, not for {form}")
    target = Path(out).with_suffix(".npz") if form == "npz" else Path(out)
    require_new(target)
    if form == "original":
        require_static(chosen)
    if form == "npz":
        from barn_worlds.formats.own import write_own  # noqa: PLC0415

        write_own(target, target.stem, dict(chosen))
    elif form == "original":
        from barn_metrics.formula import PUBLISHED  # noqa: PLC0415 (compiled kernels)
        from barn_metrics.metrics import world_metrics  # noqa: PLC0415
        from barn_worlds.formats.original import write_original  # noqa: PLC0415

        metrics_of = {index: world_metrics(world, PUBLISHED).as_array() for index, world in chosen.items()}
        write_original(target, dict(chosen), metrics_of)
    else:
        _write_each(target, chosen, form, movable)
    return target


def require_static(chosen: Mapping[int, World]) -> None:
    """Raise WorldError for worlds that the original layout has no place for."""
    for world in chosen.values():
        if world.moving or world.walls or world.corner_m is not None:
            raise WorldError(f"{world.name}: the original layout has no place for walls and moving obstacles")


def require_new(target: Path) -> None:
    """Raise WorldError where something is there already."""
    if target.is_file() or (target.is_dir() and any(target.iterdir())):
        raise WorldError(f"{target}: exists already")


def resize_worlds(chosen: Mapping[int, World], robot: str) -> dict[int, World]:
    """Return worlds with the same grids, their cells in the size that `generate_worlds` gives them for a robot.

    Paths stay where the robot takes as many cells as before; else they are planned anew. WorldError for a world with
    walls, moving obstacles or an arena, which are in metres.
    """
    from barn_worlds.worlds.parameters import cell_m  # noqa: PLC0415

    driven = load_robot(robot)
    side_m = cell_m(driven)
    for world in chosen.values():
        if world.moving or world.walls or world.corner_m is not None:
            raise WorldError(f"{world.name}: walls, moving obstacles and arenas are in metres and cannot be resized")
    return {index: _fitting(replace(world, resolution_m=side_m), driven) for index, world in chosen.items()}


def metrics_table(
    source: str | Path | Dataset, select: str = "all", formula: str = "corrected", *, robot: str = ""
) -> MetricsTable:
    """Return the five difficulty metrics of worlds and their summary, as in the paper's Table II.

    robot: whose C-space and path they are taken from, in place of the worlds' own; WorldError in a world without a way.
    """
    from barn_metrics.formula import as_formula  # noqa: PLC0415
    from barn_metrics.report import metrics_table as table_of  # noqa: PLC0415 (compiled kernels)

    chosen = as_formula(formula)
    dataset = source if isinstance(source, Dataset) else open_dataset(source)
    numbers = select_worlds(select, dataset.indices)
    driven = load_robot(robot) if robot else None
    return table_of(
        Dataset(dataset.name, {index: partial(load_for, dataset, index, driven) for index in numbers}), chosen
    )


def load_for(dataset: Dataset, index: int, robot: Robot | None) -> World:
    """Return a world, with the footprint of a robot and a path for it where that is another one than its own."""
    world = dataset.load(index)
    return world if robot is None else _fitting(world, robot)


def _fitting(world: World, robot: Robot) -> World:
    from barn_worlds.formats.single import planned  # noqa: PLC0415 (compiled kernels)

    cells = robot.footprint_cells(world.resolution_m)
    if cells == world.footprint_cells:
        return world
    return replace(world, footprint_cells=cells, path=planned(world.grid, cells, world.name))


def metrics(source: str | Path = "barn300", select: str = "all", formula: str = "corrected", *, robot: str = "") -> Any:
    """Return the five difficulty metrics of worlds, a row per world; its column `world` is the number.

    formula: corrected, published (the numbers in print) or paper_text; see docs/metrics.md for what they measure, and
    units. robot: as in `metrics_table`. A pandas DataFrame where pandas is installed, else a pyarrow Table.
    """
    from barn_eval.results import frame_of  # noqa: PLC0415

    table = metrics_table(source, select, formula, robot=robot)
    return frame_of({"world": int(world), **row} for world, row in zip(table.worlds, table.rows(), strict=True))


def sample_worlds(
    out: str | Path,
    low: float = 0.0,
    high: float = math.inf,
    *,
    source: str | Path | None = None,
    count: int = 10,
    seed: int = 0,
    weights: str | Path | None = None,
) -> dict[int, World]:
    """Write worlds of a predicted difficulty of `low` to `high` s/m to a file (.npz), and return them, easiest first.

    source: data set to draw from; without one, worlds are generated. weights: file of a model [the shipped one].
    """
    from barn_eval.learning.curriculum import sample  # noqa: PLC0415
    from barn_metrics.model import load_model  # noqa: PLC0415 (compiled kernels)
    from barn_worlds.formats.own import Order  # noqa: PLC0415
    from barn_worlds.worlds.generate import write_ordered  # noqa: PLC0415

    target = new_npz(out)
    model = load_model(Path(weights) if weights else None)
    dataset = None if source is None else open_dataset(source)
    chosen = sample(lambda world: float(model.predict(world).difficulty_s_per_m), (low, high), dataset, count, seed)
    about = {"seed": seed, "source": "generated" if source is None else str(source)}
    order = Order("predicted time per metre, s/m", tuple(value for _, value in chosen))
    return write_ordered(target, target.stem, [world for world, _ in chosen], order, about)


def order_worlds(source: str | Path, out: str | Path, scores: str | Path, by: str) -> dict[int, World]:
    """Write the worlds of a data set to a file (.npz), numbered by rising score, and return them.

    scores: CSV file with the columns `world` and `by`; rows of one world are averaged. A campaign's results.csv is one.
    """
    from barn_eval.learning.difficulty import read_scores  # noqa: PLC0415 (pyarrow)
    from barn_worlds.formats.own import Order  # noqa: PLC0415
    from barn_worlds.worlds.generate import write_ordered  # noqa: PLC0415 (compiled kernels)

    target, dataset = new_npz(out), open_dataset(source)
    order = Order(by, read_scores(Path(scores), by, dataset.indices))
    about = {"source": dataset.name, "source_checksum": dataset.checksum}
    return write_ordered(target, target.stem, list(map(dataset.load, dataset.indices)), order, about)


def draw(shown: World | Mapping[int, World], *, metrics: bool = False) -> Plot:
    """Return a figure of one world, or of many on a sheet.

    metrics: draw a map of each difficulty metric as well, of one world.
    """
    from barn_eval.pages.figures import Plot  # noqa: PLC0415

    if isinstance(shown, Mapping):
        if metrics:
            raise ConfigError("metrics are drawn of one world, not of several")
        return Plot(_sheet_of(shown), f"{len(shown)} worlds")
    if metrics:
        from barn_metrics.world_figure import world_figure  # noqa: PLC0415 (matplotlib)

        return Plot(world_figure(shown), shown.name)
    return Plot(figure_of(shown), shown.name)


def draw_to_file(shown: Mapping[int, World], target: str | Path) -> None:
    """Write a picture (.png) of worlds, on a sheet if they are several; or an animation (.gif) of one that moves."""
    from barn_worlds.drawing.files import write_png  # noqa: PLC0415 (matplotlib)

    if Path(target).suffix == ".gif":
        from barn_worlds.drawing.moving import write_animation  # noqa: PLC0415 (matplotlib)

        if len(shown) != 1:
            raise WorldError(f"an animation shows one world, got {len(shown)}; select one with --worlds")
        write_animation(next(iter(shown.values())), Path(target))
    elif len(shown) == 1:
        write_png(figure_of(next(iter(shown.values()))), Path(target))
    else:
        write_png(_sheet_of(shown), Path(target))


def _moves(shown: Mapping[int, World]) -> bool:
    return any(world.moving or world.walls for world in shown.values())


def figure_of(world: World) -> Figure:
    """Return a picture of one world, with its tracks if obstacles move."""
    from barn_worlds.drawing.moving import motion_figure  # noqa: PLC0415 (matplotlib)
    from barn_worlds.drawing.worlds import world_figure  # noqa: PLC0415 (matplotlib)

    return motion_figure(world) if _moves({0: world}) else world_figure(world)


def _sheet_of(shown: Mapping[int, World]) -> Figure:
    from barn_worlds.drawing.moving import motion_sheet  # noqa: PLC0415 (matplotlib)
    from barn_worlds.drawing.worlds import sheet_figure  # noqa: PLC0415 (matplotlib)

    sheet = motion_sheet if _moves(shown) else sheet_figure
    return sheet(list(shown.values()), list(map(str, shown)))


def new_npz(out: str | Path) -> Path:
    """Return the .npz file of that name; WorldError where it is there already."""
    target = Path(out).with_suffix(".npz")
    require_new(target)
    return target


def _write_each(target: Path, chosen: Mapping[int, World], form: str, movable: bool) -> None:
    """Write a file per world into a folder that is there whole or not at all."""
    from barn_worlds.base.files import new_folder  # noqa: PLC0415
    from barn_worlds.drawing.files import write_png  # noqa: PLC0415 (matplotlib)
    from barn_worlds.formats.map_server import write_map  # noqa: PLC0415
    from barn_worlds.formats.sdf import write_sdf  # noqa: PLC0415
    from barn_worlds.formats.tracks_csv import write_tracks  # noqa: PLC0415
    from barn_worlds.formats.world_yaml import write_world_yaml  # noqa: PLC0415

    with new_folder(target) as folder:
        for index, world in chosen.items():
            if form == "png":
                write_png(figure_of(world), folder / f"world_{index}.png")
            elif form == "yaml":
                write_world_yaml(world, folder / f"world_{index}.world.yaml")
            elif form == "tracks":
                write_tracks(world, folder / f"tracks_{index}.csv")
            elif form == "map":
                write_map(world.occupancy_map(), folder / f"map_{index}")
            else:
                flavour, ending = ("classic", ".world") if form == "sdf_classic" else ("gz", ".sdf")
                write_sdf(world, folder / f"world_{index}{ending}", flavour, movable=movable)
