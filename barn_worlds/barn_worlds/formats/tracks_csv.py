"""Where moving obstacles are over time, as CSV for other programs."""

import csv
import io
import math
from pathlib import Path

import numpy as np

from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import WorldError
from barn_worlds.base.files import write_bytes
from barn_worlds.worlds.world import World

COLUMNS = ("time_s", "obstacle", "x_m", "y_m", "yaw_rad", "vx_mps", "vy_mps")
MOST_ROWS = 5_000_000


def write_tracks(world: World, path: Path, step_s: float = 0.1, duration_s: float = 100.0) -> None:
    """Write a row per time and moving obstacle, from 0 s to the duration; WorldError where nothing moves."""
    if not world.moving:
        raise WorldError(f"{world.name}: nothing moves in it, so there are no tracks")
    if not (math.isfinite(step_s) and math.isfinite(duration_s) and step_s > 0.0 and duration_s >= 0.0):
        raise WorldError(f"step and duration of tracks must be above 0 and finite, got {step_s:g} and {duration_s:g} s")
    rows = (duration_s / step_s + 1.0) * len(world.moving)
    if rows > MOST_ROWS:
        raise WorldError(f"{world.name}: tracks of {rows:.0f} rows are too long, at most {MOST_ROWS}; use longer steps")
    times_s: Floats = step_s * np.arange(math.floor(duration_s / step_s + 1e-9) + 1, dtype=np.float64)
    tracks, text = world.tracks, io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    positions_m, velocities_mps = (part.tolist() for part in tracks.over(times_s))
    for time_s, positions, velocities in zip(times_s.tolist(), positions_m, velocities_mps, strict=True):
        for name, yaw, at, speed in zip(tracks.names, tracks.yaw_rad.tolist(), positions, velocities, strict=True):
            table.writerow([f"{time_s:.9g}", name, *(f"{number:.6f}" for number in (*at, yaw, *speed))])
    write_bytes(path, text.getvalue().encode())
