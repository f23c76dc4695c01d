"""What a policy sees, what its answers mean, the stop before collisions, and the planner made of these."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused

from barn_planners.interface import Observation, PlannerStatus, Task
from barn_planners.policy.collision_check import (
    CollisionCheckConfig,
    avoid_collision,
    least_clearance,
)
from barn_planners.policy.file import Policy, write_policy
from barn_planners.policy.planner import PolicyConfig, PolicyPlanner
from barn_planners.policy.space import (
    ObservationEncoder,
    PolicyAction,
    PolicyObservation,
)
from barn_planners.registry import make_planner
from barn_worlds.base.errors import BarnError
from barn_worlds.base.types import ORIGIN, STOP, Odometry, Pose2D, Scan, Velocity2D

FIELD = 2.35619
WALL = [((3.0, -2.0), (3.0, 2.0))]
GOAL = Pose2D(4.0, 3.0, 0.0)


def scan(ranges, angle_min=-FIELD, angle_max=FIELD):
    ranges = np.asarray(ranges, np.float32)
    step = np.float32((angle_max - angle_min) / (len(ranges) - 1))
    return Scan(0, ranges, float(np.float32(angle_min)), float(step), 0.1, 30.0)


def observed(scan, pose=ORIGIN, velocity=STOP):
    return Observation(0, Odometry(0, pose, velocity), scan, pose)


def assert_as_the_reference(config, scan):
    expected = reference_lidar(config, scan)
    assert_allclose(lidar(config, scan), expected, atol=1e-6)


def lidar(config, scan):
    return ObservationEncoder(config).encode(observed(scan), GOAL)[: config.beams]


def reference_lidar(config, scan):
    """Return each sector's share of the range limit, beam by beam in plain Python."""
    width = (config.angle_max_rad - config.angle_min_rad) / config.beams
    sectors = [[] for _ in range(config.beams)]
    for angle, distance in zip(scan.angles(), scan.ranges.tolist(), strict=True):
        place = (angle - config.angle_min_rad) / width
        if -0.5 <= place <= config.beams + 0.5:
            sectors[min(max(math.floor(place), 0), config.beams - 1)].append(distance)
    shares = []
    for distances in sectors:
        valid = [distance for distance in distances if distance >= scan.range_min]
        nearest = min(valid, default=math.inf)
        shares.append(min(nearest, config.range_limit_m) / config.range_limit_m)
    return np.array(shares)


def random_scan(beams, **geometry):
    rng = np.random.default_rng(beams)
    ranges = rng.uniform(0.0, 8.0, beams)
    ranges[rng.random(beams) < 0.1] = np.nan
    ranges[rng.random(beams) < 0.05] = np.inf
    ranges[rng.random(beams) < 0.05] = -np.inf
    return scan(ranges, **geometry)


@pytest.mark.parametrize("sectors", [720, 360, 40, 7, 1])
def test_the_lidar_against_a_plain_reference(sectors):
    assert_as_the_reference(PolicyObservation(beams=sectors), random_scan(720))


def test_a_wider_scan_is_cut_and_one_turned_round_is_turned_back():
    config = PolicyObservation(beams=20)
    assert_as_the_reference(config, random_scan(1080, angle_min=-2.9, angle_max=2.9))
    scan = random_scan(720)
    turned = replace(
        scan,
        ranges=scan.ranges[::-1],
        angle_min=-scan.angle_min,
        angle_increment=-scan.angle_increment,
    )
    assert_array_equal(lidar(config, turned), lidar(config, scan))


def test_a_scan_that_begins_ahead_is_one_from_behind():
    config = PolicyObservation(beams=20)
    around = random_scan(720, angle_min=-math.pi, angle_max=math.pi * 359 / 360)
    ahead = replace(around, ranges=np.roll(around.ranges, -360), angle_min=0.0)
    assert_array_equal(lidar(config, ahead), lidar(config, around))
    half = replace(ahead, ranges=ahead.ranges[:400])
    assert "sees" in ObservationEncoder(config).problem(half)


@pytest.mark.parametrize("sectors", [720, 40])
@pytest.mark.parametrize("range_min", [0.1, 0.0])
@pytest.mark.parametrize("value", [0.0, -0.0, -math.inf, -1.0, 30.0, 65.5, math.inf])
def test_what_is_no_valid_range_is_no_return(sectors, range_min, value):
    config = PolicyObservation(beams=sectors)
    nothing = replace(scan(np.full(720, value)), range_min=range_min)
    assert (lidar(config, nothing) == 1.0).all()


def test_a_scan_coarser_than_the_sectors_fills_all_of_them():
    shares = lidar(PolicyObservation(beams=720), scan(np.linspace(0.5, 4.5, 91)))
    assert (np.diff(shares) >= 0.0).all()
    assert shares[[0, -1]] == pytest.approx([0.1, 0.9])


def test_goal_and_velocity_are_seen_from_the_robot():
    config = PolicyObservation(beams=4)
    pose = Pose2D(1.0, -1.0, math.pi / 2.0)
    observation = observed(scan(np.full(720, np.inf)), pose, Velocity2D(-3.0, 1.0))
    vector = ObservationEncoder(config).encode(observation, Pose2D(1.0, 1.5, 0.0))
    expected = [1, 1, 1, 1, 0.25, 1.0, 0.0, -1.0, 0.25]
    assert_allclose(vector, expected, atol=1e-6)
    low, high = config.bounds()
    assert vector.dtype == np.float32 and ((low <= vector) & (vector <= high)).all()


@pytest.mark.parametrize(
    "narrow_scan, message",
    [
        (scan(np.ones(100), -1.0, 1.0), "the scan covers only -1.000 to 1.000 rad"),
        (replace(scan(np.ones(100)), angle_increment=0.0), "no usable angles"),
    ],
)
def test_a_scan_that_shows_too_little_is_told_of(narrow_scan, message):
    encoder = ObservationEncoder(PolicyObservation())
    assert message in encoder.problem(narrow_scan)
    with refused("scan"):
        encoder.encode(observed(narrow_scan), GOAL)
    assert encoder.problem(scan(np.ones(720))) == ""


def test_actions_become_velocities_within_limits():
    action = PolicyAction(min_speed_mps=-0.5, max_speed_mps=1.5, max_yaw_rate_radps=2.0)
    for values, velocity in (
        ((-1.0, 0.5), Velocity2D(-0.5, 1.0)),
        ((9.0, -9.0), Velocity2D(1.5, -2.0)),
    ):
        assert action.command(np.array(values)) == velocity
    nowhere = np.array([math.nan, 0.0])
    assert not action.command(nowhere).is_finite()
    with refused("max_speed_mps must be above"):
        PolicyAction(min_speed_mps=1.0, max_speed_mps=1.0)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_many_actions_at_once_become_the_same_velocities(kind):
    action = PolicyAction(min_speed_mps=-0.3, max_speed_mps=1.7, max_yaw_rate_radps=2.1)
    actions = np.random.default_rng(0).uniform(-1.5, 1.5, (202, 2)).astype(kind)
    actions[-2:] = [[math.nan, 1.0], [-0.0, math.inf]]
    commands = [action.command(values) for values in actions]
    expected = [command.numbers for command in commands]
    assert_array_equal(action.commands(actions), expected)


def reference_gap(points, velocity, time_s, size_m):
    """Return the least distance of points from the outline, tried at many instants of the drive."""
    pose = ORIGIN
    half = 0.5 * velocity.angular * time_s / 4000
    length = velocity.linear * time_s / 4000
    step = Pose2D(length * math.cos(half), length * math.sin(half), 2.0 * half)
    least = math.inf
    for _ in range(4000):
        pose = pose @ step
        inside = np.abs(pose.inverse().transform(points))
        outside = np.maximum(inside - size_m, 0.0)
        least = min(least, float(np.hypot(*outside.T).min()))
    return least


def test_the_gap_of_a_drive_against_small_steps():
    rng = np.random.default_rng(5)
    config = CollisionCheckConfig()
    size_m = (config.half_length_m, config.half_width_m)
    for _ in range(12):
        points = rng.uniform(-1.0, 1.0, (5, 2)) + [0.8, 0.0]
        velocity = Velocity2D(*rng.uniform(-1.5, 1.5, 2).tolist())
        command = velocity.numbers
        clearance = least_clearance(points, *command, 400, 0.6 / 400, *size_m)
        expected = reference_gap(points, velocity, 0.6, size_m)
        assert clearance == pytest.approx(expected, abs=2e-3)


def ahead(distance_m):
    """Return a scan of a wall `distance_m` ahead of the robot's front."""
    angles = np.linspace(-FIELD, FIELD, 720)
    ranges = (0.254 - 0.055 + distance_m) / np.cos(angles)
    return scan(np.where(np.abs(angles) < 1.0, ranges, np.inf))


def test_the_stop_leaves_commands_alone_that_hit_nothing():
    for command in (Velocity2D(1.0, 0.0), Velocity2D(0.3, 1.0), Velocity2D(-0.3, 0.0)):
        assert allowed(command, STOP, 2.0) == command


def allowed(command, velocity, distance_m):
    """Return the command that the collision check allows before a wall."""
    return avoid_collision(command, velocity, ahead(distance_m), CollisionCheckConfig())


def test_the_stop_brakes_before_a_wall_and_allows_reverse():
    fast = Velocity2D(1.0, 0.0)
    back = Velocity2D(-0.4, 0.0)
    assert allowed(fast, fast, 0.25) == Velocity2D(0.75, 0.0)
    assert allowed(fast, fast, 0.05).linear == 0.0
    assert allowed(back, STOP, 0.01) == back


@pytest.fixture
def linear_policy(tmp_path):
    """Return the function that writes a policy of one layer and returns its path."""

    def write(speed, turn=0.0, sine_gain=0.0):
        matrix = np.zeros((4 + 5, 2), np.float32)
        matrix[6, 1] = sine_gain  # of the sine of the goal's bearing
        action = PolicyAction(
            min_speed_mps=0.0, max_speed_mps=1.0, max_yaw_rate_radps=1.0
        )
        biases = np.array([speed, turn], np.float32)
        policy = Policy(PolicyObservation(beams=4), action, (matrix,), (biases,))
        write_policy(tmp_path / "p.npz", policy)
        return str(tmp_path / "p.npz")

    return write


def test_a_policy_that_steers_for_the_goal_reaches_it(flat_world, linear_policy):
    path = linear_policy(0.2, sine_gain=2.0)
    world = flat_world([((-2.0, 6.0), (8.0, 6.0))])
    planner = make_planner("policy", "challenge", {"policy_path": path})
    status = world.drive(planner, Pose2D(4.0, 2.0, 0.0), 20.0)
    assert status is PlannerStatus.GOAL_REACHED
    assert math.dist(world.pose.position, (4.0, 2.0)) < 0.25


@pytest.mark.parametrize("enabled", [True, False])
def test_a_policy_that_drives_into_walls_is_stopped_before_them(
    flat_world, linear_policy, enabled
):
    world = flat_world(WALL)
    changes = {"policy_path": linear_policy(1.0), "safety.enabled": enabled}
    planner = make_planner("policy", "challenge", changes)
    status = world.drive(planner, Pose2D(6.0, 0.0, 0.0), 10.0)
    assert (world.pose.x + 0.254 < 3.0 - 0.075) is enabled
    if enabled:
        assert status is PlannerStatus.BLOCKED
        assert "too near" in world.decisions[-1].reason


def test_a_policy_that_stands_still_says_that_it_is_stuck(flat_world, linear_policy):
    world = flat_world(WALL)
    planner = PolicyPlanner(PolicyConfig(policy_path=linear_policy(-1.0)))
    assert world.drive(planner, GOAL, 7.0) is PlannerStatus.RUNNING
    assert world.drive(planner, GOAL, 10.0) is PlannerStatus.BLOCKED
    assert "no progress" in world.decisions[-1].reason


def test_a_narrow_scan_stops_the_robot(linear_policy):
    planner = PolicyPlanner(PolicyConfig(policy_path=linear_policy(1.0)))
    planner.start(Task(GOAL), 0)
    decision = planner.step(observed(scan(np.ones(100), -1.0, 1.0)))
    assert decision.command == STOP and "the policy sees" in decision.reason


def test_a_policy_that_is_not_there_is_an_error_of_one_line(tmp_path):
    path = str(tmp_path / "none.npz")
    with refused(r"none\.npz: cannot be read", BarnError):
        make_planner("policy", "challenge", {"policy_path": path})
