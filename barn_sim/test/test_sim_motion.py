"""Motion without PyBullet against PyBullet's, to the last bit."""

import itertools
import math
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from driving import wander

from barn_sim.body.free_motion import (
    attitude_of,
    basis_of,
    spun,
    still_turning,
    turned,
    world_tensor,
)
from barn_sim.body.model import model_of
from barn_sim.config import SimulatorConfig, with_robot
from barn_sim.contact.bullet import PhysicsClient, PhysicsEngine, end
from barn_sim.simulator import Simulator
from barn_worlds.base.types import Pose2D, Velocity2D
from barn_worlds.robots.files import STANDARD_ROBOT, load_robot
from barn_worlds.worlds.world import World

STEPS = 100
CHECK_MOTION = (
    Path(__file__).resolve().parents[2] / "qa" / "fidelity" / "check_motion.py"
)


def simulator_of(
    seed: int,
    client: PhysicsClient,
    rng: np.random.Generator,
    *,
    free_motion: bool = True,
    robot: str = "jackal",
) -> Simulator:
    """Return a robot in the middle of a sparse world, whose obstacles can be moved if the seed is odd."""
    grid = rng.random((30, 30)) < 0.02
    grid[:, 15] = grid[9:21, 9:21] = False
    world = World("sparse", grid, np.array([[row, 15] for row in range(30)]))
    config = with_robot(SimulatorConfig(), load_robot(robot))
    config = replace(
        config, obstacles=replace(config.obstacles, movable=bool(seed % 2))
    )
    x, y = world.path_m()[15]
    start = Pose2D(x, y, rng.uniform(-math.pi, math.pi))
    return Simulator(world, config, start, seed, client, free_motion=free_motion)


def episode(
    seed: int, client: PhysicsClient, *, free_motion: bool, robot: str = "jackal"
) -> tuple[list[tuple], int]:
    """Return the states after every step, driven at random from the middle of a world, and ticks without PyBullet."""
    rng = np.random.default_rng(seed)
    return wander(
        simulator_of(seed, client, rng, free_motion=free_motion, robot=robot),
        rng,
        STEPS,
    )


OTHERS = ["turtlebot4", "turtlebot3_waffle", "scout_mini"]


@pytest.mark.parametrize(
    ("seed", "robot"),
    [*((seed, "jackal") for seed in range(30)), *itertools.product(range(8), OTHERS)],
)
def test_free_motion_is_that_of_bullet_to_the_last_bit(seed, robot, clients):
    """qa/fidelity/check_motion.py does the same in thousands of episodes."""
    expected, none = episode(seed, clients[0], free_motion=False, robot=robot)
    states, free = episode(seed, clients[1], free_motion=True, robot=robot)
    assert none == 0 and free > 0
    assert states == expected


@pytest.mark.parametrize("robot", ["jackal", "scout_mini"])
def test_a_used_engine_is_as_good_as_a_new_one(robot):
    """Obstacles of even seeds are fixed."""
    idle: list[PhysicsEngine] = []
    client = PhysicsClient(idle=idle)
    used = []
    for seed in range(0, 16, 2):
        with closing(PhysicsClient()) as new:
            expected = episode(seed, new, free_motion=True, robot=robot)
        assert episode(seed, client, free_motion=True, robot=robot) == expected
        client.empty()
        used += idle
    end(idle)
    assert len({id(engine) for engine in used}) < len(used)


def test_robots_that_share_engines_move_as_with_their_own():
    idle: list[PhysicsEngine] = []
    seeds = range(0, 8, 2)
    clients = [PhysicsClient(idle=idle) for _ in range(4)]
    shared = [
        simulator_of(seed, client, np.random.default_rng(seed))
        for seed, client in zip(seeds, clients, strict=True)
    ]
    alone = [
        simulator_of(seed, PhysicsClient(), np.random.default_rng(seed))
        for seed in seeds
    ]
    for step in range(STEPS):
        for first, other in zip(shared, alone, strict=True):
            for simulator in (first, other):
                simulator.step(Velocity2D(0.5, 1.0 if step % 20 < 10 else -1.0))
            assert first.sense().truth == other.sense().truth
    assert 0 < len(idle) < 4
    end(idle)


@pytest.mark.parametrize("seed", [2153, 2384, 9219])
def test_so_it_is_where_dozens_of_cylinders_are_pushed(seed):
    """In these episodes the order in which contacts are solved decides."""
    command = [sys.executable, CHECK_MOTION, "--first", str(seed), "--episodes", "1"]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("robot", ["jackal", "turtlebot4", "husky"])
def test_some_episodes_touch_obstacles_and_some_do_not(robot, clients):
    contacts = (
        episode(seed, clients[0], free_motion=True, robot=robot)[0] for seed in range(8)
    )
    touched = [any(state[0] for state in states) for states in contacts]
    assert any(touched) and not all(touched)


@pytest.mark.parametrize("yaw", [0.0, 1.0, 3.1, -3.1, math.pi])
def test_quaternions_become_matrices_and_come_back(yaw):
    for tilt in (0.0, 0.01, 2.0, math.pi):
        sine = math.sin(0.5 * tilt)
        cosine = math.cos(0.5 * tilt)
        heading = (
            sine * math.cos(yaw),
            sine * math.sin(yaw),
            cosine * math.sin(yaw),
            cosine * math.cos(yaw),
        )
        matrix = np.array(basis_of(heading))
        assert matrix @ matrix.T == pytest.approx(np.eye(3), abs=1e-15)
        back = np.array(attitude_of(basis_of(heading)))
        assert abs(back @ heading) == pytest.approx(1.0, abs=1e-15)


def test_a_turn_is_that_of_the_exponential_map():
    for rate in (0.0, 5e-4, 2.0):
        heading = turned((0.0, 0.0, 0.0, 1.0), (0.0, 0.0, rate), 0.005)
        assert 2.0 * math.atan2(heading[2], heading[3]) == pytest.approx(
            0.005 * rate, rel=1e-12, abs=1e-18
        )


def test_a_torque_is_found_that_keeps_a_spin():
    """Although the inertia is still that of another heading, the matrix after the tick is equal to the last bit."""
    rng = np.random.default_rng(0)
    inverse = tuple((1.0 / model_of(STANDARD_ROBOT.chassis).inertia).tolist())
    for _ in range(200):
        yaw, left = rng.uniform(-3.0, 3.0, 2)
        attitude = attitude_of(
            basis_of((0.001, -0.002, math.sin(0.5 * yaw), math.cos(0.5 * yaw)))
        )
        stale = (0.0, 0.0, math.sin(0.5 * left), math.cos(0.5 * left))
        spin = tuple(rng.normal(0.0, [0.02, 0.02, 2.0]).tolist())
        heading = turned(attitude, spin, 0.005)
        exact, torque = still_turning(attitude, spin, heading, stale, inverse, 0.005)
        after = spun(
            world_tensor(basis_of(stale), inverse),
            attitude,
            spin,
            torque,
            inverse,
            0.005,
        )
        assert exact and basis_of(turned(attitude, after, 0.005)) == basis_of(heading)
        assert after == pytest.approx(spin, abs=1e-15)


def test_an_inexact_torque_keeps_the_spin_but_for_rounding():
    inverse = tuple((1.0 / model_of(STANDARD_ROBOT.chassis).inertia).tolist())
    attitude, stale, elsewhere = (
        (0.0, 0.0, math.sin(half), math.cos(half)) for half in (0.3, 0.7, 1.1)
    )
    spin = (0.02, -0.01, 2.0)
    exact, torque = still_turning(attitude, spin, elsewhere, stale, inverse, 0.005)
    after = spun(
        world_tensor(basis_of(stale), inverse), attitude, spin, torque, inverse, 0.005
    )
    assert not exact
    assert after == pytest.approx(spin, abs=1e-15)
    assert (
        spun(
            world_tensor(basis_of(stale), inverse),
            attitude,
            spin,
            (0.0, 0.0, 0.0),
            inverse,
            0.005,
        )
        != after
    )
