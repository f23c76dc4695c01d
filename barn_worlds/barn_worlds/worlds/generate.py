"""Generating worlds and whole data sets from a seed (paper, section III-A)."""

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numba import njit

from barn_worlds.base.arrays import BoolGrid, Integers
from barn_worlds.base.config import Checked, as_dict, quantity
from barn_worlds.base.errors import ConfigError, WorldError
from barn_worlds.formats.own import Order, read_own, write_own
from barn_worlds.worlds.cspace import configuration_space, through_region
from barn_worlds.worlds.parameters import TABLE_I, WorldParameters
from barn_worlds.worlds.path_planner import DEFAULT, PathConfig, plan_path
from barn_worlds.worlds.world import Provenance, World

MOST_WORLDS = 100_000
NARROWNESS = "minus the mean distance in cells from the path's cells to the closest occupied C-space cell"


@dataclass(frozen=True)
class DatasetParameters(Checked):
    """What a data set is generated with; the defaults are those of the shipped barn300."""

    name: str = quantity("barn300", "name of the data set")
    seed: int = quantity(2020, "seed of all randomness", minimum=0, maximum=2**63 - 1)
    worlds_per_set: int = quantity(25, "worlds made with each parameter set", minimum=1, maximum=MOST_WORLDS)
    worlds: int = quantity(0, "worlds in all, dealt to the sets in turn; 0: worlds_per_set each", minimum=0)
    keep: int = quantity(
        0, "worlds kept of those made, evenly spread over their order; 0: all", minimum=0, maximum=MOST_WORLDS
    )
    robot: str = quantity("", "robot that the worlds are made for, if it is not the Jackal")
    sets: tuple[WorldParameters, ...] = TABLE_I
    path: PathConfig = DEFAULT

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= sum(self.counts) <= MOST_WORLDS:
            raise ConfigError(f"sets and worlds_per_set must make 1 to {MOST_WORLDS} worlds")
        self.require(self.keep <= sum(self.counts), "keep", f"must be at most the {sum(self.counts)} worlds made")

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of worlds of each parameter set."""
        each, left = divmod(self.worlds, len(self.sets)) if self.sets else (0, 0)
        return tuple(each + (s < left) if self.worlds else self.worlds_per_set for s in range(len(self.sets)))


def generate_world(
    parameters: WorldParameters,
    generator: np.random.Generator,
    name: str = "generated",
    *,
    path_config: PathConfig = DEFAULT,
    seed: tuple[int, ...] = (),
) -> World:
    """Return a random world; grids without a way through are discarded.

    seed: what `generator` was seeded with, stored as provenance. Raises WorldError if none of `parameters.attempts`
    grids has a way through.
    """
    for _ in range(parameters.attempts):
        grid = grow(parameters, generator)
        cspace = configuration_space(grid, parameters.footprint_cells)
        region = through_region(cspace)
        if region is None:
            continue
        start, goal = (_any(np.flatnonzero(region[:, column]), generator) for column in (0, -1))
        path = plan_path(cspace, (start, 0), (goal, parameters.cols - 1), path_config)
        if path is not None:
            provenance = Provenance("generated", parameters=as_dict(parameters), seed=seed, path_source="planned")
            return World(name, grid, path, parameters.resolution_m, parameters.footprint_cells, provenance)
    raise WorldError(
        f"no passable world in {parameters.attempts} attempts with initial_fill {parameters.initial_fill:g} and "
        f"footprint_cells {parameters.footprint_cells}; fill less, or allow more attempts"
    )


def generate_dataset(parameters: DatasetParameters, progress: Callable[[int, int], None] | None = None) -> list[World]:
    """Return the worlds of a data set, one parameter set after the other.

    World k of set s is drawn from SeedSequence(seed, spawn_key=(s, k)), so it does not depend on how many other worlds
    there are. progress: called after each world with the number made so far and the total.
    """
    worlds: list[World] = []
    for s, (world_parameters, count) in enumerate(zip(parameters.sets, parameters.counts, strict=True)):
        for k in range(count):
            generator = np.random.default_rng(np.random.SeedSequence(parameters.seed, spawn_key=(s, k)))
            worlds.append(
                generate_world(
                    world_parameters,
                    generator,
                    f"{parameters.name}_{s}_{k}",
                    path_config=parameters.path,
                    seed=(parameters.seed, s, k),
                )
            )
            if progress is not None:
                progress(len(worlds), sum(parameters.counts))
    return worlds


def narrowness(world: World) -> float:
    """Return minus the mean distance in cells from the path's cells to the closest occupied C-space cell.

    A simple proxy for difficulty. If nothing is occupied: minus the longer side of the grid.
    """
    occupied = np.argwhere(world.cspace)
    if len(occupied) == 0:
        return -float(max(world.grid.shape))
    closest = [np.hypot(*(occupied - cell).T).min() for cell in world.path]
    return -float(np.mean(closest))


def by_narrowness(worlds: Sequence[World]) -> Order:
    """Return the order of rising narrowness, used until a better score is available."""
    return Order(NARROWNESS, tuple(narrowness(world) for world in worlds))


def ranked_dataset(
    parameters: DatasetParameters,
    rank: Callable[[Sequence[World]], Order] = by_narrowness,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[list[World], Order]:
    """Return the worlds of a data set that are kept, and their order.

    The first and the last in order are always among those kept.
    """
    worlds = generate_dataset(parameters, progress)
    order = rank(worlds)
    if not parameters.keep:
        return worlds, order
    every = np.argsort(order.scores, kind="stable")
    kept = every[np.linspace(0, len(worlds) - 1, parameters.keep).round().astype(np.int64)]
    return [worlds[k] for k in kept], Order(order.by, tuple(order.scores[k] for k in kept))


def reordered(worlds: Sequence[World], order: Order) -> dict[int, World]:
    """Return the worlds by number, from 0, in rising order of score and named world_0, world_1 and so on."""
    if len(order.scores) != len(worlds) or not np.isfinite(order.scores).all():
        raise WorldError(f"order by {order.by!r:.60} must have one finite score for each of {len(worlds)} worlds")
    ranked = np.argsort(order.scores, kind="stable")
    return {k: dataclasses.replace(worlds[i], name=f"world_{k}") for k, i in enumerate(ranked)}


def write_dataset(
    target: Path,
    parameters: DatasetParameters | None = None,
    rank: Callable[[Sequence[World]], Order] = by_narrowness,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Generate a data set, number it by rising score and write it as a .npz file with a manifest beside it.

    `write_dataset(Path("barn300.npz"))` makes what the package ships. rank: returns the scores, predicted or measured.
    """
    chosen = parameters or DatasetParameters()
    worlds, order = ranked_dataset(chosen, rank, progress)
    about: dict[str, object] = {"seed": chosen.seed, "worlds_per_set": chosen.counts[0]}
    about |= {key: value for key, value in (("keep", chosen.keep), ("robot", chosen.robot)) if value}
    about["path_planner"] = as_dict(chosen.path)
    write_ordered(target, chosen.name, worlds, order, about)


def renumber_dataset(source: Path, target: Path, order: Order) -> None:
    """Write the worlds of a data set file renumbered by other scores, one per world in the present order."""
    content = read_own(source)
    positions = np.argsort(content.indices)
    worlds = [content.world(int(position)) for position in positions]
    about = ("seed", "worlds_per_set", "keep", "robot", "path_planner")
    kept = {key: value for key, value in content.manifest.items() if key in about}
    write_ordered(target, str(content.manifest["name"]), worlds, order, kept)


def write_ordered(
    target: Path, name: str, worlds: Sequence[World], order: Order, about: Mapping[str, object]
) -> dict[int, World]:
    """Write worlds as a data set file, numbered by rising score, and return them.

    about: more entries for the manifest, beside the order.
    """
    numbered = reordered(worlds, order)
    write_own(target, name, numbered, {**about, "order": {"by": order.by, "scores": sorted(order.scores)}})
    return numbered


def _any(rows: Integers, generator: np.random.Generator) -> int:
    """Return one of some rows at random; uses `random` alone, the stream that NumPy is least likely to change."""
    return int(rows[int(generator.random() * len(rows))])


def grow(parameters: WorldParameters, generator: np.random.Generator) -> BoolGrid:
    """Return a grid (rows, cols) of obstacles, True where filled."""
    *_, grid = iterations(parameters, generator)
    return grid


def iterations(parameters: WorldParameters, generator: np.random.Generator) -> Iterator[BoolGrid]:
    """Yield the random grid and then the grid after each smoothing iteration (as in Fig. 1 of the paper)."""
    grid = random_fill(parameters, generator)
    yield grid
    for _ in range(parameters.smoothing_iterations):
        grid = smooth(grid, parameters.fill_threshold, parameters.clear_threshold)
        grid[[0, -1]] = True  # with the paper's thresholds they stay filled anyway
        yield grid


def random_fill(parameters: WorldParameters, generator: np.random.Generator) -> BoolGrid:
    """Return a grid filled at random, with its first and last row, the side walls, filled completely."""
    grid: BoolGrid = generator.random((parameters.rows, parameters.cols)) < parameters.initial_fill
    grid[[0, -1]] = True
    return grid


def smooth(grid: BoolGrid, fill_threshold: int = 5, clear_threshold: int = 1) -> BoolGrid:
    """Return the grid after one iteration; every cell looks at the grid before it.

    A cell with at least `fill_threshold` filled cells among its 8 neighbours is filled. One with at most
    `clear_threshold` is cleared. Any other stays as it is. Cells above the first and below the last row count as filled
    (corners included), cells beside the first and the last column as free.
    """
    smoothed: BoolGrid = _smooth(np.ascontiguousarray(grid), fill_threshold, clear_threshold)
    return smoothed


@njit(cache=True)
def _smooth(grid: BoolGrid, fill_threshold: int, clear_threshold: int) -> BoolGrid:
    rows, cols = grid.shape
    smoothed = np.empty((rows, cols), np.bool_)
    for row in range(rows):
        for column in range(cols):
            filled = grid[row, column]
            neighbours = -int(filled)
            for r in range(row - 1, row + 2):
                for c in range(column - 1, column + 2):
                    neighbours += r < 0 or r >= rows or (0 <= c < cols and grid[r, c])
            smoothed[row, column] = neighbours >= fill_threshold or (filled and neighbours > clear_threshold)
    return smoothed
