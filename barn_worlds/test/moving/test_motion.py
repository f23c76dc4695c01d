"""Motions and where obstacles are at a time, against splines evaluated in another way."""

import dataclasses
import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused
from scipy.interpolate import CubicHermiteSpline

from barn_worlds.base.errors import WorldError
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.moving.motion import (
    MOST_KEYS,
    MOST_MOVING,
    Motion,
    MovingObstacle,
    Wall,
)
from barn_worlds.moving.tracks import Tracks
from barn_worlds.worlds.world import World

KEYS = ((0.0, 1.0, 2.0), (1.0, 3.0, 2.0), (4.0, 3.0, 5.0))
CURVE = Motion(
    "polynomial", 8.0, coefficients_m=((0.0, 1.0), (4.0, 1.0), (-4.0, 0.0), (0.0, -1.0))
)


def gazebo_positions(keys, period_s, times_s):
    """Return where Gazebo Classic's PoseAnimation puts a model (m, 2): on a spline over the numbers of its keys.

    Before the first key and after the last, until the animation wraps, there is nothing to blend with.
    """
    times, points = np.hsplit(np.array(keys), [1])
    numbers = np.arange(len(keys))
    spline = CubicHermiteSpline(numbers, points, [tangent(points, k) for k in numbers])
    return spline(np.interp(np.mod(times_s, period_s), times[:, 0], numbers))


def tangent(points, k):
    """Return the tangent that ignition::math::Spline::RecalcTangents gives point k, with tension 0."""
    closed = (np.abs(points[0] - points[-1]) <= 1e-3).all()
    before = max(k - 1, 0)
    after = min(k + 1, len(points) - 1)
    if closed and k in (0, len(points) - 1):
        before = len(points) - 2
        after = 1
    return (points[after] - points[before]) * 0.5


def obstacle(motion, **fields):
    return MovingObstacle(**{"name": "one", "radius_m": 0.5, **fields}, motion=motion)


@pytest.fixture(scope="module")
def profiles():
    """The 469 motions of DynaBARN by name."""
    dataset = open_dataset("dynabarn60")
    return {
        obstacle.name: obstacle
        for index in dataset.world_numbers
        for obstacle in dataset.load(index).moving
    }


def test_dynabarn_motions_are_where_gazebo_puts_them(profiles):
    assert len(profiles) == 469
    generator = np.random.default_rng(0)
    motions = [profile.motion for profile in profiles.values()]
    longest_s = max(motion.period_s for motion in motions)
    times_s = generator.uniform(0.0, 4.0 * longest_s, 1000)
    positions, _ = Tracks(list(profiles.values())).over(times_s)
    assert positions.shape == (1000, 469, 2)
    for k, motion in enumerate(motions):
        expected = gazebo_positions(motion.keys, motion.period_s, times_s)
        assert np.abs(positions[:, k] - expected).max() < 1e-9


@given(
    st.lists(st.tuples(st.floats(-10, 10), st.floats(-10, 10)), min_size=2, max_size=8),
    st.lists(st.floats(0.01, 20), min_size=8, max_size=8),
    st.floats(0, 5),
    st.floats(0, 5),
    st.booleans(),
    st.floats(-100, 100),
    st.floats(-100, 100),
)
def test_rests_and_phases_are_as_in_gazebo(
    points, steps, first, rest, closed, phase, time
):
    points = [*points, points[0]] if closed else points
    times = np.cumsum([first, *steps])[: len(points)].tolist()
    keys = tuple((at, *point) for at, point in zip(times, points, strict=True))
    period_s = max(times[-1] + rest, 0.01)
    motion = Motion("gazebo", period_s, keys)
    position = Tracks([obstacle(motion, phase_s=phase)]).at(time)[0][0]
    motion_time = math.fmod(time + phase, period_s)
    if min(motion_time % period_s, -motion_time % period_s) <= 1e-9:
        return  # which side of the jump is a matter of rounding
    expected = gazebo_positions(keys, period_s, np.array([time + phase]))
    assert np.abs(position - expected).max() < 1e-9


def test_a_linear_motion_is_straight_and_rests_at_the_end():
    tracks = Tracks([obstacle(Motion("linear", 6.0, KEYS))])
    positions, velocities = tracks.over(np.array([0.5, 2.5, 5.0, 6.5]))
    places_m = [[2.0, 2.0], [3.0, 3.5], [3.0, 5.0], [2.0, 2.0]]
    speeds_mps = [[2.0, 0.0], [0.0, 1.0], [0.0, 0.0], [2.0, 0.0]]
    assert np.allclose(positions[:, 0], places_m, atol=1e-12)
    assert np.allclose(velocities[:, 0], speeds_mps, atol=1e-12)


def test_a_closed_polynomial_has_no_jump():
    # x = 4 s (1 - s), y = 1 + s - s^3 over the share s
    tracks = Tracks([obstacle(CURVE)])
    for time_s in (0.0, 1.0, 5.0, 7.999, 11.0):
        share = time_s % 8.0 / 8.0
        positions, velocities = tracks.at(time_s)
        place_m = [4 * share * (1 - share), 1 + share - share**3]
        slope_m = np.array([4 - 8 * share, 1 - 3 * share**2])
        assert np.allclose(positions[0], place_m, atol=1e-12)
        assert np.allclose(velocities[0], slope_m / 8.0, atol=1e-12)
    assert np.abs(tracks.at(8.0 - 1e-9)[0] - tracks.at(0.0)[0]).max() < 1e-8


def test_velocities_are_how_fast_positions_change(profiles):
    tracks = Tracks(list(profiles.values())[::20])
    step_s = 1e-6
    generator = np.random.default_rng(1)
    for time_s in generator.uniform(0.0, 100.0, 50).tolist():
        (before, _), (at, velocities), (after, _) = (
            tracks.at(time_s + k * step_s) for k in (-1, 0, 1)
        )
        bends = np.abs(after + before - 2 * at).max(axis=1)
        smooth = bends < 1e-8  # no key or jump between
        slope = (after - before) / (2 * step_s)
        assert smooth.mean() > 0.8
        assert np.abs(slope - velocities)[smooth].max() < 1e-3


def test_obstacles_of_all_kinds_are_placed_together():
    obstacles = [
        obstacle(Motion(kind, 6.0, KEYS), name=kind, phase_s=1.0)
        for kind in ("gazebo", "linear")
    ]
    sizes = {"size_x_m": 1.0, "size_y_m": 2.0, "yaw_rad": 0.3}
    obstacles.append(MovingObstacle("box", "box", **sizes, motion=CURVE))
    tracks = Tracks(obstacles)
    assert tracks.names == ("gazebo", "linear", "box")
    assert tracks.radius_m.tolist() == [0.5, 0.5, 0.0]
    assert tracks.size_m.tolist()[2] == [1.0, 2.0]
    positions, _ = tracks.at(2.2)
    for position, single in zip(positions, obstacles, strict=True):
        assert np.array_equal(position, Tracks([single]).at(2.2)[0][0])
    assert Tracks([]).at(1.0)[0].shape == (0, 2)


WRONG_MOTIONS = {
    "one key": (
        {"keys": KEYS[:1]},
        "keys of a gazebo motion must be 2 to 10000, got 1",
    ),
    "no keys": ({}, "keys of a gazebo motion must be 2 to 10000, got 0"),
    "a million keys": (
        {"keys": KEYS[:1] * 10**6},
        f"keys of a gazebo motion must be 2 to {MOST_KEYS}, got 1000000",
    ),
    "out of order": (
        {"keys": (KEYS[0], KEYS[2], KEYS[1])},
        "keys[2] must be later than the key before, at 4 s, got 1 s",
    ),
    "same time": (
        {"keys": (KEYS[0], KEYS[0])},
        "keys[1] must be later than the key before, at 0 s, got 0 s",
    ),
    "before the start": (
        {"keys": ((-1.0, 0.0, 0.0), *KEYS)},
        "keys[0] must not be before 0 s, got -1 s",
    ),
    "NaN": (
        {"keys": (*KEYS, (5.0, math.nan, 0.0))},
        "keys[3] must be finite, up to 10000 m, got [5.0, nan, 0.0]",
    ),
    "infinite": (
        {"keys": (*KEYS, (5.0, 0.0, math.inf))},
        "keys[3] must be finite, up to 10000 m",
    ),
    "NaN time": (
        {"keys": ((0.0, 0.0, 0.0), (math.nan, 0.0, 0.0))},
        "keys[1] must be finite",
    ),
    "two numbers": (
        {"keys": (KEYS[0], (1.0, 2.0))},
        "keys[1] must be time, x and y, got 2 numbers",
    ),
    "short period": (
        {"keys": KEYS, "period_s": 3.0},
        "period_s must not be shorter than the time of the last key, 4 s, got 3.0",
    ),
    "NaN period": (
        {"keys": KEYS, "period_s": math.nan},
        "period_s must be from 0.001 to 100000 s, got nan",
    ),
    "unknown kind": (
        {"keys": KEYS, "kind": "gazeboo"},
        "kind must be one of gazebo, linear, polynomial, got 'gazeboo'; did",
    ),
    "coefficients too": (
        {"keys": KEYS, "coefficients_m": ((0.0, 0.0), (0.0, 0.0))},
        "coefficients_m must be left out for a gazebo motion",
    ),
    "open polynomial": (
        {"kind": "polynomial", "coefficients_m": ((0.0, 0.0), (1.0, 0.0))},
        "coefficients_m must end within 1e-06 m of where they begin, got 1 m",
    ),
    "high polynomial": (
        {"kind": "polynomial", "coefficients_m": ((0.0, 0.0),) * 17},
        "coefficients_m of a polynomial motion must be 2 to 16, got 17",
    ),
}


@pytest.mark.parametrize(
    "arguments, message", WRONG_MOTIONS.values(), ids=WRONG_MOTIONS
)
def test_a_wrong_motion_is_one_clear_line(arguments, message):
    with refused(f"^{re.escape(message)}"):
        Motion(**arguments)


WRONG_OBSTACLES = {
    "no radius": (
        {"radius_m": 0.0},
        "radius_m of a cylinder must be at least 0.01 m, got 0.0",
    ),
    "radius of a box": (
        {"shape": "box", "size_x_m": 1.0, "size_y_m": 1.0},
        "radius_m is of a cylinder; leave it out for a box, got 0.5",
    ),
    "flat box": (
        {"shape": "box", "radius_m": 0.0, "size_x_m": 1.0},
        "size_y_m of a box must be at least 0.01 m, got",
    ),
    "no name": ({"name": ""}, "name must have 1 to 200 printable characters, got ''"),
    "two lines": ({"name": "a\nb"}, "name must have 1 to 200 printable characters"),
    "NaN phase": (
        {"phase_s": math.nan},
        "phase_s must be from -100000 to 100000 s, got nan",
    ),
}


@pytest.mark.parametrize(
    "arguments, message", WRONG_OBSTACLES.values(), ids=WRONG_OBSTACLES
)
def test_a_wrong_obstacle_is_one_clear_line(arguments, message):
    with refused(f"^{re.escape(message)}"):
        obstacle(Motion("linear", 6.0, KEYS), **arguments)


@pytest.mark.parametrize(
    "count, message",
    [
        (2, "two moving obstacles have the name 'one'"),
        (
            MOST_MOVING + 1,
            f"must have at most {MOST_MOVING} moving obstacles, got {MOST_MOVING + 1}",
        ),
    ],
)
def test_a_world_has_few_obstacles_with_unique_names(small_world, count, message):
    mover = obstacle(Motion("linear", 6.0, KEYS))
    with pytest.raises(WorldError) as caught:
        dataclasses.replace(small_world, moving=(mover,) * count)
    assert str(caught.value) == f"small: {message}"


def test_movers_are_in_the_checksum_but_not_their_names(small_world):
    def checksum(**fields):
        return dataclasses.replace(small_world, **fields).checksum

    mover = obstacle(Motion("linear", 6.0, KEYS))
    later = dataclasses.replace(mover, phase_s=0.5)
    renamed = dataclasses.replace(mover, name="two")
    variants = {
        checksum(),
        checksum(moving=(mover,)),
        checksum(moving=(later,)),
        checksum(walls=(Wall(),)),
        checksum(corner_m=(0.0, 0.0)),
    }
    assert len(variants) == 5
    assert checksum(moving=(renamed,)) == checksum(moving=(mover,))


def test_an_arena_has_its_cells_at_its_corner():
    world = open_dataset("dynabarn60").load(0)
    assert len(world.cylinders_m) == 0 and world.path_length_m == 20.0
    assert world.path_m()[[0, -1]].tolist() == [[11.0, 0.0], [-9.0, 0.0]]
    assert np.array_equal(world.path_m(historical=True), world.path_m())
    assert world.bounds_m == (-10.25, -10.25, 12.25, 10.25)


def test_a_turned_wall_occupies_the_cells_that_its_points_are_in():
    walls = (Wall(1.0, 1.0, 2.0, 0.4, yaw_rad=0.6),)
    free = np.zeros((30, 30), bool)
    path = np.array([[0, 0]])
    world = World("w", free, path, 0.1, walls=walls, corner_m=(0.0, 0.0))
    grid = world.occupancy_map()
    inside = 1.0 - 1e-9
    along, across = np.meshgrid(
        inside * np.linspace(-1.0, 1.0, 2001), inside * np.linspace(-0.2, 0.2, 401)
    )
    x = 1.0 + along * math.cos(0.6) - across * math.sin(0.6)
    y = 1.0 + along * math.sin(0.6) + across * math.cos(0.6)
    expected = np.zeros_like(grid.data)
    expected[(y / 0.1).astype(int), (x / 0.1).astype(int)] = 100
    assert np.array_equal(grid.data, expected)


def test_nothing_is_faster_than_the_bound_of_its_speed():
    for index in (0, 25, 59):
        tracks = open_dataset("dynabarn60").load(index).tracks
        _, velocities = tracks.over(np.linspace(0.0, 100.0, 5001))
        fastest = np.hypot(velocities[..., 0], velocities[..., 1]).max(axis=0)
        assert (fastest <= tracks.fastest_mps + 1e-9).all()
        assert (tracks.fastest_mps < 3.0 * fastest).all()


def test_numbers_of_tracks_are_floats_where_all_are_whole():
    motion = Motion("linear", 10, ((0, 0, 0), (5, 1, 1)))
    tracks = Tracks([MovingObstacle("a", radius_m=1, phase_s=0, motion=motion)])
    assert all(array.dtype == np.float64 for array in tracks.table[1:])
    assert tracks.radius_m.dtype == np.float64
