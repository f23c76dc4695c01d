"""The algorithm needs neither ROS nor a simulator to be tested."""

import numpy as np
import pytest
from template_planner.core import SIGHT_M, decide, free_length

BEARINGS = np.linspace(-2.35, 2.35, 720)
NOTHING = np.full(720, np.inf)


def wall(distance_m):
    """Return what is seen of a wall across, 2 m wide."""
    ranges = distance_m / np.cos(BEARINGS)
    lateral_m = abs(ranges * np.sin(BEARINGS))
    is_wall = (abs(BEARINGS) < 1.5) & (lateral_m < 1.0)
    return np.where(is_wall, ranges, np.inf)


def test_it_drives_straight_at_a_goal_ahead():
    speed, turn = decide((5.0, 0.0), NOTHING, BEARINGS, max_speed_mps=0.7)
    assert speed == pytest.approx(0.7)
    assert turn == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_it_turns_to_the_goal(side):
    assert decide((0.0, 5.0 * side), NOTHING, BEARINGS)[1] * side > 1.0


def test_it_turns_away_from_a_wall_and_slows_down():
    speed, turn = decide((5.0, 0.1), wall(1.0), BEARINGS)
    assert speed < 0.3
    assert abs(turn) > 1.0


def test_it_stops_at_the_goal():
    assert decide((0.1, 0.0), NOTHING, BEARINGS) == (0.0, 0.0)


def test_readings_that_are_no_numbers_are_left_out():
    assert decide((5.0, 1.0), np.full(720, np.nan), BEARINGS) == decide(
        (5.0, 1.0), NOTHING, BEARINGS
    )


def test_free_is_bounded_by_sight():
    assert free_length(np.zeros((0, 2)), 0.3) == SIGHT_M
    points = np.array([[2.0, 0.1], [1.0, 0.7]])
    assert free_length(points, 0.0) == 2.0
