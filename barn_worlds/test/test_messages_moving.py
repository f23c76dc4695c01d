"""Messages of moving obstacles against their tracks."""

import numpy as np
import pytest

from barn_worlds.dataset import open_dataset
from barn_worlds.messages.cdr import deserialise
from barn_worlds.messages.markers import CUBE, CYLINDER, LINE_LIST
from barn_worlds.messages.moving import TRAIL_S, encode_moving, encode_moving_poses, trail_segments
from barn_worlds.messages.topics import MOVING, MOVING_POSES
from barn_worlds.motion import Motion, MovingObstacle
from barn_worlds.world import World


@pytest.fixture
def world() -> World:
    """The easiest world of DynaBARN, with a box that jumps from (1, 0) back to (0, 0) every second."""
    easy = open_dataset("dynabarn60").load(0)
    motion = Motion("linear", 1.0, ((0.0, 0.0, 0.0), (1.0, 1.0, 0.0)))
    box = MovingObstacle("cart", "box", size_x_m=1.0, size_y_m=0.5, yaw_rad=0.5, height_m=0.7, motion=motion)
    return World(
        "moving", easy.grid, easy.path, 0.5, walls=easy.walls, moving=(*easy.moving, box), corner_m=easy.corner_m
    )


def test_markers_and_poses_are_those_of_the_tracks(world):
    expected = world.tracks.at(12.3)[0]
    message = deserialise(encode_moving_poses(world, 12.3, 5_000_000_007), MOVING_POSES.type_name)
    assert (message.header.frame_id, message.header.stamp.sec, message.header.stamp.nanosec) == ("map", 5, 7)
    assert [(pose.position.x, pose.position.y) for pose in message.poses] == [tuple(row) for row in expected.tolist()]
    assert message.poses[-1].orientation.z == pytest.approx(np.sin(0.25))
    markers = deserialise(encode_moving(world, 12.3, 5_000_000_007), MOVING.type_name).markers
    kinds = {name: [one for one in markers if one.ns == name] for name in ("obstacles", "walls", "trails")}
    assert sum(map(len, kinds.values())) == len(markers) == len(world.moving) + len(world.walls) + 1
    assert [(one.pose.position.x, one.pose.position.y) for one in kinds["obstacles"]] == [tuple(p) for p in expected]
    first, box, wall = kinds["obstacles"][0], kinds["obstacles"][-1], kinds["walls"][0]
    assert (first.type, first.scale.x, first.scale.z, first.pose.position.z) == (CYLINDER, 1.0, 1.0, 0.5)
    assert (box.type, box.scale.x, box.scale.y, box.scale.z) == (CUBE, 1.0, 0.5, 0.7)
    assert (wall.type, wall.scale.x, wall.scale.y) == (CUBE, world.walls[0].size_x_m, world.walls[0].size_y_m)
    assert kinds["trails"][0].type == LINE_LIST
    assert len({(one.ns, one.id) for one in markers}) == len(markers)


def test_a_trail_is_the_way_of_the_last_second_without_jumps(world):
    """At 12.3 s the box is at 0.3 m; 0.7 s of its trail lie before its jump."""
    segments = trail_segments(world, 12.3).reshape(-1, 2, 2)
    of_box = segments[(segments[:, :, 1] == 0.0).all(axis=1)]
    lengths = np.hypot(*(of_box[:, 1] - of_box[:, 0]).T)
    assert lengths == pytest.approx(0.1) and len(of_box) == 9
    assert len(segments) == 10 * len(world.moving) - 1
    assert TRAIL_S == 1.0
