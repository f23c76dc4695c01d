"""Compiled loops that move the bubbles of an elastic band by internal and external forces.

Bands, grids and work space are those of `kernels`; the method is that of Quinlan and Khatib, ICRA 1993, with the
step control of eband_local_planner.
"""

import math

from numba import njit

from barn_planners.eband.kernels import bridge, measure, overlaps, put, radius_at, refine

_CLOSE_M = 0.01


@njit(cache=True)
def _pull(ax, ay, x, y):  # type: ignore[no-untyped-def]
    """Return the unit vector from (x, y) to (ax, ay), zero where they coincide."""
    dx, dy = ax - x, ay - y
    distance = math.hypot(dx, dy)
    if distance <= _CLOSE_M:
        return 0.0, 0.0
    return dx / distance, dy / distance


@njit(cache=True)
def force_on(band, i, x, y, radius, grid, gains):  # type: ignore[no-untyped-def]
    """Return the force on bubble i of the band if it were at (x, y) with this radius.

    Internal: unit vectors to both neighbours. External: the central difference of the radius over plus and minus the
    bubble's own radius. The part along the line through both neighbours is removed.
    """
    before_x, before_y, after_x, after_y = band[i - 1, 0], band[i - 1, 1], band[i + 1, 0], band[i + 1, 1]
    bx, by = _pull(before_x, before_y, x, y)
    ax, ay = _pull(after_x, after_y, x, y)
    reach = max(radius, gains.tiny_m)
    slope_x = (radius_at(grid, x + reach, y) - radius_at(grid, x - reach, y)) / (2.0 * reach)
    slope_y = (radius_at(grid, x, y + reach) - radius_at(grid, x, y - reach)) / (2.0 * reach)
    fx = gains.internal * (bx + ax) + gains.external * slope_x
    fy = gains.internal * (by + ay) + gains.external * slope_y
    tx, ty = before_x - after_x, before_y - after_y
    along = (fx * tx + fy * ty) / max(tx * tx + ty * ty, 1e-12)
    return fx - along * tx, fy - along * ty


@njit(cache=True)
def _near_balance(band, i, fx, fy, grid, gains):  # type: ignore[no-untyped-def]
    """Return the bubble (x, y, radius) reached by steps of half the length, a quarter, ...; radius 0 if there is none.

    A step to a place where the force has reversed without becoming weak is undone.
    """
    x, y, radius = band[i, 0], band[i, 1], band[i, 2]
    found = (x, y, 0.0)
    step = 0.5
    for _ in range(gains.halvings):
        new_x, new_y = x + step * radius * fx, y + step * radius * fy
        new_radius = radius_at(grid, new_x, new_y)
        if new_radius <= gains.tiny_m:
            return found
        found = (new_x, new_y, new_radius)
        new_fx, new_fy = force_on(band, i, new_x, new_y, new_radius, grid, gains)
        strength, new_strength = math.hypot(fx, fy), math.hypot(new_fx, new_fy)
        turned = fx * new_fx + fy * new_fy < 0.0
        if new_strength < gains.significant or (turned and new_strength <= gains.overshoot * strength):
            return found
        if not turned:
            x, y, radius, fx, fy = new_x, new_y, new_radius, new_fx, new_fy
        step *= 0.5
    return found


@njit(cache=True)
def _connected(band, i, grid, gains, work):  # type: ignore[no-untyped-def]
    """Tell whether bubble i and the next one overlap or the gap between them can be filled."""
    if overlaps(band, i, band, i + 1, gains.overlap):
        return True
    put(work.nodes, 0, band, i)
    put(work.nodes, 1, band, i + 1)
    return bridge(work, 0, 1, 2, grid, gains) >= 0


@njit(cache=True)
def _move(band, i, grid, gains, work):  # type: ignore[no-untyped-def]
    """Move bubble i by its radius times the force on it, if the band stays connected."""
    old_x, old_y, old_radius = band[i, 0], band[i, 1], band[i, 2]
    fx, fy = force_on(band, i, old_x, old_y, old_radius, grid, gains)
    x, y = old_x + old_radius * fx, old_y + old_radius * fy
    radius = radius_at(grid, x, y)
    if radius <= gains.tiny_m:
        return
    new_fx, new_fy = force_on(band, i, x, y, radius, grid, gains)
    new_strength = math.hypot(new_fx, new_fy)
    turned = fx * new_fx + fy * new_fy < 0.0
    if turned and new_strength > gains.overshoot * math.hypot(fx, fy) and new_strength >= gains.significant:
        x, y, radius = _near_balance(band, i, fx, fy, grid, gains)
        if radius <= gains.tiny_m:
            return
    band[i, 0], band[i, 1], band[i, 2] = x, y, radius
    if not (_connected(band, i - 1, grid, gains, work) and _connected(band, i, grid, gains, work)):
        band[i, 0], band[i, 1], band[i, 2] = old_x, old_y, old_radius


@njit(cache=True)
def relax(band, n, grid, gains, work):  # type: ignore[no-untyped-def]
    """Apply the forces to the inner bubbles, first to last and back again, in place."""
    for i in range(1, n - 1):
        _move(band, i, grid, gains, work)
    for i in range(n - 2, 0, -1):
        _move(band, i, grid, gains, work)


@njit(cache=True)
def optimise(band, n, grid, gains, work, sweeps):  # type: ignore[no-untyped-def]
    """Recompute radii, refine, then relax and refine `sweeps` times, in place; return the new length."""
    n = measure(band, n, grid)
    if n >= 0:
        n = refine(band, n, grid, gains, work)
    for _ in range(sweeps):
        if n < 0:
            break
        relax(band, n, grid, gains, work)
        n = refine(band, n, grid, gains, work)
    return n
