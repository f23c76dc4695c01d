"""Kernels that move the bubbles of a band by internal and external forces.

They follow eband_local_planner.cpp. A heading counts as a third coordinate,
`metres_per_rad` for each radian: forces have a torque, and a step turns a bubble.
"""

import math
from typing import NamedTuple

from barn_planners.costmap.kernels import Pose
from barn_planners.eband.kernels import (
    RADIUS,
    YAW,
    BandGains,
    Context,
    X,
    Y,
    append_back,
    bridge,
    connect_front,
    measure,
    overlap,
    place,
    put,
    radius_at,
    refine,
    wrap,
)
from barn_worlds.base.arrays import Floats, kernel

# Below this the direction of a neighbor is rounding.
_CLOSE_M = 0.01


class Bubble(NamedTuple):
    """A bubble that may take the place of one of the band."""

    x: float
    y: float
    radius: float
    yaw: float


class Vector(NamedTuple):
    """A force or a step; `turn` is a torque, or an angle in rad."""

    x: float
    y: float
    turn: float


@kernel
def _pull(band: Floats, i: int, bubble: Bubble, metres_per_rad: float) -> Vector:
    """Return unit vector and torque toward bubble i of the band, zero within 1 cm."""
    dx = band[i, X] - bubble.x
    dy = band[i, Y] - bubble.y
    distance = math.hypot(dx, dy)
    if distance <= _CLOSE_M:
        return Vector(0.0, 0.0, 0.0)

    turn = metres_per_rad * wrap(band[i, YAW] - bubble.yaw) / distance
    return Vector(dx / distance, dy / distance, turn)


@kernel
def force_on(band: Floats, i: int, bubble: Bubble, context: Context) -> Vector:
    """Return force and torque on `bubble`, were it in place of bubble i of the band.

    Internal force: unit vectors to both neighbors. External force: the central
    difference of the radius over the bubble's own radius. The part along the line
    through both neighbors is removed. Follows `calcInternalForces`,
    `calcExternalForces` and `suppressTangentialForces`.

    Args:
        band: Band with the neighbors.
        i: Place of the bubble in the band, neither first nor last.
        bubble: Bubble to look at.
        context: What bubbles depend on.
    """
    gains = context.gains
    clearance = context.clearance
    x, y, radius, _ = bubble
    before = _pull(band, i - 1, bubble, gains.metres_per_rad)
    after = _pull(band, i + 1, bubble, gains.metres_per_rad)
    # The gradient is taken over the bubble's own width: small bubbles look closely.
    across = 2.0 * max(radius, gains.tiny_bubble_m)
    right = radius_at(clearance, x + radius, y)
    slope_x = (right - radius_at(clearance, x - radius, y)) / across
    upper = radius_at(clearance, x, y + radius)
    slope_y = (upper - radius_at(clearance, x, y - radius)) / across
    fx = gains.internal_gain * (before.x + after.x) + gains.external_gain * slope_x
    fy = gains.internal_gain * (before.y + after.y) + gains.external_gain * slope_y
    torque = gains.internal_gain * (before.turn + after.turn)

    # Forces along the band would only push bubbles together.
    tx = band[i - 1, X] - band[i + 1, X]
    ty = band[i - 1, Y] - band[i + 1, Y]
    turn = gains.metres_per_rad * wrap(band[i - 1, YAW] - band[i + 1, YAW])
    # Both neighbors in one place have no line through them; nothing is removed then.
    square = max(tx * tx + ty * ty + turn * turn, 1e-12)
    along = (fx * tx + fy * ty + torque * turn) / square
    return Vector(fx - along * tx, fy - along * ty, torque - along * turn)


@kernel
def _is_reversed(force: Vector, new: Vector) -> bool:
    """Return whether the product of two forces, torques included, is negative."""
    return force.x * new.x + force.y * new.y + force.turn * new.turn < 0.0


@kernel
def _is_strong(force: Vector, new: Vector, gains: BandGains) -> bool:
    """Return whether `new`, a reversed force, is still strong compared to `force`."""
    # The original takes x twice and no y here.
    other = force.x if gains.weighs_x_twice else force.y
    strength = math.sqrt(force.x * force.x + other * other + force.turn * force.turn)
    new_strength = math.sqrt(new.x * new.x + new.y * new.y + new.turn * new.turn)
    return (
        new_strength > gains.overshoot * strength
        and new_strength > gains.significant_force
    )


@kernel
def _step(bubble: Bubble, step: Vector, share: float, context: Context) -> Bubble:
    """Return a bubble moved by a share of a step, with the radius at its new center."""
    x = bubble.x + share * step.x
    y = bubble.y + share * step.y
    radius = radius_at(context.clearance, x, y)
    return Bubble(x, y, radius, wrap(bubble.yaw + share * step.turn))


@kernel
def _near_balance(
    band: Floats, i: int, force: Vector, step: Vector, context: Context
) -> Bubble:
    """Return bubble i bisected along `step` to near balance; radius 0 if it is stuck.

    Its radius is 0 if the first half step is not possible. Follows
    `EBandPlanner::moveApproximateEquilibrium` without its recursion.
    """
    gains = context.gains
    bubble = Bubble(band[i, X], band[i, Y], 0.0, band[i, YAW])
    share = 0.5
    for depth in range(gains.halvings + 1):
        moved = _step(bubble, step, share, context)
        if moved.radius <= 0.0:
            break
        bubble = moved
        if depth == gains.halvings:
            break

        new_force = force_on(band, i, bubble, context)
        is_reversed = _is_reversed(force, new_force)
        if is_reversed and not _is_strong(force, new_force, gains):
            break
        # Bisection: back if the force has reversed on the way, on if not.
        share *= -0.5 if is_reversed else 0.5
        force = new_force

    return bubble


@kernel
def _is_connected(band: Floats, i: int, context: Context) -> bool:
    """Return whether bubbles i and i + 1 overlap or could be bridged; adds none."""
    if overlap(band, i, band, i + 1, context.gains.min_overlap):
        return True

    # Only whether a bridge is possible counts; `refine` builds it later.
    context.work.nodes[:2] = band[i : i + 2]
    return bridge(context, 0, 1, 2) >= 0


@kernel
def _move(band: Floats, i: int, context: Context) -> None:
    """Move bubble i by its force, in place, unless that hits something or tears it off.

    Follows `EBandPlanner::applyForces`.
    """
    gains = context.gains
    old = Bubble(band[i, X], band[i, Y], band[i, RADIUS], band[i, YAW])
    force = force_on(band, i, old, context)
    # A torque turns by an angle only if angles count.
    turn = 0.0
    if gains.metres_per_rad > 0.0:
        turn = wrap(old.radius / gains.metres_per_rad * force.turn)
    step = Vector(old.radius * force.x, old.radius * force.y, turn)
    bubble = _step(old, step, 1.0, context)
    # A step into an obstacle leaves the bubble where it was.
    if bubble.radius <= gains.tiny_bubble_m:
        return

    new_force = force_on(band, i, bubble, context)
    if _is_reversed(force, new_force) and _is_strong(force, new_force, gains):
        nearer = _near_balance(band, i, force, step, context)
        if nearer.radius > 0.0:
            bubble = nearer

    # Forces know nothing of gaps, so a step that tears the band is taken back.
    put(band, i, bubble.x, bubble.y, bubble.radius, bubble.yaw)
    if not (_is_connected(band, i - 1, context) and _is_connected(band, i, context)):
        put(band, i, old.x, old.y, old.radius, old.yaw)


@kernel
def relax(band: Floats, n: int, context: Context) -> int:
    """Move inner bubbles by forces and refine; return the count, below 0 on failure.

    Follows `EBandPlanner::modifyBandArtificialForce`.

    Args:
        band: Band to change.
        n: Its length.
        context: What bubbles depend on.

    Returns:
        The new length, or a code of REASONS.
    """
    for _ in range(context.gains.sweeps):
        for i in range(1, n - 1):
            _move(band, i, context)
        # Back as well as forth: on one pass each bubble sees one neighbor that has
        # moved already and one that has not.
        for i in range(n - 2, 0, -1):
            _move(band, i, context)
        n = refine(band, n, context)
        if n < 0:
            break
    return n


@kernel
def renew(band: Floats, n: int, context: Context) -> int:
    """Recompute radii and refine, in place; return the count, below 0 on failure.

    Args:
        band: Band to change.
        n: Its length.
        context: What bubbles depend on.

    Returns:
        The new length, or a code of REASONS.
    """
    # The costmap has changed since the radii were computed.
    n = measure(band, n, context.clearance)
    if n < 0:
        return n
    return refine(band, n, context)


@kernel
def from_plan(band: Floats, poses: Floats, context: Context) -> int:
    """Write a refined band from a plan; return how many bubbles, below 0 on failure.

    Args:
        band: Band to write, with room for the poses.
        poses: Poses (n, 3), x and y in m, yaw in rad.
        context: What bubbles depend on.

    Returns:
        The length of the band, or a code of REASONS.
    """
    place(band, poses, context.gains)
    return renew(band, len(poses), context)


@kernel
def optimize(band: Floats, trial: Floats, n: int, context: Context) -> tuple[int, int]:
    """Renew a band in place, relax a copy into `trial`; return both bubble counts.

    Args:
        band: Band to renew; it stays as it is if that fails.
        trial: Band that receives the relaxed copy.
        n: Length of the band.
        context: What bubbles depend on.

    Returns:
        The new lengths of both, or codes of REASONS.
    """
    # On the copy, so that a failure leaves the band as it is.
    trial[:n] = band[:n]
    n = renew(trial, n, context)
    if n < 0:
        return n, n

    band[:n] = trial[:n]
    return n, relax(trial, n, context)


@kernel
def advance(
    band: Floats,
    trial: Floats,
    n: int,
    pose: Pose,
    ahead: Floats,
    context: Context,
) -> tuple[int, int, bool]:
    """Connect a band to the robot, append poses, renew it; relax a copy in `trial`.

    What fails leaves the band as the steps before have made it.

    Args:
        band: Band to change.
        trial: Band that receives the relaxed copy.
        n: Length of the band.
        pose: Pose of the robot.
        ahead: Poses (k, 3) to append, x and y in m, yaw in rad.
        context: What bubbles depend on.

    Returns:
        Length of the band; length of the trial band or a code of REASONS; whether the
        poses are part of the band.
    """
    trial[:n] = band[:n]
    length = connect_front(trial, n, pose, context)
    if length >= 0 and len(ahead) > 0:
        n = length
        band[:n] = trial[:n]
        length = append_back(trial, n, ahead, context)
    if length < 0:
        return n, length, False

    band[:length] = trial[:length]
    renewed, relaxed = optimize(band, trial, length, context)
    return (length if renewed < 0 else renewed), relaxed, True
