"""Reports, replays and rankings as pages and pictures."""

from collections.abc import Callable

# What commands offer, here so that they need not load what it is for.
LOOPBACK, PAGE_PORT, LIVE_PORT = "127.0.0.1", 8350, 8765  # the last is Foxglove's own

Progress = Callable[
    [float], None
]  # gets the share of some work that is done, as it grows
