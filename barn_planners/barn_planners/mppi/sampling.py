"""Kernels of MPPI that sample: noise, rollouts and the resulting solution.

The noise equals that of NumPy's generator to the last bit, in a third of its time.
SFC64 (Doty-Humphrey) and the ziggurat (Marsaglia and Tsang, J. Stat. Softw. 5(8), 2000)
run here as one compiled loop. Arrays are laid out as in `kernels`.
"""

import math
from itertools import pairwise
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from barn_planners.interface import FloatArray
from barn_worlds.base.arrays import Singles, kernel

# Words a, b, c and counter of SFC64, whether half a draw is left (0 or 1), and that
# half.
_Words: TypeAlias = tuple[np.uint64, ...]

# x, y, yaw, cosine and sine of yaw, speed and yaw rate of all samples, each (samples,).
_State: TypeAlias = tuple[FloatArray, ...]

_LAYERS = 256
# Bits of a draw that place a number within its layer.
_POSITION_BITS = 23
# Where the tail begins below the lowest layer.
_TAIL_START = 3.6541528853610088


def _ziggurat_tables() -> tuple[Singles, npt.NDArray[np.uint32], Singles]:
    """Return widths, safe positions and densities of the ziggurat's layers, (256,).

    Returns:
        The width of each layer divided by 2^23; the positions below which a number lies
        under the density for certain; the density at the end of each layer.
    """
    # All layers have the same area; the lowest one includes the tail.
    end_density = math.exp(-0.5 * _TAIL_START**2)
    tail_area = math.sqrt(0.5 * math.pi) * math.erfc(_TAIL_START / math.sqrt(2.0))
    area = _TAIL_START * end_density + tail_area

    # From the tail to the top: each layer's end follows from its area and the one
    # before.
    ends = [_TAIL_START]
    for _ in range(_LAYERS - 2):
        density = area / ends[-1] + math.exp(-0.5 * ends[-1] ** 2)
        ends.append(math.sqrt(-2.0 * math.log(density)))
    ends.append(0.0)
    ends.reverse()

    base_width = area / end_density
    scale = 1 << _POSITION_BITS
    widths = [base_width, *ends[1:]]
    shares_inside = [_TAIL_START / base_width]
    shares_inside += [inner / outer for inner, outer in pairwise(ends)]
    return (
        np.array([width / scale for width in widths], np.float32),
        np.array([round(share * scale) for share in shares_inside], np.uint32),
        np.array([math.exp(-0.5 * end**2) for end in ends], np.float32),
    )


_WIDTHS, _INSIDE, _DENSITY = _ziggurat_tables()
# In single precision, as NumPy computes single-precision numbers.
_TAIL_START_32 = np.float32(_TAIL_START)
_TAIL_INVERSE_32 = np.float32(1.0 / _TAIL_START)
_UNIT_24_BITS = np.float32(1.0 / 16777216.0)


def noise_state(seed: int) -> npt.NDArray[np.uint64]:
    """Return the state (6,) of NumPy's SFC64 seeded by `seed`, for `fill_normal`."""
    state = np.random.SFC64(seed).state
    # The order in which the kernel unpacks them.
    words = [*state["state"]["state"], state["has_uint32"], state["uinteger"]]
    return np.array(words, np.uint64)


@kernel
def _next_bits(words: _Words) -> tuple[np.uint32, _Words]:
    """Return 32 random bits and the next words; a draw has 64 bits and serves twice."""
    a, b, c, counter, has_half, half = words
    if has_half:
        return np.uint32(half), (a, b, c, counter, np.uint64(0), half)

    # One round of SFC64, word for word as in NumPy's sfc64.h.
    draw = a + b + counter
    next_a = b ^ (b >> np.uint64(11))
    next_b = c + (c << np.uint64(3))
    next_c = ((c << np.uint64(24)) | (c >> np.uint64(40))) + draw
    next_counter = counter + np.uint64(1)
    upper_half = draw >> np.uint64(32)
    return np.uint32(draw), (
        next_a,
        next_b,
        next_c,
        next_counter,
        np.uint64(1),
        upper_half,
    )


@kernel
def _to_unit(bits: np.uint32) -> np.float32:
    """Return 32 random bits as a float32 in [0, 1), by the upper 24 of them."""
    unit: np.float32 = np.float32(bits >> np.uint32(8)) * _UNIT_24_BITS
    return unit


@kernel
def _sample_edge(
    words: _Words, x: np.float32, bits: np.uint32, layer: int
) -> tuple[bool, np.float32, _Words]:
    """Test a number at the density's edge; return acceptance, number and next words.

    Returns:
        Whether the number is accepted, the number, and the next words.
    """
    if layer > 0:
        draw, words = _next_bits(words)
        step = _DENSITY[layer - 1] - _DENSITY[layer]
        height = step * _to_unit(draw) + _DENSITY[layer]
        is_below = height < math.exp(-0.5 * np.float64(x) * np.float64(x))
        return is_below, x, words

    # Below the lowest layer lies the tail, which Marsaglia's method samples.
    while True:
        draw, words = _next_bits(words)
        beyond = -_TAIL_INVERSE_32 * np.float32(math.log1p(-_to_unit(draw)))
        draw, words = _next_bits(words)
        height = -np.float32(math.log1p(-_to_unit(draw)))
        if height + height > beyond * beyond:
            x = _TAIL_START_32 + beyond
            is_negative = (bits >> np.uint32(17)) & np.uint32(1)
            return True, -x if is_negative else x, words


@kernel
def fill_normal(state: npt.NDArray[np.uint64], numbers: Singles) -> None:
    """Fill `numbers` with standard normals of NumPy's SFC64, and advance `state`.

    They are what `Generator(SFC64(seed)).standard_normal` draws in float32.

    Args:
        state: State (6,) of the generator, which is advanced.
        numbers: Array (n, m), filled column by column.
    """
    rows, columns = numbers.shape
    words: _Words = (state[0], state[1], state[2], state[3], state[4], state[5])
    for column in range(columns):
        for row in range(rows):
            is_accepted = False
            x = np.float32(0.0)
            while not is_accepted:
                bits, words = _next_bits(words)
                layer = bits & np.uint32(255)
                position = bits >> np.uint32(9)
                x = np.float32(position) * _WIDTHS[layer]
                x = -x if bits & np.uint32(256) else x
                is_accepted = position < _INSIDE[layer]
                if not is_accepted:
                    is_accepted, x, words = _sample_edge(words, x, bits, layer)
            numbers[row, column] = x
    for i in range(len(state)):
        state[i] = words[i]


@kernel
def rollout(
    nominal: FloatArray,
    noise: Singles,
    spread: FloatArray,
    change: FloatArray,
    start: tuple[float, float, float, float, float],
    dt: float,
    controls: Singles,
    poses: Singles,
) -> None:
    """Fill `controls` with samples around the nominal ones, `poses` by driving them.

    Args:
        nominal: Nominal controls (steps, 2): m/s and rad/s.
        noise: Standard normal numbers (steps, 2, samples).
        spread: Standard deviations (2,) of speed and yaw rate.
        change: Largest changes in a step (2, 2): speed down and up, yaw rate down and
            up.
        start: x and y in m, yaw in rad, speed in m/s and yaw rate in rad/s.
        dt: Time of a step in s.
        controls: Sampled controls (steps, 2, samples), filled.
        poses: Where they lead, (steps, 3, samples), filled.
    """
    steps, _, samples = poses.shape
    x, y, yaw, speed, rate = start
    state = (
        np.full(samples, x),
        np.full(samples, y),
        np.full(samples, yaw),
        np.full(samples, math.cos(yaw)),
        np.full(samples, math.sin(yaw)),
        np.full(samples, speed),
        np.full(samples, rate),
    )
    for t in range(steps):
        _step(
            state,
            nominal[t],
            noise[t, 0],
            noise[t, 1],
            spread,
            change,
            dt,
            controls[t, 0],
            controls[t, 1],
            poses[t, 0],
            poses[t, 1],
            poses[t, 2],
        )


@kernel
def _step(
    state: _State,
    nominal: FloatArray,
    speed_noise: Singles,
    rate_noise: Singles,
    spread: FloatArray,
    change: FloatArray,
    dt: float,
    speeds: Singles,
    rates: Singles,
    xs: Singles,
    ys: Singles,
    yaws: Singles,
) -> None:
    """Take one step of all samples: change their state, write controls and poses.

    The loop has no branches and each array is an argument of its own, without which the
    compiler does not vectorize it.
    """
    x, y, yaw, c, s, speed, rate = state
    nominal_speed, nominal_rate = nominal
    speed_spread, rate_spread = spread
    slower, faster = change[0]
    right, left = change[1]
    for k in range(len(x)):
        sampled_speed = nominal_speed + speed_spread * speed_noise[k]
        speed[k] = min(max(sampled_speed, speed[k] - slower), speed[k] + faster)
        sampled_rate = nominal_rate + rate_spread * rate_noise[k]
        rate[k] = min(max(sampled_rate, rate[k] - right), rate[k] + left)
        speeds[k] = speed[k]
        rates[k] = rate[k]
        x[k] += speed[k] * dt * c[k]
        y[k] += speed[k] * dt * s[k]

        # Sine and cosine of the turn by series, accurate to 1e-10 up to 0.1 rad a step.
        turn = rate[k] * dt
        square = turn * turn
        cos_turn = 1.0 - square * (0.5 - square * (1.0 / 24.0 - square / 720.0))
        sin_turn = turn * (
            1.0 - square * (1.0 / 6.0 - square * (1.0 / 120.0 - square / 5040.0))
        )
        cos_yaw = c[k]
        c[k] = cos_yaw * cos_turn - s[k] * sin_turn
        s[k] = s[k] * cos_turn + cos_yaw * sin_turn
        yaw[k] += turn
        xs[k] = x[k]
        ys[k] = y[k]
        yaws[k] = yaw[k]


@kernel
def weighted_mean(
    costs: FloatArray, controls: Singles, temperature: float, mean: FloatArray
) -> None:
    """Write to `mean` the controls weighted by exp(-(cost - lowest) / temperature).

    Args:
        costs: Cost of each sample (samples,).
        controls: Sampled controls (steps, 2, samples).
        temperature: Cost difference over which a weight falls to 1/e.
        mean: Mean controls (steps, 2), filled.
    """
    # The lowest cost as the origin keeps the exponential from vanishing for all.
    weights = np.exp(-(costs - costs.min()) / temperature)
    # Most samples have a negligible weight; leaving them out saves most of the time.
    relevant = np.flatnonzero(weights >= 1e-9)
    total = 0.0
    for k in relevant:
        total += weights[k]
    for t in range(len(mean)):
        speeds = controls[t, 0]
        rates = controls[t, 1]
        speed = 0.0
        rate = 0.0
        for k in relevant:
            speed += weights[k] * speeds[k]
            rate += weights[k] * rates[k]
        mean[t, 0] = speed / total
        mean[t, 1] = rate / total


@kernel
def smooth(
    controls: FloatArray, past_controls: FloatArray, weights: FloatArray
) -> FloatArray:
    """Return controls (steps, 2) filtered over time, with past ones before the first.

    Args:
        controls: Controls (steps, 2); beyond its end the last one counts.
        past_controls: Controls (n, 2) that were sent before them.
        weights: Weights (2 n + 1,) of the filter.

    Returns:
        Smooth controls (steps, 2).
    """
    steps = len(controls)
    past_steps = len(past_controls)
    padded = np.concatenate((past_controls, controls, np.empty((past_steps, 2))))
    padded[past_steps + steps :] = controls[-1]
    result = np.zeros((steps, 2))
    for t in range(steps):
        for i in range(len(weights)):
            result[t, 0] += padded[t + i, 0] * weights[i]
            result[t, 1] += padded[t + i, 1] * weights[i]
    return result


@kernel
def limit_controls(
    controls: FloatArray,
    limits: FloatArray,
    change: FloatArray,
    start: tuple[float, float],
) -> None:
    """Clip controls (steps, 2) and their changes per step, in place.

    Args:
        controls: Controls (steps, 2).
        limits: Lowest and highest speed in m/s, and highest yaw rate in rad/s, (3,).
        change: Largest changes in a step (2, 2), as in `rollout`.
        start: Speed in m/s and yaw rate in rad/s of the robot now.
    """
    speed, rate = start
    for t in range(len(controls)):
        allowed_speed = min(max(controls[t, 0], limits[0]), limits[1])
        # Each control starts from the one before, the first from the robot's velocity.
        speed = min(max(allowed_speed, speed - change[0, 0]), speed + change[0, 1])
        allowed_rate = min(max(controls[t, 1], -limits[2]), limits[2])
        rate = min(max(allowed_rate, rate - change[1, 0]), rate + change[1, 1])
        controls[t, 0] = speed
        controls[t, 1] = rate
