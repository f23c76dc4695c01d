"""Wheels on the ground against plain references: friction solved by a general optimizer, and statics by hand."""

import math
from contextlib import ExitStack, closing
from dataclasses import replace

import numpy as np
import pytest
from numba import njit
from numpy.testing import assert_allclose
from refusals import refused
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from barn_sim.body.friction import SWEEPS, begin_friction, sweep_friction
from barn_sim.body.model import model_of
from barn_sim.body.rigid_body import Tires, load_wheels, tire_forces, world_inertia
from barn_sim.body.state import WHEEL
from barn_sim.body.vectors import quaternion, rotation, vector
from barn_sim.config import PhysicsConfig, SimulatorConfig, with_robot
from barn_sim.contact.scene import ContactScene
from barn_sim.motion.ticks import base_motion, body_state, follow_body, solve_tires
from barn_sim.simulator import Simulator
from barn_worlds.base.types import ORIGIN, Pose2D, Velocity2D
from barn_worlds.robots.files import STANDARD_ROBOT, load_robot
from barn_worlds.robots.parts import DriveConfig

G = 9.81
FRICTION = 0.5
SEPARATION = 1.5 * 0.37559


@njit
def push(robots, settings, left, right):
    robot = robots[0]
    robot.left_m_s, robot.right_m_s = left, right
    solve_tires(robot, settings[0])
    force, torque = tire_forces(robot, settings[0])
    return vector(robot.position), force, torque


@njit
def load(robots, settings):
    robot = robots[0]
    return load_wheels(robot, settings[0], rotation(quaternion(robot.attitude)))


class Driven:
    """The robot on the ground in PyBullet with its wheels at given speeds."""

    def __init__(self, world, yaw=0.0, tick_s=0.005):
        self.tick_s = tick_s
        config = SimulatorConfig(physics=PhysicsConfig(tick_s=tick_s))
        self.simulator = Simulator(world, config, Pose2D(0.0, 0.0, yaw), 0)
        self.fleet = self.simulator.motion.drive.fleet
        # Odometry has no part in this.
        self.fleet.settings["odometry_ns"] = 2**62
        self.scene = ContactScene(self.simulator.motion.model, config.physics)
        self.scene.place_robot(body_state(self.fleet.robots, 0))

    def run(self, speed, turn, duration_s):
        half = 0.5 * SEPARATION * turn
        robots, settings = self.fleet.robots, self.fleet.settings
        for _ in range(round(duration_s / self.tick_s)):
            state = self.scene.tick(*push(robots, settings, speed - half, speed + half))
            follow_body(self.fleet, 0, state)

    def close(self):
        self.scene.close()
        self.simulator.close()

    @property
    def pose(self):
        return Pose2D(*base_motion(self.fleet, 0)[:3])

    @property
    def velocity(self):
        return Velocity2D(*base_motion(self.fleet, 0)[3:])


@pytest.fixture
def driven(empty_world):
    with ExitStack() as stack:

        def make(**options):
            return stack.enter_context(closing(Driven(empty_world, **options)))

        yield make


def rows(matrix):
    """Return a matrix (3, 3) as the kernels take it."""
    return tuple(tuple(row) for row in matrix.tolist())


def reference_friction(
    velocity, spin, rims, arms, limits, mass, inverse_inertia, rolling, softness=0.0
):
    """Velocity (2,) and spin (3,) after friction, as the point of least energy of the relative motion.

    Coulomb friction with given loads is the convex problem: minimize half of the impulses' energy plus their work on
    the slip, each impulse within its circle. Solved here by a general optimizer instead of sweeps. A tire that slips
    by softness (n,) times its impulse stores that as well.
    """
    softness = np.repeat(softness * np.ones(len(arms)), 2)
    count = len(arms)
    axes = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    moved = np.cross(arms[:, None], axes)  # (n, 2, 3)

    def after(impulses):
        pushed = impulses.reshape(count, 2)
        new_spin = spin + inverse_inertia @ np.einsum("nk,nkd->d", pushed, moved)
        return velocity + pushed.sum(axis=0) / mass, new_spin

    def slips(impulses):
        v, w = after(impulses)
        at_wheels = v + np.cross(w, arms)[:, :2]
        return (at_wheels - np.outer(rims, rolling)).ravel()

    start = slips(np.zeros(2 * count))

    def energy(impulses):
        return 0.5 * impulses @ (slips(impulses) + start + softness * impulses)

    def gradient(impulses):
        return slips(impulses) + softness * impulses

    def room(impulses):
        return limits**2 - (impulses.reshape(count, 2) ** 2).sum(axis=1)

    best = minimize(
        energy,
        np.zeros(2 * count),
        jac=gradient,
        constraints={"type": "ineq", "fun": room},
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-15},
    )
    return after(best.x)


@pytest.mark.parametrize("full_slip_mps", [0.0, 0.05])
@pytest.mark.parametrize("seed", range(12))
def test_friction_is_that_of_a_general_optimiser(seed, full_slip_mps):
    rng = np.random.default_rng(seed)
    model = model_of(STANDARD_ROBOT.chassis)
    yaw = rng.uniform(-3.0, 3.0)
    turn = np.array(rotation((0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw))))
    touching = model.wheels - [0.0, 0.0, model.wheel_radius_m]
    arms = (touching - model.center_of_mass) @ turn.T
    limits = rng.uniform(0.02, 0.2, 4)
    velocity = rng.normal(0.0, 0.3, 2)
    spin = rng.normal(0.0, [0.05, 0.05, 1.0])
    left, right = rng.normal(0.0, 0.4, 2)
    inverse = turn @ np.diag(1.0 / model.inertia) @ turn.T
    rolling = np.array([math.cos(yaw), math.sin(yaw)])

    wheels = np.zeros(4, WHEEL)
    wheels["arm_x"], wheels["arm_y"], wheels["arm_z"] = arms.T
    wheels["limit"] = limits
    inverse_mass = 1.0 / model.mass_kg
    before = (*velocity, *spin)
    motion, speeds = begin_friction(
        before,
        left,
        right,
        wheels,
        rows(turn),
        rows(inverse),
        inverse_mass,
        full_slip_mps,
    )
    after = sweep_friction(motion, speeds, wheels, inverse_mass, SWEEPS)

    rims = np.array([left, right, left, right])
    expected = reference_friction(
        velocity,
        spin,
        rims,
        arms,
        limits,
        model.mass_kg,
        inverse,
        rolling,
        full_slip_mps / limits,
    )
    assert_allclose(after[:2], expected[0], atol=2e-5)
    assert_allclose(after[2:], expected[1], atol=2e-4)
    impulses = np.hypot(wheels["impulse_x"], wheels["impulse_y"])
    assert (impulses <= limits * (1 + 1e-12)).all()


def test_a_tire_that_slips_lags_by_the_share_of_its_friction(empty_world):
    # At 1 m/s2 the tires need a fifth of what friction allows, so the body is that
    # share of the full slip slower than its wheels.
    plain = replace(SimulatorConfig(), drive=DriveConfig(max_acceleration_m_s2=1.0))
    speeds_mps = []
    for slip_mps in (0.0, 0.05):
        config = replace(plain, physics=PhysicsConfig(tire_slip_mps=slip_mps))
        robot = Simulator(empty_world, config, ORIGIN, 0)
        with closing(robot):
            for _ in range(16):
                sensors = robot.step(Velocity2D(2.0, 0.0))
        speeds_mps.append(sensors.truth.velocity.linear)
    lag_mps = 0.05 * 1.0 / (FRICTION * G)
    assert speeds_mps[0] - speeds_mps[1] == pytest.approx(lag_mps, rel=0.05)


def test_a_body_too_light_for_the_physics_step_is_refused():
    chassis = load_robot("husky").chassis
    light = replace(chassis, name="feather", inertia_kg_m2=(0.2, 1.0, 1.0))
    message = r"^robot feather: chassis.inertia_kg_m2 is too small .* 0.005 s"
    with refused(message):
        Tires(model_of(light), PhysicsConfig())
    tires = Tires(model_of(light), PhysicsConfig(tick_s=0.0005))
    assert tires.rest[0] == pytest.approx(0.187, abs=0.001)


def test_inertias_turn_with_the_body():
    rng = np.random.default_rng(3)
    for _ in range(200):
        attitude = Rotation.random(rng=rng).as_quat().tolist()
        turn = np.array(rotation(tuple(attitude)))
        inverse = np.exp(rng.normal(size=3))
        turned = world_inertia(rows(turn), tuple(inverse))
        expected = turn @ np.diag(inverse) @ turn.T
        assert_allclose(turned, expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("robot, within", [("jackal", 1e-3), ("turtlebot4", 0.02)])
def test_loads_carry_the_weight_and_balance_at_rest(empty_world, robot, within):
    """Of four wheels, and of two and a caster."""
    config = with_robot(SimulatorConfig(), load_robot(robot))
    with closing(Simulator(empty_world, config, Pose2D(0.0, 0.0, 0.7), 0)) as simulator:
        model = simulator.motion.model
        fleet = simulator.motion.drive.fleet
        contacts = len(model.wheels) + len(model.casters)
        torque = load(fleet.robots, fleet.settings)
        loads = fleet.robots["wheels"]["load"][0, :contacts]
    weight = model.mass_kg * G
    assert loads.sum() == pytest.approx(weight, rel=within)
    assert np.abs(torque).max() < within * weight * 0.26


def test_starts_at_rest_where_it_was_put_and_stays(driven):
    robot = driven(yaw=0.7)
    robot.run(0.0, 0.0, 5.0)
    pose = robot.pose
    velocity = robot.velocity
    assert math.hypot(*pose.position) < 1e-5
    assert abs(pose.yaw - 0.7) < 1e-6
    assert abs(velocity.linear) < 1e-9
    assert abs(velocity.angular) < 1e-9


@pytest.mark.parametrize("speed", [0.1, 0.5, 2.0, -0.5])
def test_drives_straight_at_the_speed_of_its_wheels(driven, speed):
    robot = driven()
    robot.run(speed, 0.0, 2.0)
    assert robot.velocity.linear == pytest.approx(speed, abs=1e-4)
    assert abs(robot.pose.y) < 2e-3


def test_speed_changes_by_friction_times_gravity(driven):
    robot = driven()
    robot.run(2.0, 0.0, 0.2)
    assert robot.velocity.linear / 0.2 == pytest.approx(FRICTION * G, rel=0.05)
    robot.run(2.0, 0.0, 1.8)
    before = robot.velocity.linear
    robot.run(0.0, 0.0, 0.2)
    braked = (before - robot.velocity.linear) / 0.2
    assert braked == pytest.approx(FRICTION * G, rel=0.03)


def test_turning_does_not_depend_on_the_heading(driven):
    """What Bullet's own friction fails: there the same command gives from 0.1 to 1 rad/s."""
    rates = []
    for yaw in (0.0, 0.4, 0.7854, 1.2):
        robot = driven(yaw=yaw)
        robot.run(0.0, 1.0, 1.0)
        rates.append(robot.velocity.angular)
    assert np.ptp(rates) < 1e-6


def steady_turn(speed, turn):
    """Yaw rate in a steady arc, by integrating the motion in the plane with tiny steps.

    Loads from statics: springs of equal stiffness under weight and the moments of the friction forces.
    """
    model = model_of(STANDARD_ROBOT.chassis)
    wheels = (model.wheels - model.center_of_mass)[:, :2]
    beside = np.column_stack([-wheels[:, 1], wheels[:, 0]])
    height = model.center_of_mass[2] + STANDARD_ROBOT.chassis.base_height_m
    plane = np.column_stack([np.ones(4), wheels])
    half = turn * SEPARATION / 2
    rims = np.array([[speed - half, 0.0], [speed + half, 0.0]] * 2)
    v = np.array([speed, 0.0])
    w = turn
    forces = np.zeros((4, 2))
    dt = 2e-4
    for _ in range(20000):
        fx, fy = forces.sum(axis=0)
        # loads linear over the base; the moments of the forces at the ground about the center of mass balance
        moments = np.array([model.mass_kg * G, -height * fx, -height * fy])
        loads = plane @ np.linalg.solve(plane.T @ plane, moments)
        slip = v + w * beside - rims
        length = np.maximum(np.hypot(*slip.T), 1e-3)
        forces = -FRICTION * (loads / length)[:, None] * slip
        a = forces.sum(axis=0) / model.mass_kg
        v = v + dt * (a + w * np.array([v[1], -v[0]]))  # in the turning frame
        w += dt * (beside * forces).sum() / model.inertia[2]
    return w


@pytest.mark.parametrize(
    "speed, turn", [(0.0, 1.0), (0.2, 0.5), (0.5, 1.0), (0.5, -0.6)]
)
def test_arcs_are_those_of_rigid_wheels_with_coulomb_friction(driven, speed, turn):
    robot = driven()
    robot.run(speed, turn, 4.0)
    expected = steady_turn(speed, turn)
    assert robot.velocity.angular == pytest.approx(expected, rel=0.01)


def test_the_centre_of_rotation_is_off_the_middle_by_centimetres(driven):
    """The weight lies forward of the middle, and in an arc the rear swings out; none of it is in the odometry."""
    robot = driven()
    robot.run(0.0, 1.0, 2.0)
    turned = [robot.pose]
    for _ in range(6):
        robot.run(0.0, 1.0, 1.0)
        turned.append(robot.pose)
    spread = max(a.distance(b) for a in turned for b in turned)
    assert 0.01 < spread < 0.1


@pytest.mark.parametrize("speed, turn", [(0.5, 0.5), (0.0, 1.0)])
def test_the_result_does_not_depend_on_the_tick(driven, speed, turn):
    fine = driven(tick_s=0.001)
    coarse = driven(tick_s=0.005)
    for robot in (fine, coarse):
        robot.run(speed, turn, 3.0)
    assert fine.pose.distance(coarse.pose) < 0.01
    assert fine.velocity.angular == pytest.approx(coarse.velocity.angular, rel=2e-3)


@pytest.mark.parametrize("speed, turn, rate", [(0.0, 1.0, 1.029), (0.5, 1.0, 1.13)])
def test_the_rates_that_the_readme_names(driven, speed, turn, rate):
    robot = driven()
    robot.run(speed, turn, 3.0)
    assert robot.velocity.angular == pytest.approx(rate, abs=0.005)
