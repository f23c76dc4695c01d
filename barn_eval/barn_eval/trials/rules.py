"""The rules of a trial as one compiled step over numbers, for one trial or many."""

import math

import numpy as np
import numpy.typing as npt

from barn_eval.trials.protocol import Course, Protocol
from barn_worlds.base.arrays import Bools, Floats, Integers, strict_kernel
from barn_worlds.base.types import nanoseconds

# How a trial stands after a reading.
RUNNING = 0
SUCCESS = 1
COLLISION = 2
TIMEOUT = 3
NO_FIRST_MOTION = 4
CLOCK_BACK = 5
ODOMETRY_LOST = 6
TRUTH_LOST = 7
LEFT_WORLD = 8

# A trial in numbers, by their type. The first of each follow from protocol and course.
_FLOATS = (
    "clock_start_m",  # distances that start the clock
    "goal_m",  # and end the trial
    "goal_x",
    "goal_y",
    "x_min",  # bounds of the true position
    "y_min",
    "x_max",
    "y_max",
    # From reading to reading:
    "from_x",  # where the motion that starts the clock begins
    "from_y",
    "x",  # true position
    "y",
    "left_m",  # distance to the goal
)
_INTEGERS = (
    "first_motion_ns",  # longest time until the clock starts
    "limit_ns",  # longest time on the clock
    "look_ns",  # between two looks, 0 to look at each reading
    # From reading to reading:
    "code",  # how the trial stands
    "stamp_ns",  # of the last reading, even a faulty one
    "first_ns",  # of the first reading
    "last_ns",  # of the last reading that was taken
    "clock_ns",  # when the clock started
    "contact_ns",  # time in contact
    "next_look_ns",
)
_FLAGS = (
    "contact_ends",
    "clock_by_truth",
    "goal_by_truth",
    # From reading to reading:
    "has_reading",
    "clock_started",
    "touched",  # whether there was a contact so far
)
_TYPES = (
    dict.fromkeys(_FLOATS, np.float64)
    | dict.fromkeys(_INTEGERS, np.int64)
    | dict.fromkeys(_FLAGS, np.bool_)
)
STATE = np.dtype((np.record, list(_TYPES.items())))
States = npt.NDArray[np.void]


def initial_states(protocol: Protocol, course: Course) -> States:
    """Return a new trial's state (1,), its goal in the frame of the judged pose.

    Args:
        protocol: Rules of the trial, in the size of its world.
        course: Start and goal in the map frame.
    """
    states: States = np.zeros(1, STATE)
    states["clock_start_m"] = protocol.clock_start_distance_m
    states["goal_m"] = protocol.goal_distance_m
    states["first_motion_ns"] = nanoseconds(protocol.first_motion_limit_s)
    states["limit_ns"] = nanoseconds(protocol.limit_s)
    states["look_ns"] = nanoseconds(protocol.look_period_s)
    states["contact_ends"] = protocol.collision_ends_trial
    states["clock_by_truth"] = protocol.clock_start_source == "truth"
    states["goal_by_truth"] = protocol.goal_source == "truth"

    bounds = zip(("x_min", "y_min", "x_max", "y_max"), course.bounds_m, strict=True)
    for name, bound_m in bounds:
        states[name] = bound_m

    # The odometry frame starts at the start pose.
    goal = course.goal
    if protocol.goal_source == "odometry":
        goal = course.start.inverse() @ goal
    states["goal_x"] = goal.x
    states["goal_y"] = goal.y
    return states


@strict_kernel
def observe(
    states: States,
    which: Integers,
    stamps_ns: Integers,
    odometry: Floats,
    truths: Floats,
    contacts: Bools,
) -> None:
    """Judge a reading of each running trial in rows `which`; update `states` in place.

    Args:
        states: State (n,) of each trial, which is updated.
        which: Rows of the trials that have a reading; those of other trials stay.
        stamps_ns: Time (n,) of each reading.
        odometry: Measured pose (n, 3) in the odom frame: x, y in m, yaw in rad.
        truths: True pose (n, 3) in the map frame.
        contacts: Whether (n,) there was a contact since the reading before.
    """
    for i in which:
        if states[i].code == RUNNING:
            _observe(states[i], stamps_ns[i], odometry[i], truths[i], contacts[i])


@strict_kernel
def _observe(
    state: np.record, now_ns: int, odometry: Floats, truth: Floats, contact: bool
) -> None:
    """Update a running trial's state in place by a reading, which may end it."""
    state.stamp_ns = now_ns
    if state.has_reading and now_ns < state.last_ns:
        state.code = CLOCK_BACK
    elif not np.isfinite(odometry).all():
        state.code = ODOMETRY_LOST
    elif not np.isfinite(truth).all():
        state.code = TRUTH_LOST
    if state.code != RUNNING:
        return

    clock_pose = truth if state.clock_by_truth else odometry
    goal_pose = truth if state.goal_by_truth else odometry
    if not state.has_reading:
        state.has_reading = True
        state.first_ns = now_ns
        state.last_ns = now_ns
        state.next_look_ns = now_ns
        state.from_x = clock_pose[0]
        state.from_y = clock_pose[1]

    # A contact counts for the whole time since the reading before.
    if contact:
        state.contact_ns += now_ns - state.last_ns
        state.touched = True
    state.last_ns = now_ns
    state.x = truth[0]
    state.y = truth[1]
    state.left_m = math.hypot(goal_pose[0] - state.goal_x, goal_pose[1] - state.goal_y)

    if now_ns < state.next_look_ns:
        return
    while state.look_ns and state.next_look_ns <= now_ns:
        state.next_look_ns += state.look_ns

    moved_m = math.hypot(clock_pose[0] - state.from_x, clock_pose[1] - state.from_y)
    starts_with_goal = state.clock_start_m == 0.0
    is_moving = moved_m > state.clock_start_m or starts_with_goal
    if not state.clock_started and is_moving:
        state.clock_started = True
        state.clock_ns = now_ns
    state.code = _judge(state)


@strict_kernel
def _judge(state: np.record) -> int:
    """Return RUNNING or the code by which the last reading ends the trial."""
    if state.touched and state.contact_ends:
        return COLLISION
    is_inside_x = state.x_min <= state.x <= state.x_max
    is_inside_y = state.y_min <= state.y <= state.y_max
    if not (is_inside_x and is_inside_y):
        return LEFT_WORLD
    if not state.clock_started:
        waited_ns = state.last_ns - state.first_ns
        return NO_FIRST_MOTION if waited_ns >= state.first_motion_ns else RUNNING

    # Arrival at the very limit is a success.
    clock_ns = state.last_ns - state.clock_ns
    if state.left_m <= state.goal_m and clock_ns <= state.limit_ns:
        return SUCCESS
    return TIMEOUT if clock_ns >= state.limit_ns else RUNNING
