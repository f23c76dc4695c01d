"""The algorithm: from a goal and a scan to a velocity. Neither ROS nor the suite is known here; put yours in place."""

import math

import numpy as np

SIGHT_M = 5.0
HALF_WIDTH_M = 0.4  # of the corridor that has to be free


def decide(goal, ranges, bearings, max_speed_mps=0.5, max_turn_radps=1.5):
    """Return (m/s, rad/s) towards the heading that is free furthest and near that of the goal.

    goal: (x, y) in metres as the robot sees it, x ahead. ranges (n,) in metres, +inf where nothing is seen, at the
    bearings (n,) in radians.
    """
    if math.hypot(*goal) < 0.2:
        return 0.0, 0.0
    seen = np.clip(np.nan_to_num(np.asarray(ranges, float), nan=0.0), 0.0, SIGHT_M)
    points = np.stack([seen * np.cos(bearings), seen * np.sin(bearings)], axis=1)
    goal_heading = math.atan2(goal[1], goal[0])
    headings = np.linspace(-1.5, 1.5, 31)
    heading = max(headings, key=lambda way: free(points, way) - abs(way - goal_heading))
    speed = min(max_speed_mps, max(0.0, 0.4 * free(points, 0.0) - 0.1)) * math.cos(
        heading
    )
    return speed, min(max_turn_radps, max(-max_turn_radps, 2.0 * heading))


def free(points, way):
    """Return how far, in metres, a corridor in that direction is free of points (n, 2)."""
    ahead = points @ (math.cos(way), math.sin(way))
    aside = points @ (-math.sin(way), math.cos(way))
    return ahead[(ahead > 0.0) & (abs(aside) < HALF_WIDTH_M)].min(initial=SIGHT_M)
