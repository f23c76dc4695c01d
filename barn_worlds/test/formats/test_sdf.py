"""Worlds with motion for other programs: SDF actors that go the same way, pictures and animations."""

from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image
from refusals import refused

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
    begin_s = 0.0
    largest_m = 0.0
    for part in parts:
        length_s = part[-1][0]
        motion = Motion("gazebo", length_s, tuple(part))
        spline = MovingObstacle("part", radius_m=1.0, motion=motion)
        times_s = np.linspace(0.0, length_s, 500)[:-1]
        positions, _ = Tracks([obstacle]).over(times_s + begin_s)
        errors_m = Tracks([spline]).over(times_s)[0] - positions
        largest_m = max(largest_m, np.abs(errors_m).max())
        begin_s += length_s
    assert begin_s == pytest.approx(obstacle.motion.period_s)
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
    waypoints = [
        (float(item.findtext("time")), *map(float, item.findtext("pose").split()[:2]))
        for item in actor.findall("script/trajectory/waypoint")
    ]
    assert tuple(waypoints) == KEYS
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


@pytest.mark.parametrize(
    "obstacle, volume_m3, size_m",
    [(MOVING[0], np.pi * 0.25, [1.0, 1.0, 1.0]), (MOVING[4], 2.0, [1.0, 2.0, 1.0])],
    ids=["cylinder", "box"],
)
def test_a_mesh_is_closed_outward_and_of_the_right_size(obstacle, volume_m3, size_m):
    lines = [line.split() for line in obj_mesh(obstacle).splitlines()]
    points = np.array([line[1:] for line in lines if line[0] == "v"], float)
    faces = [np.array(line[1:], int) - 1 for line in lines if line[0] == "f"]
    edges = [(face[k - 1], face[k]) for face in faces for k in range(len(face))]
    assert len(set(edges)) == len(edges) and {(b, a) for a, b in edges} == set(edges)
    triangles = np.array(
        [
            points[[face[0], face[k], face[k + 1]]]
            for face in faces
            for k in range(1, len(face) - 1)
        ]
    )
    volumes_m3 = np.linalg.det(triangles) / 6.0  # each with the origin
    assert volumes_m3.sum() == pytest.approx(volume_m3, rel=0.01)
    assert np.ptp(points, axis=0) == pytest.approx(size_m)


def test_an_animation_of_what_does_not_move_is_refused(small_world, tmp_path):
    with refused("small: nothing moves in it", WorldError):
        write_animation(small_world, tmp_path / "file")


def colored(image, color):
    """Return the centers (x, y) in pixels of all pixels near a color."""
    differences = np.asarray(image.convert("RGB"), int) - color
    return np.argwhere(np.abs(differences).max(axis=2) < 40)[:, ::-1]


def test_an_animation_shows_obstacles_that_move(tmp_path):
    keys = ((0.0, -8.0, 0.0), (4.0, 8.0, 0.0), (8.0, -8.0, 0.0))
    motion = Motion("linear", 8.0, keys)
    world = build_arena("one", [MovingObstacle("a", radius_m=0.8, motion=motion)])
    write_animation(world, tmp_path / "one.gif")
    image = Image.open(tmp_path / "one.gif")
    places = []
    assert image.n_frames == 120
    for frame in (0, 16):
        image.seek(frame)
        pixels = colored(image, (0xC7, 0x7E, 0xA9))
        places.append(np.median(pixels, axis=0))
    along, across = places[1] - places[0]
    assert 0.03 < 8.0 / along < 0.09  # m per pixel, from x = -8 m to x = 0
    assert abs(across) < 3


def test_pictures_of_one_and_many_worlds_are_written(world, small_world, tmp_path):
    write_png(world_figure(world), tmp_path / "one.png")
    drawn = colored(Image.open(tmp_path / "one.png"), (0xD1, 0x83, 0xAF))
    assert len(drawn) > 500
    sheet = sheet_figure({0: world, 1: small_world})
    (axes,) = sheet.axes
    collections = []
    for collection in axes.collections:
        to_axes = collection.get_transform() - axes.transData
        for path in collection.get_paths():
            vertices = to_axes.transform(path.vertices)
            collections.append(0.5 * (vertices.min(axis=0) + vertices.max(axis=0)))
    offsets_m = world.tracks.at(0.0)[0] - [-10.25, 10.25]
    places = offsets_m / [0.5, -0.5] + [-0.5, 5.5]  # cells from the corner
    distances = np.array(collections) - places[:, None]
    assert (np.hypot(*distances.T).min(axis=0) < 0.1).all()
