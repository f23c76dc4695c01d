"""Where moving obstacles are over time, as CSV for other programs."""

import csv
import io
from pathlib import Path

import numpy as np

from barn_worlds.base.errors import WorldError
from barn_worlds.base.files import write_bytes
from barn_worlds.worlds.world import World

STEP_S, STEPS = 0.1, 1000
COLUMNS = ("time_s", "obstacle", "x_m", "y_m", "yaw_rad", "vx_mps", "vy_mps")


def write_tracks(world: World, path: Path) -> None:
    """Write a row per time and moving obstacle of the first 100 s; WorldError where nothing moves."""
    if not world.moving:
        raise WorldError(f"{world.name}: nothing moves in it, so there are no tracks")
    times_s, tracks, text = STEP_S * np.arange(STEPS + 1.0), world.tracks, io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    positions_m, velocities_mps = (part.tolist() for part in tracks.over(times_s))
    for time_s, positions, velocities in zip(times_s.tolist(), positions_m, velocities_mps, strict=True):
        for name, yaw, at, speed in zip(tracks.names, tracks.yaw_rad.tolist(), positions, velocities, strict=True):
            table.writerow([f"{time_s:.9g}", name, *(f"{number:.6f}" for number in (*at, yaw, *speed))])
    write_bytes(path, text.getvalue().encode())
