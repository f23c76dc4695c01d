"""The algorithm: from a goal and a scan to a command. Replace it with yours.

It knows neither ROS nor the suite, so its tests need neither.
"""

import math

import numpy as np

SIGHT_M = 5.0
HALF_WIDTH_M = 0.4  # of the corridor that has to be free
GOAL_TOLERANCE_M = 0.2
HEADINGS = np.linspace(-1.5, 1.5, 31)  # rad


def decide(goal, ranges, bearings, max_speed_mps=0.5, max_turn_radps=1.5):
    """Return the command toward the heading that is most open and near the goal's.

    Args:
        goal: Goal (x, y) in m as the robot sees it, x ahead and y to the left.
        ranges: Ranges (n,) of a scan in m, +inf where a beam returned nothing.
        bearings: Bearings (n,) of the beams in rad.
        max_speed_mps: Highest speed in m/s.
        max_turn_radps: Highest yaw rate in rad/s.

    Returns:
        Speed in m/s and yaw rate in rad/s.
    """
    if math.hypot(*goal) < GOAL_TOLERANCE_M:
        return 0.0, 0.0

    # An invalid range (NaN) counts as a return at the robot, which lies in no corridor.
    distances = np.clip(np.nan_to_num(np.asarray(ranges, float), nan=0.0), 0.0, SIGHT_M)
    x = distances * np.cos(bearings)
    y = distances * np.sin(bearings)
    points = np.stack([x, y], axis=1)

    goal_heading = math.atan2(goal[1], goal[0])
    heading = max(
        HEADINGS,
        key=lambda angle: free_length(points, angle) - abs(angle - goal_heading),
    )
    speed = min(max_speed_mps, max(0.0, 0.4 * free_length(points, 0.0) - 0.1))
    turn = min(max_turn_radps, max(-max_turn_radps, 2.0 * heading))
    return speed * math.cos(heading), turn


def free_length(points, angle):
    """Return how far a corridor is free of points, in m.

    Args:
        points: Points (n, 2) in m as the robot sees them.
        angle: Direction of the corridor in rad.
    """
    ahead = points @ (math.cos(angle), math.sin(angle))
    aside = points @ (-math.sin(angle), math.cos(angle))
    is_in_corridor = (ahead > 0.0) & (abs(aside) < HALF_WIDTH_M)
    return ahead[is_in_corridor].min(initial=SIGHT_M)
