"""Pictures in three dimensions: what stands where is seen where, and a Jackal looks like one."""

import math
from dataclasses import replace

import numpy as np
import pytest
from refusals import refused

from barn_sim.body.model import model_of
from barn_sim.config import LidarConfig
from barn_sim.drawing.camera import CAMERAS, Studio, camera_at
from barn_sim.drawing.meshes import pillars, prism
from barn_sim.drawing.robot_parts import jackal_parts, robot_parts
from barn_worlds.base.types import ORIGIN, Pose2D
from barn_worlds.geometry.polygon import area
from barn_worlds.robots.files import STANDARD_ROBOT, load_robot
from barn_worlds.worlds.scene import TrialScene

BOUNDS = (-5.0, 0.0, 0.0, 13.0)
SIZE = (400, 168)


def scene(pillar, radius_m, height_m, start=None, goal=None):
    """A scene of one pillar."""
    empty = np.empty((0, 2))
    return TrialScene(np.array([pillar]), empty, radius_m, height_m, empty, start, goal)


@pytest.fixture(scope="module")
def studio():
    start = Pose2D(-4.5, 0.5, 0.0)
    goal = Pose2D(-0.5, 12.5, 0.0)
    trail = np.column_stack([np.full(50, -4.0), np.linspace(2.0, 4.0, 50)])
    pillar = scene([-2.5, 8.0], 0.3, 1.0, start, goal)
    with Studio(pillar, LidarConfig(), trail_m=trail) as studio_object:
        yield studio_object


def yellow(picture):
    """Where the fenders are seen: rows and columns (n, 2) of what is clearly yellow."""
    red, green, blue = np.moveaxis(picture.astype(int), 2, 0)
    return np.argwhere((red > 120) & (green > 0.6 * red) & (blue < 0.4 * red))


def close_up(studio, pose, camera):
    """Where the fenders are seen in a small picture."""
    return yellow(studio.picture(pose, camera, (200, 120), finer=1))


def test_from_above_the_robot_is_at_its_place(studio):
    up = 0.5 * math.pi
    poses = [Pose2D(-2.5, 3.0, up), Pose2D(-2.5, 6.0, up), Pose2D(-1.5, 6.0, up)]
    camera = camera_at("top", poses[0], BOUNDS)
    pictures = [studio.picture(pose, camera, SIZE) for pose in poses]
    first, ahead, beside = (yellow(picture).mean(axis=0) for picture in pictures)
    along = ahead - first
    aside = beside - ahead
    assert along[1] > 50.0
    assert abs(along[0]) < 2.0
    per_metre = along[1] / 3.0
    assert aside[0] == pytest.approx(per_metre, rel=0.1)  # to the robot's right is down
    assert abs(aside[1]) < 2.0
    middle = np.array([0.5 * SIZE[1], 0.5 * SIZE[0]])
    assert ahead == pytest.approx(middle + [0.0, -0.5 * per_metre], abs=3.0)


def test_the_chase_camera_keeps_the_robot_in_the_middle(studio):
    for yaw in (0.0, 2.0, -1.2):
        pose = Pose2D(-2.0, 3.0, yaw)
        pixels = close_up(studio, pose, camera_at("chase", pose, BOUNDS))
        assert len(pixels) > 50
        assert pixels[:, 1].mean() == pytest.approx(100.0, abs=4.0)


def test_a_pillar_hides_what_is_behind_it(studio):
    """Seen along y from below it, the pillar at y = 8 m stands between camera and robot."""
    up = 0.5 * math.pi
    camera = camera_at("chase", Pose2D(-2.5, 6.0, up), BOUNDS)
    low = type(camera)((-2.5, 4.0, 0.3), (-2.5, 8.0, 0.3))
    assert len(close_up(studio, Pose2D(-2.5, 6.5, up), low)) > 30
    assert len(close_up(studio, Pose2D(-2.5, 9.5, up), low)) == 0


def test_the_trail_is_seen_as_far_as_it_is_driven(studio):
    pose = Pose2D(-1.0, 10.0, 0.0)
    camera = camera_at("top", pose, BOUNDS)
    none, half, whole = (
        studio.picture(pose, camera, SIZE, driven=count).astype(int)
        for count in (0, 25, 49)
    )

    def length(picture):
        is_trail = np.abs(picture - none).sum(axis=2) > 60
        return np.ptp(np.argwhere(is_trail)[:, 1])

    assert length(whole) / length(half) == pytest.approx(2.0, rel=0.15)


@pytest.mark.parametrize("name", ["side", "top"])
def test_side_and_top_show_everything(studio, name):
    for pose in (Pose2D(-4.5, 0.5, 0.0), Pose2D(-0.5, 12.5, 0.0)):
        camera = camera_at(name, pose, studio.bounds_m)
        pixels = yellow(studio.picture(pose, camera, (800, 360)))
        assert len(pixels) > 10
        assert pixels[:, 1].min() > 0 and pixels[:, 1].max() < 799


def test_an_unknown_camera_is_refused():
    pose = ORIGIN
    message = "camera must be one of chase, top, side, got 'sid'; did you mean 'side'"
    with refused(message):
        camera_at("sid", pose, BOUNDS)
    assert all(camera_at(name, pose, BOUNDS).eye[2] > 1.0 for name in CAMERAS)


def test_the_jackal_stands_inside_its_outline():
    lidar = LidarConfig(mount_x_m=0.05)
    model = model_of(STANDARD_ROBOT.chassis)
    left, below, right, above = model.extent
    parts = jackal_parts(STANDARD_ROBOT.chassis, lidar)
    for part in parts:
        x, y, _ = part.center
        reach = 0.5 * part.sizes[0] if len(part.sizes) == 3 else 0.0
        assert left - 0.06 <= x - reach
        assert x + reach <= right + 0.06
        assert below - 0.03 <= y <= above + 0.03
    upright = [part.center for part in parts if len(part.sizes) == 2]
    of_lidar = [x == 0.05 and abs(z - lidar.mount_z_m) < 0.04 for x, _, z in upright]
    assert sum(of_lidar) == 3
    size = (model.wheel_radius_m, 0.042)
    wheels = [list(part.center) for part in parts if part.sizes == size]
    assert wheels == model.wheels.tolist()


WEDGE = ((0.6, 0.0), (0.45, 0.34), (-0.5, 0.34), (-0.5, -0.34), (0.45, -0.34))


def draw_mesh(mesh):
    """Return the normals (n, 3) of a mesh's triangles, twice their area long, those it has, and their corners."""
    faces = np.array(mesh["indices"]).reshape(-1, 3)
    corners = np.array(mesh["vertices"])[faces]
    normals = np.array(mesh["normals"])
    across = np.cross(*np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 0))
    means = normals[faces].mean(axis=1)
    assert len(normals) == len(mesh["vertices"])
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)
    assert (np.einsum("ij,ij->i", across, means) > 0.0).all()  # each faces outwards
    return across, means, corners


def test_a_prism_is_drawn_as_it_is():
    """It is closed, faces outwards, and has the area of two bases and its sides."""
    across, _, corners = draw_mesh(prism(WEDGE, 0.4))
    outwards = np.einsum("ij,ij->i", across, corners.mean(axis=1))
    assert (outwards > 0.0).all()  # the origin is within
    sides = zip(WEDGE, WEDGE[1:] + WEDGE[:1], strict=True)
    around = sum(math.dist(a, b) for a, b in sides)
    surface = 0.5 * np.linalg.norm(across, axis=1).sum()
    assert surface == pytest.approx(2.0 * area(WEDGE) + 0.4 * around)


def test_robots_look_like_their_bodies():
    husky = load_robot("husky")
    pointed = replace(husky.chassis, name="pointed", footprint_m=WEDGE)
    body, front, *_ = robot_parts(pointed, husky.lidar)
    high = pointed.body_height_m
    low = pointed.ground_clearance_m
    assert body.sizes == (pytest.approx(high - low),)
    corners = np.array(body.corners) + body.center[:2]
    assert corners == pytest.approx(np.array(pointed.hull_m))
    assert front.center[:2] == (0.6, 0.0)
    for name, sizes in (("husky", (0.99, 0.67, 0.26)), ("turtlebot4", (0.171, 0.3465))):
        robot = load_robot(name)
        body, *_ = robot_parts(robot.chassis, robot.lidar)
        assert body.sizes == pytest.approx(sizes)


@pytest.mark.parametrize("name", ["turtlebot3_waffle", "turtlebot4"])
def test_casters_stand_on_the_ground(name):
    robot = load_robot(name)
    parts = robot_parts(robot.chassis, robot.lidar)
    casters = [part for part in parts if len(part.sizes) == 1]
    assert tuple(part.center[:2] for part in casters) == robot.chassis.casters_m
    for ball in casters:
        lowest = ball.center[2] - ball.sizes[0]
        assert lowest == pytest.approx(-robot.chassis.base_height_m)


def test_pillars_are_closed_but_for_their_feet():
    across, means, _ = draw_mesh(pillars(np.array([[1.0, 2.0], [-3.0, 0.5]]), 0.1, 0.8))
    area = 0.5 * np.linalg.norm(across, axis=1)
    upwards = means[:, 2] > 0.5
    around = 2 * math.pi * 0.1 * 0.8
    assert area[~upwards].sum() == pytest.approx(2 * around, rel=0.02)
    assert area[upwards].sum() == pytest.approx(2 * math.pi * 0.01, rel=0.05)
