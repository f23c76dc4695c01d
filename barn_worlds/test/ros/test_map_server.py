"""The map server as a node among others: what it serves, how it reloads, and how it fails."""

from contextlib import closing
from functools import partial

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from nav_msgs.msg import OccupancyGrid, Path  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from ros_peer import Peer, Process  # noqa: E402

from barn_worlds.datasets.dataset import open_dataset  # noqa: E402
from barn_worlds.messages import decode  # noqa: E402
from barn_worlds.messages.topics import LATCHED  # noqa: E402
from barn_worlds.ros.map_server import MapServer  # noqa: E402
from barn_worlds.ros.topics import qos_profile  # noqa: E402

pytestmark = pytest.mark.usefixtures("private_domain")


class Listener(Peer):
    """A server with the given world and a late-coming listener, with the messages that it got."""

    def __init__(self, world: int) -> None:
        super().__init__()
        parameters = [Parameter("world", value=world)]
        self.server = MapServer(
            context=self.context, parameter_overrides=parameters, enable_rosout=False
        )
        self.executor.add_node(self.server)
        self.heard = {}
        for kind, topic in ((OccupancyGrid, "map"), (Path, "plan")):
            self.node.create_subscription(
                kind,
                topic,
                partial(self.heard.__setitem__, topic),
                qos_profile(LATCHED),
            )


@pytest.fixture
def peer():
    with closing(Listener(world=7)) as listener:
        yield listener


def test_a_late_listener_gets_map_and_path(peer):
    peer.wait(lambda: len(peer.heard) == 2)
    grid, plan = (peer.heard[topic] for topic in ("map", "plan"))
    world = open_dataset("barn300").load(7)
    served = decode.occupancy_map(serialize_message(grid))
    assert np.array_equal(served.data, world.occupancy_map().data)
    assert grid.header.frame_id == plan.header.frame_id == "map"
    path = decode.path(serialize_message(plan))
    assert np.array_equal(path, world.path_m())


def test_reload_serves_the_new_world_unless_it_is_wrong(peer):
    changes = [Parameter("world", value=8), Parameter("resolution_m", value=0.05)]
    assert all(result.successful for result in peer.server.set_parameters(changes))
    assert peer.call("map_server/reload").success
    expected = open_dataset("barn300").load(8).occupancy_map(0.05).data
    rows = len(expected)
    peer.wait(lambda: "map" in peer.heard and peer.heard["map"].info.height == rows)
    served = decode.occupancy_map(serialize_message(peer.heard["map"]))
    assert np.array_equal(served.data, expected)

    peer.server.set_parameters([Parameter("world", value=300)])
    answer = peer.call("map_server/reload")
    assert not answer.success
    assert answer.message == "barn300: no world 300; there are 300 worlds from 0 to 299"


def test_the_executable_fails_with_one_line():
    code, output = Process("-m", "barn_worlds.ros.map_server", world=1000).end()
    assert (code, output) == (
        2,
        "map_server: barn300: no world 1000; there are 300 worlds from 0 to 299\n",
    )
