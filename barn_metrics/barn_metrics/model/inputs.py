"""The difficulty model's inputs from a world, in a fixed order.

They begin with numbers that summarize the world and end with strips along routes.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from functools import cache

import numpy as np

from barn_metrics.features import world_features
from barn_metrics.metrics import world_metrics
from barn_metrics.model.route import (
    ClearanceMap,
    Route,
    cheapest_route,
    clearance_map,
    route_strip,
    strip_names,
)
from barn_worlds.base.arrays import Floats
from barn_worlds.worlds.world import World

# Stands for infinity: a metric of a world without obstacles.
_INFINITY = 1e6
_WIDTH_LIMITS_M = (0.7, 0.85, 1.0, 1.1)
_CLEARANCE_LIMITS_M = (0.2, 0.25, 0.3, 0.4)
# Cost per meter of going through obstacles all the same.
_BLOCKED = 30.0
# Samples of 0.1 m over which a change of heading is one turn.
_TURN_SAMPLES = 6

# From clearance in m to cost per meter, both (rows, cols).
CostFunction = Callable[[Floats], Floats]


def _disc_cost(radius_m: float) -> CostFunction:
    """Return a cost function: 1 per m where a disc fits, elsewhere `_BLOCKED`."""
    return lambda clearance: np.where(clearance < radius_m, _BLOCKED, 1.0)


def _travel_time(clearance: Floats) -> Floats:
    """Return cost per m, 20 to 1, as 1 / speed, where speed rises with clearance."""
    return 1.0 / np.clip((clearance - 0.15) / (0.45 - 0.15), 0.05, 1.0)


def _costmap_cost(clearance: Floats) -> Floats:
    """Return cost per m: `_BLOCKED` up to 0.195 m, decaying up to 0.3 m, then 1."""
    inscribed_m = 0.195
    inflation_m = 0.30
    decay = 1.0 + 4.0 * np.exp(-10.0 * (clearance - inscribed_m))
    return np.select(
        [clearance <= inscribed_m, clearance <= inflation_m], [_BLOCKED, decay], 1.0
    )


_ROUTE_COSTS: Mapping[str, CostFunction] = {
    # As the global planner of the paper's trials plans.
    "planned": _costmap_cost,
    # Through everything that the bare robot, and the robot with padding, fits through.
    "bare": _disc_cost(0.20),
    "padded": _disc_cost(0.27),
    # Quickest for a robot that slows down near obstacles.
    "quick": _travel_time,
}
# Routes that numbers sum up, and routes that are seen as strips.
_SUMMARY_ROUTES = ("bare", "padded", "quick")
STRIPS = ("planned", "padded", "quick")


@cache
def summary_names() -> tuple[str, ...]:
    """Return the names of the inputs that summarize a world; they come first."""
    # Names do not depend on the world, so the smallest one that has all inputs will do.
    straight = np.stack([np.full(5, 2), np.arange(5)], axis=1)
    grid = np.zeros((5, 5), np.bool_)
    grid[[0, -1]] = True
    world = World("names", grid, straight, footprint_cells=1)
    clearance = clearance_map(world)
    return tuple(_summarize(world, clearance, _find_routes(clearance)))


@cache
def input_names() -> tuple[str, ...]:
    """Return the names of all inputs of the difficulty model: summary, then strips."""
    names = list(summary_names())
    for route in STRIPS:
        names += strip_names(route)
    return tuple(names)


def inputs_of(worlds: Iterable[World]) -> Floats:
    """Return worlds' inputs (n, d), NaN 0, infinity +-1e6; WorldError for an arena.

    Raises:
        WorldError: If one of them is an arena, or its path meets the C-space.
    """
    rows = []
    for world in worlds:
        clearance = clearance_map(world)
        routes = _find_routes(clearance)
        summary = list(_summarize(world, clearance, routes).values())
        strips = [route_strip(clearance, routes[name]).ravel() for name in STRIPS]
        rows.append(np.concatenate([summary, *strips]))

    inputs: Floats = np.nan_to_num(rows, nan=0.0, posinf=_INFINITY, neginf=-_INFINITY)
    return inputs


def _find_routes(clearance: ClearanceMap) -> dict[str, Route]:
    """Return the cheapest route for each of `_ROUTE_COSTS`, by its name."""
    return {
        name: cheapest_route(clearance, cost(clearance.clearance_m))
        for name, cost in _ROUTE_COSTS.items()
    }


def _summarize(
    world: World, clearance: ClearanceMap, routes: Mapping[str, Route]
) -> dict[str, float]:
    """Return a world's summary inputs by name, in order; some may be infinite."""
    # Tortuosity is a metric and a feature; the metric comes first and counts.
    metrics = asdict(world_metrics(world))
    summary = metrics | world_features(world) | metrics | _summarize_ends(clearance)
    for name in _SUMMARY_ROUTES:
        for figure, value in _summarize_route(
            routes[name], world.path_length_m
        ).items():
            summary[f"{name}_{figure}"] = value
    return summary


def _summarize_ends(clearance: ClearanceMap) -> dict[str, float]:
    """Return clearance (m) at and near start, goal and a cell beyond, by name."""
    # Three fine cells are one of the world.
    ahead = (clearance.goal[0], clearance.goal[1] + 3)
    places = {"start": clearance.start, "goal": clearance.goal, "goal_ahead": ahead}
    summary = {}
    for name, (row, column) in places.items():
        near = _surroundings(clearance, row, column, 2)
        far = _surroundings(clearance, row, column, 4)
        summary[f"{name}_clearance_m"] = float(near[2, 2])
        summary[f"{name}_clearance_lowest_m"] = float(near.min())
        summary[f"{name}_clearance_highest_m"] = float(far.max())
    return summary


def _surroundings(clearance: ClearanceMap, row: int, column: int, reach: int) -> Floats:
    """Return clearances (m) around a fine cell, a square array; the edge repeats."""
    offsets = np.arange(-reach, reach + 1)
    rows = clearance.clearance_m.take(row + offsets, axis=0, mode="clip")
    return rows.take(column + offsets, axis=1, mode="clip")


def _summarize_route(route: Route, path_length_m: float) -> dict[str, float]:
    """Return cost, length, turning, clearance and width figures of a route, by name."""
    heading = route.heading_rad
    turns = np.abs(heading[_TURN_SAMPLES:] - heading[:-_TURN_SAMPLES])
    # A path of one cell has no length to divide by.
    path_length_m = max(path_length_m, 0.1)
    clearance = np.sort(route.clearance_m)
    width = np.sort(route.width_m)
    slowness = 1.0 / np.clip(clearance / _CLEARANCE_LIMITS_M[-1], 0.25, 1.0)
    summary = {
        "cost_m": route.cost_m,
        "cost_per_path": route.cost_m / path_length_m,
        "length_m": route.length_m,
        "length_per_path": route.length_m / path_length_m,
        "turning_rad": np.abs(np.diff(heading)).sum(),
        "sharpest_rad": turns.max(initial=0.0),
        "heading_highest_rad": np.abs(heading).max(),
        "clearance_lowest_m": clearance[0],
        "clearance_p10_m": clearance[len(clearance) // 10],
        "clearance_mean_m": clearance.mean(),
        "width_lowest_m": width[0],
        "width_p10_m": width[len(width) // 10],
        "width_p25_m": width[len(width) // 4],
        "width_mean_m": width.mean(),
    }
    for limit in _WIDTH_LIMITS_M:
        summary[f"width_below_{limit:g}_share"] = (width < limit).mean()
    for limit in _CLEARANCE_LIMITS_M:
        summary[f"clearance_below_{limit:g}_share"] = (clearance < limit).mean()
    summary["slowed_m"] = slowness.mean() * route.length_m
    return summary
