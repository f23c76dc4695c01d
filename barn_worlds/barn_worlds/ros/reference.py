"""The generated parts of README.md and config: the map server's parameters."""

from barn_worlds.reference import Reference, parameter_file, parameter_table
from barn_worlds.ros.map_server import MapServerConfig


def reference() -> Reference:
    """Return the table and the parameter file."""
    defaults = MapServerConfig()
    return Reference(
        {"parameters": parameter_table({"default": defaults})},
        {"map_server.yaml": parameter_file("/**/map_server", "The map server with its defaults.", [defaults])},
    )
