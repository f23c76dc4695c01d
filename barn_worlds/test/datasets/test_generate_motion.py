"""Generated motion: of the classes asked for, the same for a seed, inside its field and at speeds of its grid."""

import math

import numpy as np
import pytest
import yaml
from refusals import refused

from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.datasets.generate_motion import (
    MOTION_CLASSES,
    MotionParameters,
    add_crossings,
    add_motion,
    generate_arenas,
    motion_class,
)
from barn_worlds.worlds.world import World


@pytest.fixture(scope="module", params=sorted(MOTION_CLASSES))
def arenas(request):
    """The parameters of a class, and ten arenas of it."""
    parameters = MOTION_CLASSES[request.param]
    return parameters, generate_arenas(parameters, 10, seed=3)


def test_arenas_have_as_many_obstacles_as_their_class(arenas):
    parameters, worlds = arenas
    counts = [len(world.moving) for world in worlds]
    assert parameters.obstacles_min <= min(counts)
    assert max(counts) <= parameters.obstacles_max
    assert len(set(counts)) > 2
    for world in worlds:
        motions = {obstacle.motion for obstacle in world.moving}
        assert len(motions) == len(world.moving)


def test_motions_cross_the_arena_at_grid_speeds(arenas):
    parameters, worlds = arenas
    for obstacle in {obstacle for world in worlds for obstacle in world.moving}:
        keys = np.array(obstacle.motion.keys)
        assert np.abs(keys[:, 1:]).max() <= 10.0
        assert keys[0, 0] == 0.0
        assert keys[-1, 0] == obstacle.motion.period_s
        steps = np.diff(keys, axis=0)
        lengths = np.hypot(steps[:, 1], steps[:, 2])
        durations = steps[:, 0]
        grid = np.round(lengths / durations / 0.1) * 0.1
        off_grid = np.abs(lengths - grid * durations)
        rounding = 0.02 + 0.01 * grid  # of the keys
        assert (off_grid < rounding)[durations > 0.2].all()
        mean = lengths.sum() / durations.sum()
        assert parameters.speed_min_mps - 0.2 <= mean <= parameters.speed_max_mps + 0.2


def test_motions_go_both_ways(arenas):
    _, worlds = arenas
    motions = [obstacle.motion for world in worlds for obstacle in world.moving]
    ways = [motion.keys[-1][1] > motion.keys[0][1] for motion in motions]
    assert 0.2 < np.mean(ways) < 0.8


def test_a_world_depends_on_its_seed_and_number_alone(arenas):
    parameters, worlds = arenas
    again = generate_arenas(parameters, 4, seed=3)
    assert [world.checksum for world in again] == [
        world.checksum for world in worlds[:4]
    ]
    assert generate_arenas(parameters, 1, seed=4)[0].checksum != worlds[0].checksum
    assert worlds[2].provenance.parameters["difficulty"] == parameters.difficulty
    assert worlds[2].provenance.seed == (3, 1, 2)


def test_motion_is_added_to_the_field_of_a_static_world():
    world = open_dataset("barn300").load(100)
    moving_world = add_motion(world, motion_class("easy"), seed=1, obstacles=4)
    assert len(moving_world.moving) == 4
    assert np.array_equal(moving_world.grid, world.grid)
    assert np.array_equal(moving_world.path, world.path)
    positions, _ = moving_world.tracks.over(np.linspace(0.0, 60.0, 600))
    left, _, right, above = world.bounds_m
    beyond_m = 0.5  # a spline swings out between keys
    x, y = np.moveaxis(positions, -1, 0)
    assert left - beyond_m < x.min() and x.max() < right + beyond_m
    assert 5.1 - beyond_m < y.min() and y.max() < above + beyond_m
    again, other = (
        add_motion(world, motion_class("easy"), seed=seed, obstacles=4)
        for seed in (1, 2)
    )
    assert again.checksum == moving_world.checksum != other.checksum


def test_crossings_go_to_and_fro_over_the_path_without_a_jump():
    world = open_dataset("barn300").load(100)
    moving_world = add_crossings(world, motion_class("medium"), seed=1, obstacles=6)
    times_s = np.arange(0.0, 40.0, 0.01)
    positions, _ = moving_world.tracks.over(times_s)
    steps = np.hypot(*np.moveaxis(np.diff(positions, axis=0), 2, 0))
    assert steps.max() <= 0.01 * 1.4 + 1e-9
    assert np.allclose(positions[..., 0].min(axis=0), -4.5, atol=0.02)
    assert np.allclose(positions[..., 0].max(axis=0), 0.0, atol=0.02)
    rows_m = world.path_m()[:, 1]
    crossings_m = np.array([mover.motion.keys[0][2] for mover in moving_world.moving])
    away_m = np.abs(rows_m - crossings_m[:, None])
    assert (away_m.min(axis=1) < 1e-9).all()


def test_crossings_of_an_arena_are_square_to_its_drive():
    (arena,) = generate_arenas(motion_class("easy"), 1, seed=0)
    moving_world = add_crossings(arena, motion_class("easy"), seed=5, obstacles=3)
    for mover in moving_world.moving[-3:]:
        (_, x0, y0), (_, x1, y1), _ = mover.motion.keys
        assert x0 == x1 and {y0, y1} == {-10.0, 10.0}
        speed = 20.0 / mover.motion.keys[1][0]
        assert 0.5 - 1e-9 <= speed <= 0.9 + 1e-9
        assert math.isclose(speed, round(speed, 1), abs_tol=1e-9)


@pytest.mark.parametrize("add_obstacles", [add_motion, add_crossings])
def test_obstacles_move_within_the_map_that_gets_them(add_obstacles):
    path = np.array([[0, 0], [1, 1]])
    world = World("hall", np.zeros((80, 60), bool), path, corner_m=(30.0, 40.0))
    moving_world = add_obstacles(world, motion_class("easy"), seed=1, obstacles=4)
    keys = np.concatenate([mover.motion.keys for mover in moving_world.moving])
    left, below, right, above = world.bounds_m
    assert left <= keys[:, 1].min() <= keys[:, 1].max() <= right
    assert below <= keys[:, 2].min() <= keys[:, 2].max() <= above


WRONG = """
- [{obstacles_min: 20}, "obstacles_min must be at most obstacles_max = [0-9]+, got 20"]
- [{order_min: 3}, "order_min must be at most order_max = 2, got 3"]
- [{speed_min_mps: 2.0}, "speed_min_mps must be at most speed_max_mps = 0.9, got 2.0"]
- [{profiles: 10}, "obstacles_max must be at most profiles = 10, got 14"]
"""


@pytest.mark.parametrize("changes, message", yaml.safe_load(WRONG))
def test_wrong_parameters_are_one_clear_line(changes, message):
    with refused(f"^{message}"):
        MotionParameters(**changes)


def test_an_unknown_class_is_named_with_the_near_one():
    with refused("unknown motion class 'medum'; did you mean 'medium'"):
        motion_class("medum")
