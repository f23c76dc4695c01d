"""Compiled loops that move the bubbles of a band by internal and external forces, as eband_local_planner does.

A heading counts as a third coordinate, `metres_per_rad` for each radian: forces have a torque, and steps turn a bubble.
"""

import math

from numba import njit

from barn_planners.eband import kernels
from barn_planners.eband.kernels import RADIUS, YAW, X, Y

_CLOSE_M = 0.01


@njit(cache=True, error_model="numpy")
def _pull(band, i, x, y, yaw, metres_per_rad):  # type: ignore[no-untyped-def]
    """Return the unit vector from (x, y) to bubble i, with the turn to its heading by the distance; zero if close."""
    dx, dy = band[i, X] - x, band[i, Y] - y
    distance = math.hypot(dx, dy)
    if distance <= _CLOSE_M:
        return 0.0, 0.0, 0.0
    return (
        dx / distance,
        dy / distance,
        metres_per_rad * kernels.wrapped(band[i, YAW] - yaw) / distance,
    )


@njit(cache=True, error_model="numpy")
def force_on(band, i, x, y, radius, yaw, grid, gains):  # type: ignore[no-untyped-def]
    """Return force and torque on bubble i of the band if it were at this pose with this radius.

    Internal: unit vectors to both neighbours. External: the central difference of the radius over its own radius. The
    part along the line through both neighbours is removed.
    """
    before_x, before_y, before_turn = _pull(
        band, i - 1, x, y, yaw, gains.metres_per_rad
    )
    after_x, after_y, after_turn = _pull(band, i + 1, x, y, yaw, gains.metres_per_rad)
    across = 2.0 * max(radius, gains.tiny_bubble_m)
    slope_x = (
        kernels.radius_at(grid, x + radius, y) - kernels.radius_at(grid, x - radius, y)
    ) / across
    slope_y = (
        kernels.radius_at(grid, x, y + radius) - kernels.radius_at(grid, x, y - radius)
    ) / across
    fx = gains.internal_gain * (before_x + after_x) + gains.external_gain * slope_x
    fy = gains.internal_gain * (before_y + after_y) + gains.external_gain * slope_y
    torque = gains.internal_gain * (before_turn + after_turn)
    tx, ty = band[i - 1, X] - band[i + 1, X], band[i - 1, Y] - band[i + 1, Y]
    turn = gains.metres_per_rad * kernels.wrapped(band[i - 1, YAW] - band[i + 1, YAW])
    along = (fx * tx + fy * ty + torque * turn) / max(
        tx * tx + ty * ty + turn * turn, 1e-12
    )
    return fx - along * tx, fy - along * ty, torque - along * turn


@njit(cache=True)
def _overshoots(old, new, gains):  # type: ignore[no-untyped-def]
    """Tell whether the force has reversed, and whether it then keeps too much of its strength."""
    (fx, fy, torque), (new_fx, new_fy, new_torque) = old, new
    turned = fx * new_fx + fy * new_fy + torque * new_torque < 0.0
    strength = math.sqrt(
        fx * fx + (fx * fx if gains.weighs_x_twice else fy * fy) + torque * torque
    )
    new_strength = math.sqrt(
        new_fx * new_fx + new_fy * new_fy + new_torque * new_torque
    )
    return (
        turned,
        new_strength > gains.overshoot * strength
        and new_strength > gains.significant_force,
    )


@njit(cache=True)
def _near_balance(band, i, force, jump, grid, gains):  # type: ignore[no-untyped-def]
    """Return the bubble reached by half of a jump, then half as far each, on or back; radius 0 if none is."""
    x, y, radius, yaw = band[i, X], band[i, Y], 0.0, band[i, YAW]
    share = 0.5
    for depth in range(gains.halvings + 1):
        new_x, new_y, new_yaw = (
            x + share * jump[0],
            y + share * jump[1],
            kernels.wrapped(yaw + share * jump[2]),
        )
        new_radius = kernels.radius_at(grid, new_x, new_y)
        if new_radius <= 0.0:
            break
        x, y, radius, yaw = new_x, new_y, new_radius, new_yaw
        if depth == gains.halvings:
            break
        new_force = force_on(band, i, x, y, radius, yaw, grid, gains)
        turned, strong = _overshoots(force, new_force, gains)
        if turned and not strong:
            break
        share *= -0.5 if turned else 0.5
        force = new_force
    return x, y, radius, yaw


@njit(cache=True)
def _connected(band, i, grid, gains, work):  # type: ignore[no-untyped-def]
    if kernels.overlaps(band, i, band, i + 1, gains.min_overlap):
        return True
    kernels.put(work.nodes, 0, band, i)
    kernels.put(work.nodes, 1, band, i + 1)
    return kernels.bridge(work, 0, 1, 2, grid, gains) >= 0


@njit(cache=True)
def _move(band, i, grid, gains, work):  # type: ignore[no-untyped-def]
    old_x, old_y, old_radius, old_yaw = (
        band[i, X],
        band[i, Y],
        band[i, RADIUS],
        band[i, YAW],
    )
    force = force_on(band, i, old_x, old_y, old_radius, old_yaw, grid, gains)
    fx, fy, torque = force
    turn = (
        kernels.wrapped(old_radius / gains.metres_per_rad * torque)
        if gains.metres_per_rad > 0.0
        else 0.0
    )
    jump = (old_radius * fx, old_radius * fy, turn)
    x, y, yaw = old_x + jump[0], old_y + jump[1], kernels.wrapped(old_yaw + turn)
    radius = kernels.radius_at(grid, x, y)
    if radius <= gains.tiny_bubble_m:
        return
    turned, strong = _overshoots(
        force, force_on(band, i, x, y, radius, yaw, grid, gains), gains
    )
    if turned and strong:
        nearer_x, nearer_y, nearer_radius, nearer_yaw = _near_balance(
            band, i, force, jump, grid, gains
        )
        if nearer_radius > 0.0:
            x, y, radius, yaw = nearer_x, nearer_y, nearer_radius, nearer_yaw
    band[i, X], band[i, Y], band[i, RADIUS], band[i, YAW] = x, y, radius, yaw
    if not (
        _connected(band, i - 1, grid, gains, work)
        and _connected(band, i, grid, gains, work)
    ):
        band[i, X], band[i, Y], band[i, RADIUS], band[i, YAW] = (
            old_x,
            old_y,
            old_radius,
            old_yaw,
        )


@njit(cache=True)
def relax(band, n, grid, gains, work, sweeps):  # type: ignore[no-untyped-def]
    """Apply the forces to the inner bubbles, first to last and back again, and refine, `sweeps` times, in place."""
    for _ in range(sweeps):
        for i in range(1, n - 1):
            _move(band, i, grid, gains, work)
        for i in range(n - 2, 0, -1):
            _move(band, i, grid, gains, work)
        n = kernels.refine(band, n, grid, gains, work)
        if n < 0:
            break
    return n


@njit(cache=True)
def renew(band, n, grid, gains, work):  # type: ignore[no-untyped-def]
    """Recompute radii and refine, in place; return the new length."""
    n = kernels.measure(band, n, grid)
    return n if n < 0 else kernels.refine(band, n, grid, gains, work)


@njit(cache=True)
def from_plan(band, poses, grid, gains, work):  # type: ignore[no-untyped-def]
    """Make a band from poses (n, 3), no more than it has room for; return its length."""
    kernels.place(band, poses, gains)
    return renew(band, len(poses), grid, gains, work)


@njit(cache=True)
def optimise(band, moved, n, grid, gains, work, sweeps):  # type: ignore[no-untyped-def]
    """Renew a band, in place unless that fails, and relax it to `moved`; return the new lengths of both."""
    moved[:n] = band[:n]
    n = renew(moved, n, grid, gains, work)
    if n < 0:
        return n, n
    band[:n] = moved[:n]
    return n, relax(moved, n, grid, gains, work, sweeps)


@njit(cache=True)
def advance(band, trial, n, pose, ahead, grid, gains, work, sweeps):  # type: ignore[no-untyped-def]
    """Connect a band to a pose (x, y, yaw), append poses (k, 3), and optimise it to `trial`, which may fail.

    Returns the length of `band`, that of `trial` or the code of the failure, and whether the poses are appended.
    """
    (x, y, yaw), kept = pose, n
    trial[:n] = band[:n]
    n = kernels.connect_front(trial, n, x, y, yaw, grid, gains, work)
    if n >= 0 and len(ahead) > 0:
        kept = n
        band[:n] = trial[:n]
        n = kernels.append_back(trial, n, ahead, grid, gains, work)
    if n < 0:
        return kept, n, False
    band[:n] = trial[:n]
    renewed, moved = optimise(band, trial, n, grid, gains, work, sweeps)
    return n if renewed < 0 else renewed, moved, True
