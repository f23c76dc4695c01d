"""Markers to be put into a visualization_msgs/MarkerArray."""

from barn_worlds.messages.cdr import Message, make
from barn_worlds.messages.encode import header

# Constants of visualization_msgs/Marker: types and actions.
CUBE, SPHERE, CYLINDER, LINE_STRIP, LINE_LIST, TEXT_VIEW_FACING = 1, 2, 3, 4, 5, 9
ADD, DELETE_ALL = 0, 3


def marker(
    frame: str,
    namespace: str,
    kind: int = 0,
    *,
    index: int = 0,
    action: int = ADD,
    colour: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
    stamp_ns: int = 0,
) -> Message:
    """Return visualization_msgs/Marker as an object; colour: red, green, blue, opacity."""
    made = make(
        "visualization_msgs/msg/Marker",
        header=header(frame, stamp_ns),
        ns=namespace,
        id=index,
        type=kind,
        action=action,
        color=make("std_msgs/msg/ColorRGBA", **dict(zip("rgba", colour, strict=True))),
    )
    made.pose.orientation.w = 1.0
    return made
