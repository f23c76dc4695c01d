"""The rules of a trial as one compiled step over plain numbers: for one trial, or for many at a time."""

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from barn_eval.trials.protocol import Course, Protocol
from barn_worlds.base.arrays import Bools, Floats, Integers
from barn_worlds.base.types import nanoseconds

# How a trial stands after a reading.
(
    RUNNING,
    SUCCESS,
    COLLISION,
    TIMEOUT,
    NO_FIRST_MOTION,
    CLOCK_BACK,
    ODOMETRY_LOST,
    TRUTH_LOST,
) = range(8)

# A trial in numbers, first what of its protocol decides. clock_start_m, goal_m: distances that start the clock and end
# the trial; goal_x, goal_y: what is to be reached. stamp_ns: of the last reading, which is not taken if it
# is at fault; first_ns, last_ns: of those taken; clock_ns: at which the clock started; from_x, from_y: where the motion
# that starts it is counted from; x, y: the true position; left_m: to the goal. next_look_ns, touched: when a protocol
# that does not look at each reading looks next, and whether there has been a contact by then.
_FIELDS = {
    "clock_start_m goal_m goal_x goal_y": np.float64,
    "first_motion_ns limit_ns look_ns": np.int64,
    "contact_ends clock_by_truth goal_by_truth": np.bool_,
    "code stamp_ns first_ns last_ns clock_ns contact_ns next_look_ns": np.int64,
    "from_x from_y x y left_m": np.float64,
    "begun clock_started touched": np.bool_,
}
STATE = np.dtype(
    (
        np.record,
        [(name, kind) for names, kind in _FIELDS.items() for name in names.split()],
    )
)
States = npt.NDArray[np.void]


def states_of(protocol: Protocol, course: Course) -> States:
    """Return the state (1,) of a trial before its first reading."""
    states: States = np.zeros(1, STATE)
    states["clock_start_m"], states["goal_m"] = (
        protocol.clock_start_distance_m,
        protocol.goal_distance_m,
    )
    states["first_motion_ns"] = nanoseconds(protocol.first_motion_limit_s)
    states["limit_ns"] = nanoseconds(protocol.limit_s)
    states["look_ns"] = nanoseconds(protocol.look_period_s)
    states["contact_ends"] = protocol.collision_ends_trial
    states["clock_by_truth"] = protocol.clock_start_source == "truth"
    states["goal_by_truth"] = protocol.goal_source == "truth"
    goal = (
        course.goal
        if protocol.goal_source == "truth"
        else course.start.inverse() @ course.goal
    )
    states["goal_x"], states["goal_y"] = goal.x, goal.y
    return states


@njit(cache=True)
def observe(
    states: States,
    which: Integers,
    stamps_ns: Integers,
    odometry: Floats,
    truths: Floats,
    contacts: Bools,
) -> None:
    """Judge a reading of each of the trials `which` that still runs, by their rows of all arrays.

    odometry, truths (n, 3): x, y, yaw in the odom and the map frame; contacts (n,): since the reading before.
    """
    for i in which:
        if states[i].code == RUNNING:
            _observe(states[i], stamps_ns[i], odometry[i], truths[i], contacts[i])


@njit(cache=True)
def _observe(
    state: np.record, now_ns: int, odometry: Floats, truth: Floats, contact: bool
) -> None:
    state.stamp_ns = now_ns
    if state.begun and now_ns < state.last_ns:
        state.code = CLOCK_BACK
    elif not np.isfinite(odometry).all():
        state.code = ODOMETRY_LOST
    elif not np.isfinite(truth).all():
        state.code = TRUTH_LOST
    if state.code != RUNNING:
        return
    moved, arrived = (
        truth if state.clock_by_truth else odometry,
        truth if state.goal_by_truth else odometry,
    )
    if not state.begun:
        state.begun, state.first_ns, state.last_ns, state.next_look_ns = (
            True,
            now_ns,
            now_ns,
            now_ns,
        )
        state.from_x, state.from_y = moved[0], moved[1]
    if contact:
        state.contact_ns += now_ns - state.last_ns
    state.last_ns, state.x, state.y = now_ns, truth[0], truth[1]
    state.left_m = math.hypot(arrived[0] - state.goal_x, arrived[1] - state.goal_y)
    state.touched = state.touched or contact
    if now_ns < state.next_look_ns:
        return
    while state.look_ns and state.next_look_ns <= now_ns:
        state.next_look_ns += state.look_ns
    if (
        not state.clock_started
        and math.hypot(moved[0] - state.from_x, moved[1] - state.from_y)
        > state.clock_start_m
    ):
        state.clock_started, state.clock_ns = True, now_ns
    state.code = _judged(state, state.touched)


@njit(cache=True)
def _judged(state: np.record, contact: bool) -> int:
    """Return how a trial stands whose reading has been taken."""
    if contact and state.contact_ends:
        return COLLISION
    if not state.clock_started:
        return (
            NO_FIRST_MOTION
            if state.last_ns - state.first_ns >= state.first_motion_ns
            else RUNNING
        )
    on_clock_ns = state.last_ns - state.clock_ns
    if state.left_m <= state.goal_m and on_clock_ns <= state.limit_ns:
        return SUCCESS
    return TIMEOUT if on_clock_ns >= state.limit_ns else RUNNING
