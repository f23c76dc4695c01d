"""What stands and moves as messages: what goes in comes out, and nothing else is taken for it."""

import math
from operator import attrgetter

import numpy as np
import pytest
from refusals import refused

from barn_worlds.base.errors import MessageError
from barn_worlds.base.types import Pose2D
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.geometry.bodies import moving_bodies, wall_bodies
from barn_worlds.messages.cdr import deserialize, make_message, serialize
from barn_worlds.messages.encode import (
    CUBE,
    CYLINDER,
    LINE_LIST,
    make_header,
    make_marker,
)
from barn_worlds.messages.scenes import (
    TRAIL_S,
    decode_moving,
    decode_moving_poses,
    decode_scene,
    encode_moving,
    encode_moving_poses,
    encode_scene,
    trail_segments,
)
from barn_worlds.messages.topics import MOVING, MOVING_POSES, WORLD
from barn_worlds.moving.motion import MOST_MOVING, Motion, MovingObstacle
from barn_worlds.worlds.scene import TrialScene
from barn_worlds.worlds.world import World


@pytest.fixture
def world() -> World:
    """The easiest world of DynaBARN, with a box that jumps from (1, 0) back to (0, 0) every second."""
    easy = open_dataset("dynabarn60").load(0)
    motion = Motion("linear", 1.0, ((0.0, 0.0, 0.0), (1.0, 1.0, 0.0)))
    box = MovingObstacle(
        "cart",
        "box",
        size_x_m=1.0,
        size_y_m=0.5,
        yaw_rad=0.5,
        height_m=0.7,
        motion=motion,
    )
    return World(
        "moving",
        easy.grid,
        easy.path,
        0.5,
        walls=easy.walls,
        moving=(*easy.moving, box),
        corner_m=easy.corner_m,
    )


def test_markers_and_poses_are_those_of_the_tracks(world):
    expected = world.tracks.at(12.3)[0].tolist()
    data = encode_moving_poses(world, 12.3, 5_000_000_007)
    message = deserialize(data, MOVING_POSES.type_name)
    stamp = message.header.stamp
    assert (message.header.frame_id, stamp.sec, stamp.nanosec) == ("map", 5, 7)
    places = [pose.position for pose in message.poses]
    assert [[place.x, place.y] for place in places] == expected
    assert message.poses[-1].orientation.z == pytest.approx(np.sin(0.25))

    data = encode_moving(world, 12.3, 5_000_000_007)
    markers = deserialize(data, MOVING.type_name).markers
    obstacles, walls, trails = (
        [marker for marker in markers if marker.ns == name]
        for name in ("obstacles", "walls", "trails")
    )
    assert (len(walls), len(trails)) == (len(world.walls), 1)
    assert len(markers) == len(obstacles) + len(walls) + 1
    places = [marker.pose.position for marker in obstacles]
    assert [[place.x, place.y] for place in places] == expected
    size = obstacles[0].scale
    assert (obstacles[0].type, size.x, size.z) == (CYLINDER, 1.0, 1.0)
    assert places[0].z == 0.5
    size = obstacles[-1].scale
    assert (obstacles[-1].type, size.x, size.y, size.z) == (CUBE, 1.0, 0.5, 0.7)
    wall = world.walls[0]
    size = walls[0].scale
    assert (walls[0].type, size.x, size.y) == (CUBE, wall.size_x_m, wall.size_y_m)
    assert trails[0].type == LINE_LIST
    assert len({(marker.ns, marker.id) for marker in markers}) == len(markers)


def test_a_trail_is_the_way_of_the_last_second_without_jumps(world):
    """At 12.3 s the box is at 0.3 m; 0.7 s of its trail lie before its jump."""
    segments = trail_segments(world, 12.3).reshape(-1, 2, 2)
    of_box = segments[(segments[:, :, 1] == 0.0).all(axis=1)]
    lengths = np.hypot(*(of_box[:, 1] - of_box[:, 0]).T)
    assert lengths == pytest.approx(0.1) and len(of_box) == 9
    assert len(segments) == 10 * len(world.moving) - 1
    assert TRAIL_S == 1.0


def test_what_is_written_is_read_again(world):
    bodies, walls = decode_moving(encode_moving(world, 12.3, 0))
    expected = moving_bodies(world.tracks, 12.3), wall_bodies(world.walls)
    for bodies_read, written in zip((bodies, walls), expected, strict=True):
        for value, other in zip(bodies_read, written, strict=True):
            np.testing.assert_allclose(value, other, atol=1e-12)
    poses = decode_moving_poses(encode_moving_poses(world, 12.3, 0))
    np.testing.assert_array_equal(poses, bodies.poses[:, :2])


def test_no_obstacles_are_none():
    message = make_message(MOVING_POSES.type_name, header=make_header("map", 0))
    assert decode_moving_poses(serialize(message)).shape == (0, 2)


def changed(data, type_name, change):
    message = deserialize(data, type_name)
    change(message)
    return serialize(message)


@pytest.mark.parametrize(
    "part, field, value",
    [
        ("", "ns", "others"),
        ("", "id", 7),
        ("", "type", LINE_LIST),
        ("scale", "x", 2.0),
        ("scale", "z", -1.0),
        ("pose.position", "x", math.nan),
        ("header", "frame_id", "odom"),
    ],
)
def test_other_markers_are_refused(world, part, field, value):
    message = deserialize(encode_moving(world, 1.0, 0), MOVING.type_name)
    marker = message.markers[0]
    setattr(attrgetter(part)(marker) if part else marker, field, value)
    with pytest.raises(MessageError):
        decode_moving(serialize(message))


def test_a_marker_without_a_size_is_refused(world):
    message = deserialize(encode_moving(world, 1.0, 0), MOVING.type_name)
    scale = message.markers[0].scale
    scale.x = scale.y = 0.0
    with pytest.raises(MessageError):
        decode_moving(serialize(message))


@pytest.mark.parametrize(
    "change",
    [
        lambda message: setattr(message.header, "frame_id", "odom"),
        lambda message: setattr(message.poses[0].position, "y", math.inf),
        lambda message: setattr(
            message, "poses", message.poses * (MOST_MOVING // len(message.poses) + 1)
        ),
    ],
)
def test_other_poses_are_refused(world, change):
    with pytest.raises(MessageError):
        decode_moving_poses(
            changed(encode_moving_poses(world, 1.0, 0), MOVING_POSES.type_name, change)
        )


def test_bytes_that_are_cut_off_are_refused_wherever_that_is(world):
    for read, data in (
        (decode_moving, encode_moving(world, 1.0, 0)),
        (decode_moving_poses, encode_moving_poses(world, 1.0, 0)),
    ):
        for length in range(0, len(data) - 1, len(data) // 50):
            with pytest.raises(MessageError):
                read(data[:length])


def test_outlines_are_those_of_the_shapes(world):
    outlines = moving_bodies(world.tracks, 3.0).outlines()
    centers = world.tracks.at(3.0)[0]
    assert np.hypot(*(outlines[0] - centers[0]).T) == pytest.approx(0.5)
    sin, cos = np.sin(0.5), np.cos(0.5)
    cart = (outlines[-1] - centers[-1]) @ np.array([[cos, -sin], [sin, cos]])
    assert np.abs(cart) == pytest.approx(np.tile([0.5, 0.25], (4, 1)))


SCENE = TrialScene(
    np.array([[-1.0, 2.0], [-2.5, 3.125]]),
    np.array([[0.0, 0.0]]),
    0.075,
    1.0,
    np.array([[-1.0, 1.0], [-1.0, 2.0], [-0.5, 3.0]]),
    Pose2D(-2.25, 3.0, 1.5),
    Pose2D(-2.25, 13.0, 1.5),
    0.3,
)


def encoded(*markers):
    return serialize(make_message(WORLD.type_name, markers=list(markers)))


def test_a_scene_comes_out_as_it_went_in():
    scene = decode_scene(encode_scene(SCENE, 2_500_000_000))
    assert scene.cylinders_m.tolist() == SCENE.cylinders_m.tolist()
    assert (scene.radius_m, scene.height_m, len(scene.walls_m)) == (0.075, 1.0, 1)
    assert scene.path_m.tolist() == SCENE.path_m.tolist()
    assert (*scene.goal.position, scene.goal_distance_m) == (-2.25, 13.0, 0.3)
    start = scene.start.numbers
    assert start == pytest.approx((-2.25, 3.0, 1.5))
    no_path = np.empty((0, 2))
    bare = TrialScene(SCENE.obstacles_m, SCENE.walls_m, 0.075, 1.0, no_path)
    bare = decode_scene(encode_scene(bare, 0))
    assert (bare.start, bare.goal, len(bare.path_m)) == (None, None, 0)


def test_a_viewer_can_draw_it_and_a_later_scene_takes_its_place():
    later = SCENE.with_cylinders_at(SCENE.cylinders_m + 1.0)
    first, moved = (
        deserialize(encode_scene(scene, 7), WORLD.type_name).markers
        for scene in (SCENE, later)
    )
    keys = [(marker.ns, marker.id) for marker in first]
    assert len(set(keys)) == len(keys) == 6
    assert keys == [(marker.ns, marker.id) for marker in moved]
    for marker in first:
        assert marker.header.frame_id == "map"
        assert marker.color.a > 0.0 and marker.scale.x > 0.0
        assert marker.action == 0
        assert marker.pose.orientation.w != 0.0
    upright = [
        marker for marker in first if marker.type == CYLINDER and marker.ns != "goal"
    ]
    assert len(upright) == 3
    for marker in upright:
        assert (marker.pose.position.z, marker.scale.z) == (0.5, 1.0)
    assert [marker.pose.position.x for marker in moved[:3]] == [0.0, -1.5, 1.0]


def test_other_markers_are_no_scene():
    def marker(frame="map", namespace="walls", x=0.0, size=1.0, index=0):
        message = make_marker(frame, namespace, CYLINDER, index=index)
        message.pose.position.x = x
        message.scale.x = message.scale.y = message.scale.z = size
        return message

    malformed = {
        "namespace 'band'": encoded(marker(namespace="band")),
        "frame 'odom'": encoded(marker("odom")),
        "different sizes": encoded(marker(size=2.0), marker(index=1)),
        "not finite": encoded(marker(namespace="goal", x=np.nan)),
        "not finite, or no size": encoded(marker(namespace="obstacles", size=np.inf)),
        "not a message": b"\0\1\0\0\xff\xff",
    }
    for reason, data in malformed.items():
        with refused(reason, MessageError):
            decode_scene(data)
