"""The true scene as a message: what goes in comes out, and nothing else is taken for one."""

import numpy as np
import pytest

from barn_worlds.base.errors import MessageError
from barn_worlds.base.types import Pose2D
from barn_worlds.messages.cdr import deserialise, make, serialise
from barn_worlds.messages.markers import CYLINDER, marker
from barn_worlds.messages.scene import decode_scene, encode_scene
from barn_worlds.messages.topics import WORLD
from barn_worlds.worlds.scene import SceneCylinders, TrialScene

SCENE = TrialScene(
    SceneCylinders(np.array([[-1.0, 2.0], [-2.5, 3.125]]), 0.075, 1.0),
    SceneCylinders(np.array([[0.0, 0.0]]), 0.075, 1.0),
    np.array([[-1.0, 1.0], [-1.0, 2.0], [-0.5, 3.0]]),
    Pose2D(-2.25, 3.0, 1.5),
    Pose2D(-2.25, 13.0, 1.5),
    0.3,
)


def encoded(*markers):
    return serialise(make(WORLD.type_name, markers=list(markers)))


def test_a_scene_comes_out_as_it_went_in():
    found = decode_scene(encode_scene(SCENE, 2_500_000_000))
    assert found.cylinders_m.tolist() == SCENE.cylinders_m.tolist()
    assert (found.obstacles.radius_m, found.obstacles.height_m, len(found.walls.centres_m)) == (0.075, 1.0, 1)
    assert found.path_m.tolist() == SCENE.path_m.tolist()
    assert (found.goal.x, found.goal.y, found.goal_distance_m) == (-2.25, 13.0, 0.3)
    assert (found.start.x, found.start.y, found.start.yaw) == pytest.approx((-2.25, 3.0, 1.5))
    bare = decode_scene(encode_scene(TrialScene(SCENE.obstacles, SCENE.walls, np.empty((0, 2))), 0))
    assert (bare.start, bare.goal, len(bare.path_m)) == (None, None, 0)


def test_a_viewer_can_draw_it_and_a_later_scene_takes_its_place():
    first, moved = (
        deserialise(encode_scene(scene, 7), WORLD.type_name).markers
        for scene in (SCENE, SCENE.moved(SCENE.cylinders_m + 1.0))
    )
    keys = [(one.ns, one.id) for one in first]
    assert len(set(keys)) == len(keys) == 6
    assert keys == [(one.ns, one.id) for one in moved]
    assert {one.header.frame_id for one in first} == {"map"}
    assert all(one.color.a > 0.0 and one.scale.x > 0.0 and one.action == 0 for one in first)
    assert all(one.pose.orientation.w != 0.0 for one in first)
    upright = [one for one in first if one.type == CYLINDER and one.ns != "goal"]
    assert [(one.pose.position.z, one.scale.z) for one in upright] == [(0.5, 1.0)] * 3
    assert [one.pose.position.x for one in moved[:3]] == [0.0, -1.5, 1.0]


def test_other_markers_are_no_scene():
    big, small = (marker("map", "walls", CYLINDER) for _ in range(2))
    big.scale.x = 2.0
    lost = marker("map", "goal", CYLINDER)
    lost.pose.position.x = np.nan
    endless = marker("map", "obstacles", CYLINDER)
    endless.scale.z = np.inf
    refused = {
        "namespace 'band'": encoded(marker("map", "band", CYLINDER)),
        "frame 'odom'": encoded(marker("odom", "walls", CYLINDER)),
        "different sizes": encoded(big, small),
        "not finite": encoded(lost),
        "size that is not finite": encoded(endless),
        "not a message": b"\0\1\0\0\xff\xff",
    }
    for reason, data in refused.items():
        with pytest.raises(MessageError, match=reason):
            decode_scene(data)
