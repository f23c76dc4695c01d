"""Compiled loops of model predictive path integral control: rollouts, critics, the weighted mean.

Arrays over samples are float32: controls (samples, steps, 2) forward speed m/s and yaw rate rad/s; poses as three
arrays (samples, steps), x and y in m, yaw in rad. Critics add to costs, float64 (samples,).
"""

import math

import numpy as np
from numba import njit

from barn_planners.costmap_kernels import edge_cost, place_corners

_FREE, _INSCRIBED, _LETHAL = 0, 253, 254


@njit(cache=True)
def rollout(nominal, noise, spread, change, start, dt, controls, xs, ys, yaws, radius=0.0):  # type: ignore[no-untyped-def]
    """Sample control sequences around the nominal one and integrate a unicycle along them.

    nominal: (steps, 2); noise: standard normal (samples, steps, 2), spread: (2,) its standard deviations; change:
    largest change of speed and yaw rate in a step, down and up (2, 2); start: (x, y, yaw, speed, yaw rate); radius: of
    the tightest turn.
    Pose t results from the controls up to and including t. The heading uses series for sine and cosine of the small
    step, accurate to 1e-10 for steps of 0.1 rad.
    """
    samples, steps = xs.shape
    for k in range(samples):
        x, y, yaw, speed, rate = start
        c, s = math.cos(yaw), math.sin(yaw)
        for t in range(steps):
            speed_wanted = nominal[t, 0] + spread[0] * noise[k, t, 0]
            rate_wanted = nominal[t, 1] + spread[1] * noise[k, t, 1]
            speed = min(max(speed_wanted, speed - change[0, 0]), speed + change[0, 1])
            rate = min(max(rate_wanted, rate - change[1, 0]), rate + change[1, 1])
            if radius > 0.0:
                tightest = abs(speed) / radius
                rate = min(max(rate, -tightest), tightest)
            x += speed * dt * c
            y += speed * dt * s
            turn = rate * dt
            square = turn * turn
            cos_turn = 1.0 - square * (0.5 - square * (1.0 / 24.0 - square / 720.0))
            sin_turn = turn * (1.0 - square * (1.0 / 6.0 - square * (1.0 / 120.0 - square / 5040.0)))
            c, s = c * cos_turn - s * sin_turn, s * cos_turn + c * sin_turn
            yaw += turn
            controls[k, t, 0] = speed
            controls[k, t, 1] = rate
            xs[k, t] = x
            ys[k, t] = y
            yaws[k, t] = yaw


@njit(cache=True)
def add_obstacle_costs(costs, xs, ys, yaws, grid, body, stride, weight, critical, collision, near_goal):  # type: ignore[no-untyped-def]
    """Add the trajectories' costs on the costmap; return how many of them collide.

    grid: (costs uint8, origin_x, origin_y, resolution); body: corners (n, 2) of the footprint in base_link, and the
    cost from which its edges are checked. A trajectory that touches a lethal cell costs `collision`. The others cost
    the weight times the mean over every `stride`-th pose of the cell's cost / 254, or of `critical` / 254 in inscribed
    cells; near the goal cells below that cost nothing.
    """
    cells, origin_x, origin_y, resolution = grid
    outline, possible = body
    rows, cols = cells.shape
    samples, steps = xs.shape
    corners = np.empty(outline.shape)
    per_pose = weight / _LETHAL / len(range(0, steps, stride))
    collisions = 0
    for k in range(samples):
        total = 0.0
        for t in range(0, steps, stride):
            row = math.floor((ys[k, t] - origin_y) / resolution)
            col = math.floor((xs[k, t] - origin_x) / resolution)
            if not (0 <= row < rows and 0 <= col < cols):
                continue
            cost = cells[int(row), int(col)]
            if cost == _FREE:
                continue
            if cost >= possible:
                place_corners(corners, xs[k, t], ys[k, t], yaws[k, t], outline)
                if cost >= _LETHAL or edge_cost(cells, corners, origin_x, origin_y, resolution) < 0:
                    total = -1.0
                    break
            if cost >= _INSCRIBED:
                total += critical
            elif not near_goal:
                total += cost
        if total < 0.0:
            costs[k] += collision
            collisions += 1
        else:
            costs[k] += per_pose * total
    return collisions


@njit(cache=True)
def add_moving_costs(costs, xs, ys, step_s, discs, reach, weight):  # type: ignore[no-untyped-def]
    """Add the costs of trajectories that come within `reach` of discs (k, 5) that keep their velocities.

    discs: centre x, y, velocity, radius. The first meeting costs the weight now, half of it at the last step.
    """
    samples, steps = xs.shape
    for k in range(samples):
        for t in range(steps):
            time_s = step_s * (t + 1)
            met = False
            for i in range(len(discs)):
                dx = discs[i, 0] + time_s * discs[i, 2] - xs[k, t]
                dy = discs[i, 1] + time_s * discs[i, 3] - ys[k, t]
                near = discs[i, 4] + reach
                met = met or dx * dx + dy * dy < near * near
            if met:
                costs[k] += weight * (1.0 - 0.5 * t / steps)
                break


@njit(cache=True)
def nearest_point(path, x, y):  # type: ignore[no-untyped-def]
    """Return the number of the path's point (n, 2) nearest to (x, y), the first of equals."""
    best, best_square = 0, math.inf
    for i in range(len(path)):
        square = (path[i, 0] - x) ** 2 + (path[i, 1] - y) ** 2
        if square < best_square:
            best, best_square = i, square
    return best


@njit(cache=True)
def furthest_reached(path, xs, ys):  # type: ignore[no-untyped-def]
    """Return the number of the furthest point of the path that is the nearest to the end of some trajectory."""
    furthest = 0
    for k in range(len(xs)):
        furthest = max(furthest, nearest_point(path, xs[k, -1], ys[k, -1]))
    return furthest


@njit(cache=True)
def add_follow_costs(costs, xs, ys, x, y, weight):  # type: ignore[no-untyped-def]
    """Add the weight times the distance from each trajectory's end to a point of the path."""
    for k in range(len(costs)):
        costs[k] += weight * math.hypot(xs[k, -1] - x, ys[k, -1] - y)


@njit(cache=True)
def add_angle_costs(costs, xs, ys, yaws, x, y, weight):  # type: ignore[no-untyped-def]
    """Add the weight times the angle, at each trajectory's end, between its heading and the direction of a point."""
    for k in range(len(costs)):
        direction = math.atan2(y - ys[k, -1], x - xs[k, -1])
        costs[k] += weight * abs(_wrapped(direction - yaws[k, -1]))


@njit(cache=True)
def add_align_costs(costs, xs, ys, start, path, arc, clear, stride, weight):  # type: ignore[no-untyped-def]
    """Add the weight times the mean distance of every `stride`-th pose from the path at the same arc length.

    start: (x, y) of the robot; arc: (n,) distance along the path to each point; clear: (n,) whether a point is free;
    others do not count.
    """
    samples, steps = xs.shape
    for k in range(samples):
        x, y = start
        travelled, index, total, counted = 0.0, 0, 0.0, 0
        for t in range(stride, steps, stride):
            travelled += math.hypot(xs[k, t] - x, ys[k, t] - y)
            x, y = xs[k, t], ys[k, t]
            while index + 1 < len(arc) and abs(arc[index + 1] - travelled) <= abs(arc[index] - travelled):
                index += 1
            if clear[index]:
                total += math.hypot(path[index, 0] - x, path[index, 1] - y)
                counted += 1
        if counted > 0:
            costs[k] += weight * total / counted


@njit(cache=True)
def add_goal_costs(costs, xs, ys, yaws, goal, position_weight, yaw_weight):  # type: ignore[no-untyped-def]
    """Add the weights times the mean distance from the goal (x, y, yaw) and the mean angle to its heading."""
    samples, steps = xs.shape
    for k in range(samples):
        distance, angle = 0.0, 0.0
        for t in range(steps):
            if position_weight > 0.0:
                distance += math.hypot(xs[k, t] - goal[0], ys[k, t] - goal[1])
            if yaw_weight > 0.0:
                angle += abs(_wrapped(yaws[k, t] - goal[2]))
        costs[k] += (position_weight * distance + yaw_weight * angle) / steps


@njit(cache=True)
def add_control_costs(costs, controls, nominal, spread, limits, dt, gamma, limit_weight, forward_weight):  # type: ignore[no-untyped-def]
    """Add the costs of the controls.

    The path integral's own term, gamma times nominal control times deviation over variance; the weight times the excess
    over the limits (lowest speed, highest speed, highest yaw rate) times dt; the weight times reverse speed times dt.
    """
    samples, steps = controls.shape[:2]
    for k in range(samples):
        deviation, beyond, reverse = 0.0, 0.0, 0.0
        for t in range(steps):
            speed, rate = controls[k, t, 0], controls[k, t, 1]
            deviation += nominal[t, 0] * (speed - nominal[t, 0]) / (spread[0] * spread[0])
            deviation += nominal[t, 1] * (rate - nominal[t, 1]) / (spread[1] * spread[1])
            beyond += max(0.0, speed - limits[1]) + max(0.0, limits[0] - speed) + max(0.0, abs(rate) - limits[2])
            reverse += max(0.0, -speed)
        costs[k] += gamma * deviation + (limit_weight * beyond + forward_weight * reverse) * dt


@njit(cache=True)
def weighted_mean(costs, controls, temperature, mean):  # type: ignore[no-untyped-def]
    """Set `mean` (steps, 2) to the mean of the controls, weighted with exp(-(cost - lowest cost) / temperature)."""
    samples, steps = controls.shape[:2]
    lowest = costs.min()
    mean[:] = 0.0
    whole = 0.0
    for k in range(samples):
        weight = math.exp(-(costs[k] - lowest) / temperature)
        if weight < 1e-9:
            continue
        whole += weight
        for t in range(steps):
            mean[t, 0] += weight * controls[k, t, 0]
            mean[t, 1] += weight * controls[k, t, 1]
    mean /= whole


@njit(cache=True)
def resample(points, spacing, most):  # type: ignore[no-untyped-def]
    """Return (m, 2) points at even spacing along a line through points (n, 2), at most `most`, the first included.

    The line's end is appended if there is room and it is not reached exactly.
    """
    out = np.empty((most, 2))
    out[0] = points[0]
    count, carried = 1, 0.0
    for i in range(len(points) - 1):
        dx, dy = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
        length = math.hypot(dx, dy)
        along = spacing - carried
        while along <= length and count < most:
            out[count, 0] = points[i, 0] + dx * along / length
            out[count, 1] = points[i, 1] + dy * along / length
            count += 1
            along += spacing
        carried = length - (along - spacing)
    if count < most and carried > 1e-9:
        out[count] = points[-1]
        count += 1
    return out[:count]


@njit(cache=True)
def _wrapped(angle):  # type: ignore[no-untyped-def]
    """Return the angle in [-pi, pi)."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))
