"""Node that serves the map and the path of one world, latched, in the map frame.

Map (nav_msgs/OccupancyGrid) and plan (nav_msgs/Path) are those of the world that the
parameters name, the fields of `MapServerConfig`. ~/reload (std_srvs/Trigger) publishes
the world that they name now. If that fails, the old world stays, and the answer gives
the reason.
"""

import sys
from dataclasses import dataclass
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_srvs.srv import Trigger

from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import BarnError
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.messages.encode import PathEncoder, encode_map
from barn_worlds.messages.topics import FRAMES, MAP, WORLD_PATH
from barn_worlds.ros.parameters import (
    declare_parameters,
    read_parameters,
    refuse_invalid_changes,
    warn_about_unknown_parameters,
)
from barn_worlds.ros.starting import start_ros
from barn_worlds.ros.topics import create_publisher
from barn_worlds.worlds.world import World


@dataclass(frozen=True)
class MapServerConfig(Checked):
    """The world that is served, and how."""

    dataset: str = quantity(
        "barn300", "name of a shipped data set, or path of a folder or file with worlds"
    )
    world: int = quantity(0, "number of the world", "", 0, 999_999_999)
    resolution_m: float = quantity(
        0.0, "resolution of the map; 0: that of the world", "m", 0.0, 10.0
    )
    historical_map: bool = quantity(
        False, "place obstacles one cell too near, as the original map files do"
    )
    frame_id: str = quantity(FRAMES.map, "frame of the map and the path")


class MapServer(Node):
    """The node; raises BarnError if its parameters do not name a world."""

    def __init__(self, **options: Any):
        """Declare parameters, publish the world, offer ~/reload; BarnError if none."""
        super().__init__("map_server", **options)
        self._map_publisher = create_publisher(self, MAP)
        self._path_publisher = create_publisher(self, WORLD_PATH)
        self._config = declare_parameters(self, MapServerConfig())
        refuse_invalid_changes(self, self._config)
        warn_about_unknown_parameters(self)
        self.publish()
        self.create_service(Trigger, "~/reload", self._reload)

    def publish(self) -> World:
        """Publish map and path of the parameters' world; return it, or BarnError."""
        config = read_parameters(self, self._config)
        world = open_dataset(config.dataset).load(config.world)
        occupancy = world.occupancy_map(
            config.resolution_m or None, historical=config.historical_map
        )
        stamp_ns = self.get_clock().now().nanoseconds
        self._map_publisher.publish(encode_map(occupancy, stamp_ns, config.frame_id))
        path = PathEncoder(config.frame_id).encode(world.path_m(), stamp_ns)
        self._path_publisher.publish(path)
        self.get_logger().info(
            f"serving world {config.world} of {config.dataset}: "
            f"{world.rows} x {world.cols} cells"
        )
        return world

    def _reload(
        self, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        """Answer ~/reload: publish the world, or log and return the error."""
        try:
            response.message = f"serving {self.publish().name}"
            response.success = True
        except BarnError as error:
            response.message = str(error)
            response.success = False
            self.get_logger().error(response.message)
        return response


def main(args: list[str] | None = None) -> int:
    """Run the node until stopped; return 0, or the code of a BarnError, printed."""
    try:
        start_ros(args)
        rclpy.spin(MapServer())
    except BarnError as error:
        print(f"map_server: {error}", file=sys.stderr)
        return error.exit_code
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
