"""Motion with and without PyBullet: they agree, and contacts do not depend on history."""

import math
from contextlib import closing

import numpy as np
import pytest
from driving import wander
from numba import njit

from barn_sim.body.drive import turn_wheels
from barn_sim.body.rigid_body import gyroscopic_change, move_body, rotate, tire_forces
from barn_sim.body.vectors import rotation, vector
from barn_sim.config import PHYSICS_VERSION, ObstacleConfig, SimulatorConfig, with_robot
from barn_sim.contact.bullet import bullet
from barn_sim.contact.scene import ContactScene, ScenePool
from barn_sim.motion.ticks import body_state, solve_tires
from barn_sim.simulator import Simulator
from barn_worlds.base.types import Pose2D, Velocity2D
from barn_worlds.robots.files import load_robot
from barn_worlds.worlds.world import World

STEPS = 100
ROBOTS = ["jackal", "turtlebot4", "scout_mini"]


@njit
def tick_freely(robots, pending, settings):
    """Advance by a tick and return force and torque of the ground in it."""
    robot = robots[0]
    turn_wheels(robot, pending[0], settings[0])
    motion = solve_tires(robot, settings[0])
    force, torque = tire_forces(robot, settings[0])
    move_body(robot, settings[0], motion)
    return force, torque


def attitude_of(roll, pitch, yaw):
    """Return the quaternion of rotations about x, y and z, in this order."""
    return bullet.getQuaternionFromEuler([roll, pitch, yaw])


def angle_between(first, second):
    """Return the angle in rad between two attitudes."""
    apart = np.linalg.norm(np.subtract(first, second))
    opposite = np.linalg.norm(np.add(first, second))  # which is the same attitude
    return 2.0 * min(apart, opposite)


@pytest.mark.parametrize("robot", ["jackal", "turtlebot4"])
def test_free_motion_is_that_of_bullet_to_a_nanometer(empty_world, robot):
    """From random states, a thousand ticks under equal forces."""
    rng = np.random.default_rng(0)
    config = with_robot(SimulatorConfig(), load_robot(robot))
    start = Pose2D(-2.25, 5.0, 0.0)
    with closing(Simulator(empty_world, config, start, 0)) as simulator:
        model = simulator.motion.model
        fleet = simulator.motion.drive.fleet
        height = float(fleet.robots["position"][0, 2])
        with closing(ContactScene(model, config.physics)) as scene:
            for _ in range(100):
                simulator.begin(empty_world, start, 0)
                state = fleet.robots[0]
                state["position"] = [
                    *rng.uniform(-3.0, 3.0, 2),
                    height + rng.uniform(0.0, 0.01),
                ]
                roll, pitch = rng.normal(0.0, 0.02, 2)
                state["attitude"] = attitude_of(roll, pitch, rng.uniform(-3.1, 3.1))
                state["velocity"] = rng.normal(0.0, [0.5, 0.5, 0.1])
                state["spin"] = rng.normal(0.0, [0.2, 0.2, 2.0])
                simulator.command(
                    Velocity2D(rng.uniform(-0.5, 1.0), rng.uniform(-2.0, 2.0))
                )

                scene.place_robot(body_state(fleet.robots, 0))
                position = body_state(fleet.robots, 0)[0]
                for _ in range(1000):
                    push = tick_freely(fleet.robots, fleet.pending, fleet.settings)
                    expected = scene.tick(position, *push)
                    position = expected[0]
                free = body_state(fleet.robots, 0)
                assert free[0] == pytest.approx(expected[0], abs=1e-9)
                assert angle_between(free[1], expected[1]) < 1e-9
                assert free[2] == pytest.approx(expected[2], abs=1e-9)
                assert free[3] == pytest.approx(expected[3], abs=1e-9)


def simulator_of(seed, scenes, rng, robot="jackal"):
    """Return a robot in the middle of a sparse world, whose obstacles can be moved if the seed is odd."""
    grid = rng.random((30, 30)) < 0.02
    grid[:, 15] = grid[9:21, 9:21] = False
    world = World("sparse", grid, np.array([[row, 15] for row in range(30)]))
    movable = SimulatorConfig(obstacles=ObstacleConfig(movable=bool(seed % 2)))
    config = with_robot(movable, load_robot(robot))
    x, y = world.path_m()[15]
    start = Pose2D(x, y, rng.uniform(-math.pi, math.pi))
    return Simulator(world, config, start, seed, scenes)


def episode(seed, scenes, robot="jackal"):
    """Return the states after every step, driven at random, and how many steps ended freely."""
    rng = np.random.default_rng(seed)
    with closing(simulator_of(seed, scenes, rng, robot)) as simulator:
        return wander(simulator, rng, STEPS)


@pytest.mark.parametrize("robot", ROBOTS)
def test_contacts_do_not_depend_on_what_the_client_did_before(robot):
    """Clients of a pool are reused for every contact; a new pool begins with new ones."""
    with closing(ScenePool()) as scenes:
        for seed in range(12):
            with closing(ScenePool()) as new:
                expected = episode(seed, new, robot)
            assert episode(seed, scenes, robot) == expected
        assert len(scenes._idle) == 1


def test_episodes_move_freely_and_touch_obstacles():
    touched = []
    for seed in range(8):
        states, free = episode(seed, None)
        assert free > 0
        touched.append(any(state[0] for state in states))
    assert any(touched) and not all(touched)


def test_robots_that_share_clients_move_as_with_their_own():
    def robots(scenes):
        return [
            simulator_of(seed, scenes, np.random.default_rng(seed)) for seed in range(6)
        ]

    with closing(ScenePool()) as scenes:
        shared = robots(scenes)
        alone = robots(None)
        in_contact = 0
        for step in range(STEPS):
            command = Velocity2D(0.5, 1.0 if step % 20 < 10 else -1.0)
            for ours, theirs in zip(shared, alone, strict=True):
                assert ours.step(command).truth == theirs.step(command).truth
                in_contact += ours.motion.is_in_contact
        assert in_contact > 0
        for simulator in (*shared, *alone):
            simulator.close()
        assert 0 < len(scenes._idle) < 6


# Where the fixed drive below ends: x, y (m) and yaw (rad).
FINAL_POSES = {1: (-3.590134114725404, 4.874822183260471, 1.5541987022023653)}


def test_the_version_of_the_physics_names_its_results(walled_world, simulators):
    """A drive into a wall and along it; another result needs another PHYSICS_VERSION."""
    start = Pose2D(-3.5, 4.5, 1.57)
    simulator = simulators(walled_world, SimulatorConfig(), start, 7)
    touched = False
    for step in range(120):
        sensors = simulator.step(Velocity2D(0.6, 0.9 * math.sin(0.1 * step)))
        touched = touched or sensors.collision
    pose, _ = simulator.motion.pose_and_velocity()
    assert touched
    expected = pytest.approx(FINAL_POSES[PHYSICS_VERSION], abs=1e-9)
    assert pose.numbers == expected


def test_a_rotation_is_that_of_the_exponential_map():
    for rate in (0.0, 1e-13, 5e-4, 2.0):
        attitude = rotate((0.0, 0.0, 0.0, 1.0), (0.0, 0.0, rate), 0.005)
        angle = 2.0 * math.atan2(attitude[2], attitude[3])
        assert angle == pytest.approx(0.005 * rate, rel=1e-12, abs=1e-18)


def test_the_gyroscopic_torque_keeps_momentum_and_gains_no_energy():
    """Thin rods precess: the change per tick is that of Euler's equations."""
    inertia = (0.3, 0.5, 0.9)
    attitude = attitude_of(0.3, -0.2, 1.0)
    turn = np.array(rotation(attitude))
    spin = np.array([0.4, -1.0, 2.0])
    local = turn.T @ spin
    expected = turn @ (-np.cross(local, inertia * local) / inertia)
    tick_s = 1e-5
    change = gyroscopic_change(attitude, vector(spin), inertia, tick_s)
    assert np.array(change) / tick_s == pytest.approx(expected, abs=1e-4)

    energies = []
    for _ in range(2000):
        spin = spin + gyroscopic_change(attitude, vector(spin), inertia, 0.005)
        attitude = rotate(attitude, vector(spin), 0.005)
        local = np.array(rotation(attitude)).T @ spin
        energies.append(inertia @ local**2)
    assert max(energies) < 1.02 * energies[0]
