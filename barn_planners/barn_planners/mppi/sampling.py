"""Compiled loops of model predictive path integral control: noise, rollouts, and the solution made of them.

The noise is that of NumPy's generator to the last bit, in a third of its time: SFC64 (Doty-Humphrey) and the ziggurat
(Marsaglia and Tsang, J. Stat. Softw. 5(8), 2000) as one compiled loop. Arrays are as in `kernels`.
"""

import math
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from numba import njit

_TAIL = 3.6541528853610088  # where the lowest of the 256 layers ends, from there on the tail
_LAYERS, _SHARE_BITS = 256, 23


def _layers() -> tuple[
    npt.NDArray[np.float32], npt.NDArray[np.uint32], npt.NDArray[np.float32]
]:
    """Return each layer's width by 2^23, the numbers below which it lies under the density, and the density (256,)."""
    area = _TAIL * math.exp(-0.5 * _TAIL**2) + math.sqrt(0.5 * math.pi) * math.erfc(
        _TAIL / math.sqrt(2.0)
    )
    ends = [_TAIL]
    for _ in range(_LAYERS - 2):
        ends.append(
            math.sqrt(-2.0 * math.log(area / ends[-1] + math.exp(-0.5 * ends[-1] ** 2)))
        )
    ends.append(0.0)
    ends.reverse()
    whole = 1 << _SHARE_BITS
    base = area / math.exp(-0.5 * _TAIL**2)
    widths = [base, *ends[1:]]
    inside = [_TAIL / base, *(a / b for a, b in pairwise(ends))]
    return (
        np.array([width / whole for width in widths], np.float32),
        np.array([round(share * whole) for share in inside], np.uint32),
        np.array([math.exp(-0.5 * end**2) for end in ends], np.float32),
    )


_WIDTHS, _INSIDE, _DENSITY = _layers()
_TAIL_32, _TAIL_INVERSE = np.float32(_TAIL), np.float32(1.0 / _TAIL)
_HALF = np.uint64(32)


def noise_state(seed: int) -> npt.NDArray[np.uint64]:
    """Return the state (6,) of NumPy's SFC64 for a seed: its four words, whether half a draw is left, and that half."""
    state = np.random.SFC64(seed).state
    return np.array(
        [*state["state"]["state"], state["has_uint32"], state["uinteger"]], np.uint64
    )


@njit(cache=True)
def _next(words):  # type: ignore[no-untyped-def]
    """Return 32 random bits and the words after that."""
    a, b, c, counter, has, half = words
    if has:
        return np.uint32(half), (a, b, c, counter, np.uint64(0), half)
    drawn = a + b + counter
    a = b ^ (b >> np.uint64(11))
    b = c + (c << np.uint64(3))
    c = ((c << np.uint64(24)) | (c >> np.uint64(40))) + drawn
    return np.uint32(drawn), (
        a,
        b,
        c,
        counter + np.uint64(1),
        np.uint64(1),
        drawn >> _HALF,
    )


@njit(cache=True)
def _share(bits):  # type: ignore[no-untyped-def]
    return np.float32(bits >> np.uint32(8)) * np.float32(1.0 / 16777216.0)


@njit(cache=True)
def _outside(words, x, bits, layer):  # type: ignore[no-untyped-def]
    """Return for a number that may lie above the density: whether it is taken, the number, and the words after that."""
    if layer > 0:
        drawn, words = _next(words)
        height = (_DENSITY[layer - 1] - _DENSITY[layer]) * _share(drawn) + _DENSITY[
            layer
        ]
        return height < math.exp(-0.5 * np.float64(x) * np.float64(x)), x, words
    while True:
        drawn, words = _next(words)
        beyond = -_TAIL_INVERSE * np.float32(math.log1p(-_share(drawn)))
        drawn, words = _next(words)
        above = -np.float32(math.log1p(-_share(drawn)))
        if above + above > beyond * beyond:
            x = _TAIL_32 + beyond
            return True, -x if (bits >> np.uint32(17)) & np.uint32(1) else x, words


@njit(cache=True)
def fill_normal(state, numbers):  # type: ignore[no-untyped-def]
    """Fill float32 (n, m) column by column with the numbers of `Generator(SFC64(seed)).standard_normal`; advance."""
    rows, columns = numbers.shape
    words = (state[0], state[1], state[2], state[3], state[4], state[5])
    for column in range(columns):
        for row in range(rows):
            taken, x = False, np.float32(0.0)
            while not taken:
                bits, words = _next(words)
                layer, size = bits & np.uint32(255), bits >> np.uint32(9)
                x = np.float32(size) * _WIDTHS[layer]
                x = -x if bits & np.uint32(256) else x
                taken = size < _INSIDE[layer]
                if not taken:
                    taken, x, words = _outside(words, x, bits, layer)
            numbers[row, column] = x
    for i in range(len(state)):
        state[i] = words[i]


@njit(cache=True)
def rollout(nominal, noise, spread, change, start, dt, controls, xs, ys, yaws):  # type: ignore[no-untyped-def]
    """Sample control sequences around the nominal one (steps, 2) and integrate a unicycle along them.

    noise: standard normal, spread: (2,) its deviations; change: largest changes in a step, down and up (2, 2); start:
    x, y, yaw, speed, yaw rate. The heading uses series for sine and cosine of the step, accurate to 1e-10 for 0.1 rad.
    """
    (steps, samples), (x, y, yaw, speed, rate) = xs.shape, start
    place = np.full(samples, x), np.full(samples, y), np.full(samples, yaw)
    heading = np.full(samples, math.cos(yaw)), np.full(samples, math.sin(yaw))
    states = (*place, *heading, np.full(samples, speed), np.full(samples, rate))
    changes = change[0, 0], change[0, 1], change[1, 0], change[1, 1]
    for t in range(steps):
        wanted = (
            nominal[t, 0],
            nominal[t, 1],
            spread[0],
            spread[1],
            noise[t, 0],
            noise[t, 1],
        )
        _step(
            states,
            wanted,
            changes,
            dt,
            (controls[t, 0], controls[t, 1], xs[t], ys[t], yaws[t]),
        )


@njit(cache=True, error_model="numpy")
def _step(states, wanted, changes, dt, out):  # type: ignore[no-untyped-def]
    """Take a step of all samples; one loop without branches, which the compiler vectorises."""
    x, y, yaw, c, s, speed, rate = states
    nominal_speed, nominal_rate, speed_spread, rate_spread, speed_noise, rate_noise = (
        wanted
    )
    slower, faster, right, left = changes
    speeds, rates, xs, ys, yaws = out
    for k in range(len(x)):
        speed[k] = min(
            max(nominal_speed + speed_spread * speed_noise[k], speed[k] - slower),
            speed[k] + faster,
        )
        rate[k] = min(
            max(nominal_rate + rate_spread * rate_noise[k], rate[k] - right),
            rate[k] + left,
        )
        speeds[k], rates[k] = speed[k], rate[k]
        x[k] += speed[k] * dt * c[k]
        y[k] += speed[k] * dt * s[k]
        turn = rate[k] * dt
        square = turn * turn
        cos_turn = 1.0 - square * (0.5 - square * (1.0 / 24.0 - square / 720.0))
        sin_turn = turn * (
            1.0 - square * (1.0 / 6.0 - square * (1.0 / 120.0 - square / 5040.0))
        )
        c[k], s[k] = (
            c[k] * cos_turn - s[k] * sin_turn,
            s[k] * cos_turn + c[k] * sin_turn,
        )
        yaw[k] += turn
        xs[k], ys[k], yaws[k] = x[k], y[k], yaw[k]


@njit(cache=True)
def weighted_mean(costs, controls, temperature, mean):  # type: ignore[no-untyped-def]
    """Set `mean` (steps, 2) to the mean of the controls, weighted with exp(-(cost - lowest cost) / temperature)."""
    weights = np.exp(-(costs - costs.min()) / temperature)
    chosen = np.flatnonzero(weights >= 1e-9)
    whole = 0.0
    for k in chosen:
        whole += weights[k]
    for t in range(len(mean)):
        speeds, rates = controls[t, 0], controls[t, 1]
        speed, rate = 0.0, 0.0
        for k in chosen:
            speed += weights[k] * speeds[k]
            rate += weights[k] * rates[k]
        mean[t, 0], mean[t, 1] = speed / whole, rate / whole


@njit(cache=True, error_model="numpy")
def smoothed(controls, sent, weights):  # type: ignore[no-untyped-def]
    """Return controls (steps, 2) averaged over time with weights (2 n + 1,), after the n sent before them (n, 2)."""
    steps, before = len(controls), len(sent)
    whole = np.concatenate((sent, controls, np.empty((before, 2))))
    whole[before + steps :] = controls[-1]
    out = np.zeros((steps, 2))
    for t in range(steps):
        for i in range(len(weights)):
            out[t, 0] += whole[t + i, 0] * weights[i]
            out[t, 1] += whole[t + i, 1] * weights[i]
    return out


@njit(cache=True, error_model="numpy")
def hold_within(controls, limits, change, start):  # type: ignore[no-untyped-def]
    """Hold controls (steps, 2) within limits, and changes (as of `rollout`) from `start`, speed and yaw rate now."""
    (speed, rate), slowest, fastest, fastest_turn = (
        start,
        limits[0],
        limits[1],
        limits[2],
    )
    for t in range(len(controls)):
        wanted_speed = min(max(controls[t, 0], slowest), fastest)
        wanted_rate = min(max(controls[t, 1], -fastest_turn), fastest_turn)
        speed = min(max(wanted_speed, speed - change[0, 0]), speed + change[0, 1])
        rate = min(max(wanted_rate, rate - change[1, 0]), rate + change[1, 1])
        controls[t, 0], controls[t, 1] = speed, rate
