"""Write reports, replays and rankings as pages and pictures."""

from collections.abc import Callable

# Commands offer these, so they are where loading them costs nothing.
LOOPBACK = "127.0.0.1"
PAGE_PORT = 8350
LIVE_PORT = 8765  # Foxglove's default

# Receives the share of some work that is done, from 0 to 1.
Progress = Callable[[float], None]
