"""What the difficulty model sees of a world, in a fixed order: numbers that sum it up, then what lies beside routes."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache

import numpy as np

from barn_metrics.features import world_features
from barn_metrics.metrics import METRIC_NAMES, world_metrics
from barn_metrics.model import route as routing
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import ModelError
from barn_worlds.worlds.world import World

Named = Iterator[tuple[str, float]]
_LARGEST = 1e6  # stands for infinity: a metric of a world without obstacles
_WIDTHS_M = (0.7, 0.85, 1.0, 1.1)
_CLEARANCES_M = (0.2, 0.25, 0.3, 0.4)
_BLOCKED = 30.0  # cost per metre of going through obstacles all the same
_SHARP_SAMPLES = 6  # of 0.1 m, over which a change of heading is one turn


def _hard(radius_m: float, price: float) -> Callable[[Floats], Floats]:
    """Cost 1 where a disc of that radius fits, `price` where it does not."""
    return lambda clearance: np.where(clearance < radius_m, price, 1.0)


def _soft(
    slowest_m: float, quickest_m: float, slowest: float
) -> Callable[[Floats], Floats]:
    """Time per metre at a speed that rises with clearance from `slowest` to 1."""
    return lambda clearance: (
        1.0 / np.clip((clearance - slowest_m) / (quickest_m - slowest_m), slowest, 1.0)
    )


def _planned(inscribed_m: float, free_m: float) -> Callable[[Floats], Floats]:
    """Cost of a global plan on an inflated costmap: `_BLOCKED` up to one clearance, falling, 1 beyond the other."""

    def cost(clearance: Floats) -> Floats:
        soft = 1.0 + 4.0 * np.exp(-10.0 * (clearance - inscribed_m))
        return np.select(
            [clearance <= inscribed_m, clearance <= free_m], [_BLOCKED, soft], 1.0
        )

    return cost


# Cost per metre of each route: as the global planner of the paper's trials has it, through all that the bare robot and
# the robot with padding fit through, and the quickest for a robot that slows down near obstacles.
_ROUTES: dict[str, Callable[[Floats], Floats]] = {
    "planned": _planned(0.195, 0.30),
    "bare": _hard(0.20, _BLOCKED),
    "padded": _hard(0.27, _BLOCKED),
    "quick": _soft(0.15, 0.45, 0.05),
}
_SUMMED_UP = ("bare", "padded", "quick")
STRIPS = ("planned", "padded", "quick")  # which of them are seen as strips


def _inputs(world: World) -> Named:
    where = routing.clearance_map(world)
    routes = {
        name: routing.cheapest_route(where, cost(where.clearance_m))
        for name, cost in _ROUTES.items()
    }
    yield from _summed_up(world, where, routes)
    for name in STRIPS:
        strip = routing.route_strip(where, routes[name])
        yield from zip(routing.strip_names(name), strip.ravel().tolist(), strict=True)


def _summed_up(
    world: World, where: routing.ClearanceMap, routes: Mapping[str, routing.Route]
) -> Named:
    yield from zip(METRIC_NAMES, world_metrics(world).as_array().tolist(), strict=True)
    # Both hold tortuosity; it counts once.
    yield from (
        (name, value)
        for name, value in world_features(world).items()
        if name not in METRIC_NAMES
    )
    yield from _ends(where)
    for name in _SUMMED_UP:
        yield from (
            (f"{name}_{what}", value)
            for what, value in _along(routes[name], world.path_length_m)
        )


def _ends(where: routing.ClearanceMap) -> Named:
    """Yield how much room there is where the paper's trials start and end, and one cell ahead of the goal."""
    places = (
        ("start", where.start, 0),
        ("goal", where.goal, 0),
        ("goal_ahead", where.goal, 3),
    )
    for name, (row, column), ahead in places:
        near, far = (_around(where, row, column + ahead, reach) for reach in (2, 4))
        yield f"{name}_clearance_m", near[len(near) // 2, near.shape[1] // 2]
        yield f"{name}_clearance_lowest_m", float(near.min())
        yield f"{name}_clearance_highest_m", float(far.max())


def _around(where: routing.ClearanceMap, row: int, column: int, reach: int) -> Floats:
    """Return the clearances about a cell, (2 reach + 1, 2 reach + 1), the map's edge repeated."""
    reached = np.arange(-reach, reach + 1)
    return where.clearance_m.take(row + reached, axis=0, mode="clip").take(
        column + reached, axis=1, mode="clip"
    )


def _along(route: routing.Route, path_length_m: float) -> Named:
    heading = route.heading_rad
    turning = np.abs(np.diff(heading))
    yield "cost_m", route.cost_m
    yield "cost_per_path", route.cost_m / max(path_length_m, 0.1)
    yield "length_m", route.length_m
    yield "length_per_path", route.length_m / max(path_length_m, 0.1)
    yield "turning_rad", float(turning.sum())
    yield (
        "sharpest_rad",
        float(
            np.abs(heading[_SHARP_SAMPLES:] - heading[:-_SHARP_SAMPLES]).max(
                initial=0.0
            )
        ),
    )
    yield "heading_highest_rad", float(np.abs(heading).max())
    clearance, width = np.sort(route.clearance_m), np.sort(route.width_m)
    yield "clearance_lowest_m", float(clearance[0])
    yield "clearance_p10_m", float(clearance[len(clearance) // 10])
    yield "clearance_mean_m", float(clearance.mean())
    yield "width_lowest_m", float(width[0])
    yield "width_p10_m", float(width[len(width) // 10])
    yield "width_p25_m", float(width[len(width) // 4])
    yield "width_mean_m", float(width.mean())
    yield from (
        (f"width_below_{limit:g}_share", float((width < limit).mean()))
        for limit in _WIDTHS_M
    )
    yield from (
        (f"clearance_below_{limit:g}_share", float((clearance < limit).mean()))
        for limit in _CLEARANCES_M
    )
    yield (
        "slowed_m",
        float(
            (1.0 / np.clip(clearance / _CLEARANCES_M[-1], 0.25, 1.0)).mean()
            * route.length_m
        ),
    )


@cache
def input_names() -> tuple[str, ...]:
    """Return the names of the inputs, in order."""
    straight = np.stack([np.full(5, 2), np.arange(5)], axis=1)
    grid = np.zeros((5, 5), np.bool_)
    grid[[0, -1]] = True
    return tuple(
        name for name, _ in _inputs(World("names", grid, straight, footprint_cells=1))
    )


def summary_names() -> tuple[str, ...]:
    """Return the names of the inputs that sum a world up, which come first."""
    return input_names()[: -len(STRIPS) * routing.SAMPLES * routing.CHANNELS]


def inputs_of(worlds: Iterable[World]) -> Floats:
    """Return the inputs of worlds, (n, d); ModelError for an arena."""
    rows = []
    for world in worlds:
        if world.corner_m is not None:
            raise ModelError(
                f"{world.name}: is an arena; models are of worlds whose obstacles stand on a grid"
            )
        rows.append(np.array([value for _, value in _inputs(world)]))
    finite: Floats = np.nan_to_num(rows, nan=0.0, posinf=_LARGEST, neginf=-_LARGEST)
    return finite
