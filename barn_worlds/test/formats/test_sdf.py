"""Worlds with motion for other programs: SDF actors that go the same way, pictures and animations."""

from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from barn_worlds.base.errors import WorldError
from barn_worlds.datasets.generate_motion import build_arena
from barn_worlds.drawing.files import write_png
from barn_worlds.drawing.worlds import sheet_figure, world_figure, write_animation
from barn_worlds.formats.sdf import obj_mesh, sdf_text, trajectories, write_sdf
from barn_worlds.moving.motion import Motion, MovingObstacle
from barn_worlds.moving.tracks import Tracks

KEYS = ((0.0, 1.0, 2.0), (1.1, 3.0, 2.0), (4.0, 3.0, 5.0), (6.0, 0.0, 5.0))
CURVE = Motion(
    "polynomial", 8.0, coefficients_m=((0.0, 1.0), (4.0, 1.0), (-4.0, 0.0), (0.0, -1.0))
)
MOVING = (
    MovingObstacle("as <it> is", radius_m=0.5, motion=Motion("gazebo", 6.0, KEYS)),
    MovingObstacle("resting", radius_m=0.5, motion=Motion("gazebo", 9.0, KEYS)),
    MovingObstacle(
        "later", radius_m=0.25, phase_s=2.5, motion=Motion("gazebo", 6.0, KEYS)
    ),
    MovingObstacle("straight", radius_m=0.25, motion=Motion("linear", 6.0, KEYS)),
    MovingObstacle("box", "box", size_x_m=1.0, size_y_m=2.0, yaw_rad=0.5, motion=CURVE),
)


@pytest.fixture
def world():
    return build_arena("arena", MOVING)


@pytest.mark.parametrize("obstacle", MOVING, ids=lambda obstacle: obstacle.name)
def test_the_trajectories_of_an_actor_go_as_the_obstacle_does(obstacle):
    """Gazebo joins waypoints by the spline of motions of the kind `gazebo`; trajectories follow each other."""
    parts = trajectories(obstacle)
    end_s = 0.0
    largest_m = 0.0
    assert sum(part[-1][0] for part in parts) == pytest.approx(obstacle.motion.period_s)
    for part in parts:
        spline = MovingObstacle(
            "part", radius_m=1.0, motion=Motion("gazebo", part[-1][0], tuple(part))
        )
        times_s = np.linspace(0.0, part[-1][0], 500)[:-1]
        positions, _ = Tracks([obstacle]).over(times_s + end_s)
        largest_m = max(
            largest_m, np.abs(Tracks([spline]).over(times_s)[0] - positions).max()
        )
        end_s += part[-1][0]
    assert largest_m < (1e-9 if obstacle.name == "as <it> is" else 0.03)
    assert len(parts) == (2 if obstacle.phase_s else 1)


@pytest.mark.parametrize("flavour", ["gz", "classic"])
def test_sdf_has_walls_and_an_actor_for_each_moving_obstacle(world, flavour):
    root = ElementTree.fromstring(sdf_text(world, flavour)).find("world")
    names = [model.get("name") for model in root.findall("model")]
    assert names == ["ground_plane", "wall_0", "wall_1", "wall_2"]
    assert [actor.get("name") for actor in root.findall("actor")] == [
        item.name for item in MOVING
    ]
    actor = root.find("actor")
    waypoints = actor.findall("script/trajectory/waypoint")
    waypoint_poses = [
        (float(item.findtext("time")), *map(float, item.findtext("pose").split()[:2]))
        for item in waypoints
    ]
    assert tuple(waypoint_poses) == KEYS
    assert actor.findtext("script/loop") == "true"
    if flavour == "gz":
        assert actor.findtext("skin/filename") == "cylinder_0.5_1.obj"
    else:
        assert actor.findtext("link/collision/geometry/cylinder/radius") == "0.5"


def test_the_meshes_that_an_sdf_names_lie_beside_it(world, tmp_path):
    write_sdf(world, tmp_path / "arena.sdf", "gz")
    root = ElementTree.parse(tmp_path / "arena.sdf")
    names = {skin.text for skin in root.findall(".//skin/filename")}
    assert names == {"cylinder_0.5_1.obj", "cylinder_0.25_1.obj", "box_1_2_1.obj"}
    assert names == {file.name for file in tmp_path.glob("*.obj")}


@pytest.mark.parametrize("obstacle", [MOVING[0], MOVING[4]], ids=["cylinder", "box"])
def test_a_mesh_is_closed_outward_and_of_the_right_size(obstacle):
    lines = [line.split() for line in obj_mesh(obstacle).splitlines()]
    points = np.array(
        [[float(word) for word in line[1:]] for line in lines if line[0] == "v"]
    )
    faces = [[int(word) - 1 for word in line[1:]] for line in lines if line[0] == "f"]
    edges = [(face[k - 1], face[k]) for face in faces for k in range(len(face))]
    assert len(set(edges)) == len(edges) and {(b, a) for a, b in edges} == set(edges)
    volume = sum(
        points[face[0]] @ np.cross(points[face[k]], points[face[k + 1]]) / 6.0
        for face in faces
        for k in range(1, len(face) - 1)
    )
    assert volume == pytest.approx(
        np.pi * 0.25 if obstacle.shape == "cylinder" else 2.0, rel=0.01
    )
    assert np.ptp(points, axis=0) == pytest.approx(
        [1.0, 1.0, 1.0] if obstacle.shape == "cylinder" else [1.0, 2.0, 1.0]
    )


def test_an_animation_of_what_does_not_move_is_refused(small_world, tmp_path):
    with pytest.raises(WorldError, match="small: nothing moves in it"):
        write_animation(small_world, tmp_path / "file")


def colored(image, color):
    """Return the centers (x, y) in pixels of all pixels near a color."""
    near = np.abs(np.asarray(image.convert("RGB"), int) - color).max(axis=2) < 40
    return np.argwhere(near)[:, ::-1]


def test_an_animation_shows_obstacles_that_move(tmp_path):
    keys = ((0.0, -8.0, 0.0), (4.0, 8.0, 0.0), (8.0, -8.0, 0.0))
    world = build_arena(
        "one", [MovingObstacle("a", radius_m=0.8, motion=Motion("linear", 8.0, keys))]
    )
    write_animation(world, tmp_path / "one.gif")
    image = Image.open(tmp_path / "one.gif")
    places = []
    assert image.n_frames == 120
    for frame in (0, 16):
        image.seek(frame)
        pixels = colored(image, (0xC7, 0x7E, 0xA9))
        places.append(np.median(pixels, axis=0))
    metres_per_pixel = 8.0 / (places[1][0] - places[0][0])  # from x = -8 m to x = 0
    assert 0.03 < metres_per_pixel < 0.09
    assert abs(places[1][1] - places[0][1]) < 3


def test_pictures_of_one_and_many_worlds_are_written(world, small_world, tmp_path):
    write_png(world_figure(world), tmp_path / "one.png")
    assert len(colored(Image.open(tmp_path / "one.png"), (0xD1, 0x83, 0xAF))) > 500
    sheet = sheet_figure({0: world, 1: small_world})
    (axes,) = sheet.axes
    collections = []
    for collection in axes.collections:
        to_axes = collection.get_transform() - axes.transData
        for path in collection.get_paths():
            vertices = to_axes.transform(path.vertices)
            collections.append(0.5 * (vertices.min(axis=0) + vertices.max(axis=0)))
    places = (world.tracks.at(0.0)[0] - [-10.25, 10.25]) / 0.5 * [1.0, -1.0] + [
        -0.5,
        5.5,
    ]  # cells from the corner
    assert all(
        np.hypot(*(np.array(collections) - place).T).min() < 0.1 for place in places
    )
