"""The map server as a node among others: what it serves, how it reloads, and how it fails."""

import subprocess
import sys
import time

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from nav_msgs.msg import OccupancyGrid, Path  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from barn_worlds.messages import decode  # noqa: E402
from barn_worlds.messages.topics import LATCHED  # noqa: E402
from barn_worlds.ros.map_server import MapServer  # noqa: E402
from barn_worlds.ros.topics import profile  # noqa: E402
from barn_worlds.worlds.dataset import open_dataset  # noqa: E402

pytestmark = pytest.mark.usefixtures("own_domain")


@pytest.fixture
def graph():
    """A context, an executor, and a late-coming listener with the messages it got."""
    context = rclpy.Context()
    rclpy.init(context=context)
    executor = SingleThreadedExecutor(context=context)
    yield context, executor
    executor.shutdown()
    rclpy.shutdown(context=context)


def serve(context, **overrides):
    values = [Parameter(name, value=value) for name, value in overrides.items()]
    return MapServer(context=context, parameter_overrides=values, enable_rosout=False)


def listen(context):
    node, heard = Node("listener", context=context, enable_rosout=False), {}
    node.create_subscription(OccupancyGrid, "map", lambda message: heard.update(map=message), profile(LATCHED))
    node.create_subscription(Path, "plan", lambda message: heard.update(plan=message), profile(LATCHED))
    return node, heard


def spin_until(executor, done, limit_s=600.0):
    deadline = time.monotonic() + limit_s
    while not done():
        assert time.monotonic() < deadline
        executor.spin_once(timeout_sec=0.05)


def test_a_late_listener_gets_map_and_path(graph):
    context, executor = graph
    executor.add_node(serve(context, world=7))
    node, heard = listen(context)
    executor.add_node(node)
    spin_until(executor, lambda: len(heard) == 2)
    world = open_dataset("barn300").load(7)
    served = decode.occupancy_map(serialize_message(heard["map"]))
    assert np.array_equal(served.data, world.occupancy_map().data)
    assert heard["map"].header.frame_id == heard["plan"].header.frame_id == "map"
    places = [(pose.pose.position.x, pose.pose.position.y) for pose in heard["plan"].poses]
    assert np.array_equal(places, world.path_m())


def test_reload_serves_the_new_world_and_keeps_the_old_one_on_a_mistake(graph):
    context, executor = graph
    server = serve(context, world=7)
    executor.add_node(server)
    node, heard = listen(context)
    executor.add_node(node)
    client = node.create_client(Trigger, "map_server/reload")
    spin_until(executor, client.service_is_ready)

    def reload():
        future = client.call_async(Trigger.Request())
        spin_until(executor, future.done)
        return future.result()

    assert server.set_parameters([Parameter("world", value=8), Parameter("resolution_m", value=0.05)])[0].successful
    assert reload().success
    expected = open_dataset("barn300").load(8).occupancy_map(0.05)
    spin_until(executor, lambda: "map" in heard and heard["map"].info.height == expected.data.shape[0])
    assert np.array_equal(decode.occupancy_map(serialize_message(heard["map"])).data, expected.data)

    server.set_parameters([Parameter("world", value=300)])
    answer = reload()
    assert not answer.success
    assert answer.message == "barn300: no world 300; there are 300 worlds from 0 to 299"


def test_the_executable_fails_with_one_line():
    command = [sys.executable, "-m", "barn_worlds.ros.map_server", "--ros-args", "-p", "world:=1000"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 1
    assert done.stderr.strip() == "map_server: barn300: no world 1000; there are 300 worlds from 0 to 299"
