"""The path of each hard world is proven for the turned footprint.

The reference is slow and plain.
"""

import math
from itertools import pairwise

import numpy as np
import pytest
from footprint_lattice import POINTS_PER_CELL, build_lattice, path_cells
from generate_hard_worlds import write_hard_worlds
from hard_worlds import (
    KINDS,
    LEAD_IN_CELLS,
    HardParameters,
    generate_hard_world,
    generate_hard_worlds,
    prove_path,
)
from refusals import refused

from barn_worlds.base.errors import WorldError
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.geometry.footprint import Footprint
from barn_worlds.robots.files import STANDARD_ROBOT, load_robot
from barn_worlds.worlds.course import cell_size_m


def least_gap_m(way, grid, side_m, robot):
    """Return how near a robot on a sampled path comes to a grid's cylinders."""
    footprint = Footprint(
        np.array(robot.chassis.hull_m), robot.chassis.footprint_radius_m
    )
    centers = (np.argwhere(grid) + np.array([0.5, 0.5 + LEAD_IN_CELLS])) * side_m
    nearest = math.inf
    for (x, y, yaw), (u, v, later) in pairwise(way):
        turn = (later - yaw + math.pi) % (2.0 * math.pi) - math.pi
        for share in np.linspace(0.0, 1.0, 40):
            at = yaw + share * turn
            point = np.array([x + share * (u - x), y + share * (v - y)])
            dx, dy = (centers - side_m * point).T
            ahead = math.cos(at) * dx + math.sin(at) * dy
            left = math.cos(at) * dy - math.sin(at) * dx
            distance_m = float(footprint.distances(ahead, left).min())
            nearest = min(nearest, distance_m - side_m / 2.0)
    return nearest


@pytest.mark.parametrize("robot", ["jackal", "turtlebot3_burger"])
@pytest.mark.parametrize("kind", KINDS)
def test_the_turned_footprint_keeps_the_margin_all_along_the_way(kind, robot):
    driven = load_robot(robot)
    parameters = HardParameters(kind=kind, resolution_m=cell_size_m(driven))
    world = generate_hard_world(parameters, driven, np.random.default_rng(3), "hard")
    margin_m = parameters.margin_cells * world.resolution_m
    way = prove_path(world.grid, world.resolution_m, driven, margin_m)
    assert least_gap_m(way, world.grid, world.resolution_m, driven) >= margin_m - 1e-9
    steps = np.diff(way[:, :2], axis=0)
    moved = np.hypot(*steps.T) > 0
    # straight ahead
    headings = way[:-1][moved, 2]
    assert np.allclose(np.arctan2(steps[moved, 1], steps[moved, 0]), headings)
    assert np.allclose(headings, way[1:][moved, 2])
    assert world.path[0, 1] == 0
    assert world.path[-1, 1] == parameters.cols - 1


def test_a_gap_is_passed_exactly_where_footprint_and_margin_fit():
    """A gap of four cells, 0.6 m, leaves the Jackal 0.085 m on each side.

    The Jackal is 0.43 m wide.
    """
    grid = np.zeros((20, 20), bool)
    grid[:, 10] = True
    grid[8:12, 10] = False
    start = (30, 6, 4)
    goal = (30, 54)
    for margin_m, fits in ((0.08, True), (0.09, False)):
        lattice = build_lattice(grid, 0.15, STANDARD_ROBOT.chassis, margin_m)
        assert (lattice.find_path(start, goal) is not None) == fits
    grid[11, 10] = True  # three cells, 0.45 m
    lattice = build_lattice(grid, 0.15, STANDARD_ROBOT.chassis, 0.02)
    assert lattice.find_path(start, goal) is None


def test_a_way_without_obstacles_is_the_straight_one():
    free = build_lattice(np.zeros((10, 20), bool), 0.15, STANDARD_ROBOT.chassis, 0.0)
    way = free.find_path((15, 0, 4), (15, 60))
    assert np.allclose(way[0], [5.0, 0.0, math.pi / 2])
    assert np.allclose(way[-1], [5.0, 60 / POINTS_PER_CELL, math.pi / 2])
    assert np.array_equal(path_cells(way)[:, 1], np.arange(21))


def generate(kinds, count, seed):
    parameters = HardParameters()
    return generate_hard_worlds(parameters, kinds, count, seed, STANDARD_ROBOT, "w")


def test_a_world_depends_on_its_seed_kind_and_number_alone():
    worlds = generate(KINDS, 2, seed=11)
    (same,) = generate(["dead_ends"], 1, seed=11)
    (other,) = generate(["dead_ends"], 1, seed=12)
    kinds = [world.provenance.parameters["kind"] for world in worlds]
    assert kinds == [kind for kind in KINDS for _ in range(2)]
    assert same.checksum == worlds[2].checksum
    assert len({world.checksum for world in worlds}) == 8
    assert other.checksum != same.checksum


def test_no_way_in_the_grids_tried_is_said():
    sizes = {"spare_cells": 0, "margin_cells": 2.0, "cols": 24}
    impossible = HardParameters(kind="turns", attempts=1, **sizes)
    with refused("no path through 1 worlds of kind turns", WorldError):
        for seed in range(50):
            generator = np.random.default_rng(seed)
            generate_hard_world(impossible, STANDARD_ROBOT, generator, "hard")


def test_a_data_set_is_written_to_a_new_npz_file_only(tmp_path):
    target = tmp_path / "hard.npz"
    assert write_hard_worlds(target, ["clutter"], 1) == 1
    content = target.read_bytes()
    with refused("exists already"):
        write_hard_worlds(target, ["clutter"], 2)
    assert target.read_bytes() == content
    with refused(r"must end in \.npz"):
        write_hard_worlds(tmp_path / "other", ["clutter"], 1)


def test_the_shipped_hard_worlds_come_again_from_their_seed():
    shipped = open_dataset("barn_hard")
    checksums = {shipped.load(index).checksum for index in shipped.world_numbers}
    for world in generate(["clutter"], 5, shipped.manifest["seed"]):
        assert world.checksum in checksums
