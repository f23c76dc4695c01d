"""What stands and moves as messages: what goes in comes out, and nothing else is taken for it."""

import math

import numpy as np
import pytest

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
    expected = world.tracks.at(12.3)[0]
    message = deserialize(
        encode_moving_poses(world, 12.3, 5_000_000_007), MOVING_POSES.type_name
    )
    assert (
        message.header.frame_id,
        message.header.stamp.sec,
        message.header.stamp.nanosec,
    ) == ("map", 5, 7)
    assert [(pose.position.x, pose.position.y) for pose in message.poses] == [
        tuple(row) for row in expected.tolist()
    ]
    assert message.poses[-1].orientation.z == pytest.approx(np.sin(0.25))
    markers = deserialize(
        encode_moving(world, 12.3, 5_000_000_007), MOVING.type_name
    ).markers
    kinds = {
        name: [marker for marker in markers if marker.ns == name]
        for name in ("obstacles", "walls", "trails")
    }
    assert (
        sum(map(len, kinds.values()))
        == len(markers)
        == len(world.moving) + len(world.walls) + 1
    )
    assert [
        (marker.pose.position.x, marker.pose.position.y)
        for marker in kinds["obstacles"]
    ] == [tuple(p) for p in expected]
    first = kinds["obstacles"][0]
    box = kinds["obstacles"][-1]
    wall = kinds["walls"][0]
    assert (first.type, first.scale.x, first.scale.z, first.pose.position.z) == (
        CYLINDER,
        1.0,
        1.0,
        0.5,
    )
    assert (box.type, box.scale.x, box.scale.y, box.scale.z) == (CUBE, 1.0, 0.5, 0.7)
    assert (wall.type, wall.scale.x, wall.scale.y) == (
        CUBE,
        world.walls[0].size_x_m,
        world.walls[0].size_y_m,
    )
    assert kinds["trails"][0].type == LINE_LIST
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
    np.testing.assert_array_equal(
        decode_moving_poses(encode_moving_poses(world, 12.3, 0)), bodies.poses[:, :2]
    )


def test_no_obstacles_are_none():
    empty = serialize(
        make_message(MOVING_POSES.type_name, header=make_header("map", 0))
    )
    assert decode_moving_poses(empty).shape == (0, 2)


def changed(data, type_name, change):
    message = deserialize(data, type_name)
    change(message)
    return serialize(message)


@pytest.mark.parametrize(
    "change",
    [
        lambda message: setattr(message.markers[0], "ns", "others"),
        lambda message: setattr(message.markers[0], "id", 7),
        lambda message: setattr(message.markers[0], "type", LINE_LIST),
        lambda message: setattr(message.markers[0].scale, "x", 2.0),
        lambda message: setattr(message.markers[0].scale, "z", -1.0),
        lambda message: setattr(message.markers[0].pose.position, "x", math.nan),
        lambda message: setattr(message.markers[0].header, "frame_id", "odom"),
        lambda message: [setattr(message.markers[0].scale, axis, 0.0) for axis in "xy"],
    ],
)
def test_other_markers_are_refused(world, change):
    with pytest.raises(MessageError):
        decode_moving(changed(encode_moving(world, 1.0, 0), MOVING.type_name, change))


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
    cart = outlines[-1] - centers[-1]
    turned = cart @ np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])
    assert np.abs(turned).tolist() == [[pytest.approx(0.5), pytest.approx(0.25)]] * 4


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
    assert (scene.goal.x, scene.goal.y, scene.goal_distance_m) == (-2.25, 13.0, 0.3)
    assert (scene.start.x, scene.start.y, scene.start.yaw) == pytest.approx(
        (-2.25, 3.0, 1.5)
    )
    bare = decode_scene(
        encode_scene(
            TrialScene(SCENE.obstacles_m, SCENE.walls_m, 0.075, 1.0, np.empty((0, 2))),
            0,
        )
    )
    assert (bare.start, bare.goal, len(bare.path_m)) == (None, None, 0)


def test_a_viewer_can_draw_it_and_a_later_scene_takes_its_place():
    first, moved = (
        deserialize(encode_scene(scene, 7), WORLD.type_name).markers
        for scene in (SCENE, SCENE.with_cylinders_at(SCENE.cylinders_m + 1.0))
    )
    keys = [(marker.ns, marker.id) for marker in first]
    assert len(set(keys)) == len(keys) == 6
    assert keys == [(marker.ns, marker.id) for marker in moved]
    assert {marker.header.frame_id for marker in first} == {"map"}
    assert all(
        marker.color.a > 0.0 and marker.scale.x > 0.0 and marker.action == 0
        for marker in first
    )
    assert all(marker.pose.orientation.w != 0.0 for marker in first)
    upright = [
        marker for marker in first if marker.type == CYLINDER and marker.ns != "goal"
    ]
    assert [(marker.pose.position.z, marker.scale.z) for marker in upright] == [
        (0.5, 1.0)
    ] * 3
    assert [marker.pose.position.x for marker in moved[:3]] == [0.0, -1.5, 1.0]


def test_other_markers_are_no_scene():
    def marker(frame="map", namespace="walls", x=0.0, size=1.0, index=0):
        message = make_marker(frame, namespace, CYLINDER, index=index)
        message.pose.position.x = x
        message.scale.x = message.scale.y = message.scale.z = size
        return message

    refused = {
        "namespace 'band'": encoded(marker(namespace="band")),
        "frame 'odom'": encoded(marker("odom")),
        "different sizes": encoded(marker(size=2.0), marker(index=1)),
        "not finite": encoded(marker(namespace="goal", x=np.nan)),
        "not finite, or no size": encoded(marker(namespace="obstacles", size=np.inf)),
        "not a message": b"\0\1\0\0\xff\xff",
    }
    for reason, data in refused.items():
        with pytest.raises(MessageError, match=reason):
            decode_scene(data)
