"""Parts of a tick for several robots at once, each in a lane of vector instructions, as `ticks` does them.

A loop over the lanes has neither branches nor calls but those that are inlined, so that the compiler makes vector
instructions of it. Its operations are those for one robot, in the same order, which gives the same bits.
"""

import math

from numba import njit

from barn_sim.body.friction import SURELY, Motion, after, clipped_abreast, effect_of, hypot_abreast
from barn_sim.body.tyres import arm_of, below_hub, carried_on, load_on, placed, rotation, world_inertia
from barn_sim.motion.free_motion import attitude_of, basis_of, rate_of, spun, triple, turned_by, world_tensor
from barn_sim.motion.layout import (
    ARM,
    ATTITUDE,
    ATTITUDE_BEFORE,
    CARRIED,
    CLEAR,
    CLEARANCE,
    COSINE,
    FORCE,
    FREE,
    HALF,
    HEADING,
    HEADING_BEFORE,
    IMPULSE,
    INVERSE,
    LANES,
    LEVERS,
    LIMIT,
    LOOKED_FROM,
    MOTION,
    MOVES,
    POSE,
    POSITION,
    POSITION_BEFORE,
    RATE,
    RIM,
    RIMS,
    SINE,
    SPIN,
    SPIN_AFTER,
    STEP,
    SURE,
    TORQUE,
    TURN,
    USUAL,
    VELOCITY,
    WHEEL_ROWS,
    YAW_COSINE,
    YAW_SINE,
    four,
    matrix,
    put_matrix,
    put_three,
    replace_four,
    replace_three,
    three,
)
from barn_sim.motion.state import Record
from barn_worlds.base.arrays import Floats

_MORE = 1.1 * (1.0 + 1e-9)  # as in `barn_sim.motion.ticks`, and more than sums are rounded by


@njit(cache=True, forceinline=True)
def _wheel(wheels: Floats, i: int) -> Floats:
    return wheels[i * WHEEL_ROWS * LANES : (i + 1) * WHEEL_ROWS * LANES]


@njit(cache=True, error_model="numpy")
def begin(rows: Floats, wheels: Floats, hubs: Floats, fixed: Record) -> None:
    """Begin a tick as `stand` and `begin_friction` do, up to the first sweep; lanes that are not USUAL cannot."""
    tick, friction, stiffness, damping = fixed.tick_s, fixed.friction, fixed.stiffness, fixed.damping
    radius, inverse_inertia = fixed.wheel_radius_m, triple(fixed.inverse_inertia)
    for k in range(LANES):
        turn = rotation(four(rows, ATTITUDE, k))
        put_matrix(rows, TURN, k, turn)
        put_matrix(rows, INVERSE, k, world_inertia(turn, inverse_inertia))
        put_three(rows, CARRIED, k, (0.0, 0.0, 0.0))
    for i in range(len(hubs)):
        wheel, hub = _wheel(wheels, i), (hubs[i, 0], hubs[i, 1], hubs[i, 2])
        for k in range(LANES):
            turn = matrix(rows, TURN, k)
            arm = arm_of(turn, hub, below_hub(turn, radius))
            height, sinking = rows[(POSITION + 2) * LANES + k], rows[(VELOCITY + 2) * LANES + k]
            load = load_on(arm, height, sinking, three(rows, SPIN, k), stiffness, damping)
            put_three(wheel, ARM, k, arm)
            wheel[LIMIT * LANES + k] = friction * tick * load
            fz, tx, ty = three(rows, CARRIED, k)
            put_three(rows, CARRIED, k, (fz + load, tx + arm[1] * load, ty - arm[0] * load))
    for k in range(LANES):
        turn = matrix(rows, TURN, k)
        _, tx, ty = three(rows, CARRIED, k)
        motion = carried_on(three(rows, VELOCITY, k), three(rows, SPIN, k), matrix(rows, INVERSE, k), tx, ty, tick)
        _put_motion(rows, k, motion)
        length, usual = hypot_abreast(turn[1][1], -turn[0][1])
        length = length if length > 1e-12 else 1e-12
        rows[USUAL * LANES + k] = 1.0 if usual else 0.0
        put_three(rows, TURN, k, (turn[1][1] / length, -turn[0][1] / length, 0.0))
    for i in range(fixed.grips):
        rims = rows[(RIMS + i % 2) * LANES : (RIMS + i % 2 + 1) * LANES]
        _begin_wheel(rows, _wheel(wheels, i), rims, fixed.inverse_mass)


@njit(cache=True, forceinline=True)
def _put_motion(rows: Floats, k: int, motion: Motion) -> None:
    put_three(rows, MOTION, k, motion[:3])
    rows[(MOTION + 3) * LANES + k], rows[(MOTION + 4) * LANES + k] = motion[3], motion[4]


@njit(cache=True, error_model="numpy")
def _begin_wheel(rows: Floats, wheel: Floats, rims: Floats, inverse_mass: float) -> None:
    for k in range(LANES):
        levers, (mean, half, beside) = effect_of(three(wheel, ARM, k), matrix(rows, INVERSE, k), inverse_mass)
        length, usual = hypot_abreast(half, beside)
        limit = wheel[LIMIT * LANES + k]
        surely = SURELY * limit * limit
        x, y, right = clipped_abreast(wheel[k], wheel[LANES + k], limit, surely)
        usual = usual and right
        rows[USUAL * LANES + k] = rows[USUAL * LANES + k] if usual else 0.0
        wheel[IMPULSE * LANES + k], wheel[(IMPULSE + 1) * LANES + k] = x, y
        put_three(wheel, LEVERS, k, levers[:3])
        put_three(wheel, LEVERS + 3, k, levers[3:])
        wheel[STEP * LANES + k], wheel[SURE * LANES + k] = 1.0 / (mean + length), surely
        ahead, beside, _ = three(rows, TURN, k)
        wheel[RIM * LANES + k], wheel[(RIM + 1) * LANES + k] = rims[k] * ahead, rims[k] * beside
        vx, vy, wx = three(rows, MOTION, k)
        wy, wz = rows[(MOTION + 3) * LANES + k], rows[(MOTION + 4) * LANES + k]
        motion = after((vx, vy, wx, wy, wz), levers, inverse_mass, x, y)
        _put_motion(rows, k, motion)


@njit(cache=True, error_model="numpy")
def act(rows: Floats, wheels: Floats, contacts: int, fixed: Record) -> None:
    """Find what the ground does, as `forces`, and what `ticks` asks before it moves a body and as it does."""
    tick = fixed.tick_s
    for k in range(LANES):
        fz, tx, ty = three(rows, CARRIED, k)
        put_three(rows, FORCE, k, (0.0, 0.0, fz))
        put_three(rows, TORQUE, k, (tx, ty, 0.0))
    for i in range(contacts):
        wheel = _wheel(wheels, i)
        for k in range(LANES):
            x, y, arm = wheel[k] / tick, wheel[LANES + k] / tick, three(wheel, ARM, k)
            fx, fy, fz = three(rows, FORCE, k)
            tx, ty, tz = three(rows, TORQUE, k)
            put_three(rows, FORCE, k, (fx + x, fy + y, fz))
            put_three(rows, TORQUE, k, (tx - arm[2] * y, ty + arm[2] * x, tz + (arm[0] * y - arm[1] * x)))
    _look_ahead(rows, fixed)


@njit(cache=True, error_model="numpy")
def _look_ahead(rows: Floats, fixed: Record) -> None:
    tick, inverse_mass, inverse = fixed.tick_s, fixed.inverse_mass, triple(fixed.inverse_inertia)
    extent, centre = fixed.extent, triple(fixed.centre)
    reach = math.hypot(max(abs(extent[0]), abs(extent[2])), max(abs(extent[1]), abs(extent[3])))
    arm = reach + abs(centre[0]) + abs(centre[1]) + abs(centre[2])
    largest = max(inverse[0], inverse[1])
    for k in range(LANES):
        force, torque = three(rows, FORCE, k), three(rows, TORQUE, k)
        velocity, spin, attitude = three(rows, VELOCITY, k), three(rows, SPIN, k), four(rows, ATTITUDE, k)
        x, y = velocity[0] + force[0] * inverse_mass * tick, velocity[1] + force[1] * inverse_mass * tick
        twist = (abs(torque[0]) + abs(torque[1])) * largest + abs(torque[2]) * inverse[2]
        turn = abs(spin[0]) + abs(spin[1]) + abs(spin[2]) + twist * tick
        here, seen = three(rows, POSE, k), three(rows, LOOKED_FROM, k)
        ahead, aside, turned = here[0] - seen[0], here[1] - seen[1], abs(here[2] - seen[2])
        gone = math.sqrt(ahead * ahead + aside * aside) + turned * reach
        covered = _MORE * (gone + tick * (math.sqrt(x * x + y * y) + turn * arm))
        rows[CLEAR * LANES + k] = rows[FREE * LANES + k] if covered < rows[CLEARANCE * LANES + k] else 0.0
        basis = basis_of(four(rows, HEADING, k))
        turning = spun(world_tensor(basis, inverse), attitude, spin, torque, inverse, tick)
        put_three(rows, SPIN_AFTER, k, turning)
        rate = rate_of(turning, tick)
        rows[RATE * LANES + k], rows[HALF * LANES + k] = rate, 0.5 * rate * tick


@njit(cache=True, error_model="numpy")
def move(rows: Floats, fixed: Record) -> None:
    """Move the bodies of the lanes that are to move as `ticks` does, given the sine and cosine of HALF."""
    tick, inverse_mass, weight, centre = fixed.tick_s, fixed.inverse_mass, fixed.weight, triple(fixed.centre)
    for k in range(LANES):
        moves = rows[MOVES * LANES + k] > 0.0
        position, velocity, force = three(rows, POSITION, k), three(rows, VELOCITY, k), three(rows, FORCE, k)
        heading, attitude, spin = four(rows, HEADING, k), four(rows, ATTITUDE, k), three(rows, SPIN_AFTER, k)
        replace_three(rows, POSITION_BEFORE, k, position, moves)
        replace_four(rows, HEADING_BEFORE, k, heading, moves)
        replace_four(rows, ATTITUDE_BEFORE, k, attitude, moves)
        rate, sine, cosine = rows[RATE * LANES + k], rows[SINE * LANES + k], rows[COSINE * LANES + k]
        heading = turned_by(attitude, spin, rate, sine, cosine, tick)
        attitude = attitude_of(basis_of(heading))
        velocity = (
            velocity[0] + force[0] * inverse_mass * tick,
            velocity[1] + force[1] * inverse_mass * tick,
            velocity[2] + (force[2] - weight) * inverse_mass * tick,
        )
        position = (
            position[0] + velocity[0] * tick, position[1] + velocity[1] * tick, position[2] + velocity[2] * tick,
        )  # fmt: skip
        x, y, rows[YAW_SINE * LANES + k], rows[YAW_COSINE * LANES + k] = placed(position, attitude, centre)
        replace_three(rows, POSITION, k, position, moves)
        replace_four(rows, HEADING, k, heading, moves)
        replace_four(rows, ATTITUDE, k, attitude, moves)
        replace_three(rows, VELOCITY, k, velocity, moves)
        replace_three(rows, SPIN, k, spin, moves)
        replace_three(rows, POSE, k, (x, y, rows[(POSE + 2) * LANES + k]), moves)
