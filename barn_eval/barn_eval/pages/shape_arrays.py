"""Shapes and places as the small arrays that the scripts of pages draw from."""

from typing import Any

import numpy as np
import numpy.typing as npt

from barn_eval.bags.movers import TRAIL_S
from barn_worlds.base.arrays import Floats
from barn_worlds.geometry.bodies import Bodies, moving_bodies, wall_bodies
from barn_worlds.worlds.world import World

Packable = npt.NDArray[Any]
_CLOSED_M = 0.01
_FARTHEST_M = 32.0  # that whole millimetres of two bytes reach


def shape_array(bodies: Bodies) -> Packable:
    """Return x, y, yaw, radius and both sizes of bodies, one after the other, as `Shapes` in motion.js reads them."""
    return np.column_stack([bodies.poses, bodies.radius_m, bodies.size_m]).astype("f4")


def in_millimetres(values_m: Floats) -> tuple[Packable, float]:
    """Return metres as whole millimetres of two bytes and the step 0.001, or as they are and 1 where they are large."""
    if np.abs(values_m).max(initial=0.0) < _FARTHEST_M:
        return np.round(1000.0 * values_m).astype("i2"), 0.001
    return values_m.astype("f4"), 1.0


def motion_arrays(world: World, arrays: dict[str, Packable]) -> dict[str, float]:
    """Add the motions of a world's obstacles as polynomials, their shapes and the walls; return what describes them."""
    arrays["box_walls"] = shape_array(wall_bodies(world.walls))
    arrays["mover_shapes"] = shape_array(moving_bodies(world.tracks, 0.0))
    first, begin, duration, coefficients, period, phase = world.tracks.table
    arrays["mover_first"] = first.astype("i4")
    arrays["mover_begin"], arrays["mover_duration"] = begin.astype("f4"), duration.astype("f4")
    arrays["mover_coefficients"], step_m = in_millimetres(coefficients)
    arrays["mover_periods"], arrays["mover_phases"] = period.astype("f4"), phase.astype("f4")
    ends = coefficients[first[1:] - 1].sum(axis=2) - coefficients[first[:-1], :, 0]
    arrays["mover_closed"] = (np.hypot(*ends.T) < _CLOSED_M).astype("u1")
    return {"powers": coefficients.shape[2], "step": step_m, "trail": TRAIL_S}
