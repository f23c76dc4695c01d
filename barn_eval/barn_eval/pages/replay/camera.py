"""A recorded trial in three dimensions, as a camera sees it."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from barn_eval.analysis.planners import spelling
from barn_eval.bags.decode import specified
from barn_eval.bags.recorded import Recorded
from barn_eval.pages.replay.facts import outcome_by, planner_of
from barn_sim.config import LidarConfig
from barn_sim.drawing.camera import SIZES, Pixels, Studio, camera_at
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.types import Pose2D
from barn_worlds.drawing.palette import PAGE, WHITE

_STEADY_S = 1.2  # over which the camera's own pose is the mean of the robot's


def camera_frames(found: Sequence[Recorded], camera: str, times_s: Sequence[float], finer: int) -> Iterator[Pixels]:
    """Yield a trial as a camera sees it at times.

    camera: "chase", "top" or "side". finer: how many times as large frames are drawn, for smooth edges. ConfigError for
    several trials, and where the world is not known.
    """
    if len(found) != 1:
        raise ConfigError(f"--camera shows one bag, got {len(found)}")
    (recorded,) = found
    scene = recorded.scene
    if scene is None:
        raise ConfigError(f"{recorded.name}: its world is not known, so --camera has nothing to look at")
    steady = _steadied(recorded)
    lidar = replace(LidarConfig(), mount_x_m=recorded.lidar.x)
    if height := specified(recorded.trial, "lidar", "mount_z_m"):
        lidar = replace(lidar, mount_y_m=recorded.lidar.y, mount_z_m=height[0])
    moving = recorded.moving
    trail_m, bodies = recorded.poses[:, :2], None
    if moving is not None:
        scene, bodies = scene._replace(boxes=moving.walls), moving.bodies
    with Studio(scene, lidar, trail_m=trail_m, moving=bodies, chassis=recorded.chassis) as studio:
        for time_s in times_s:
            index = recorded.index_at(time_s)
            view = camera_at(camera, Pose2D(*steady[index].tolist()), studio.bounds_m)
            pose = Pose2D(*recorded.poses[index].tolist())
            shown: dict[str, Any] = {"driven": index, "finer": finer}
            if moving is not None:
                now_s = float(recorded.times_s[index])
                shown |= {"places": moving.placed(now_s).poses[:, :2], "passed": np.concatenate(moving.trails(now_s))}
            pixels = studio.picture(pose, view, SIZES[camera], **shown)
            yield _captioned(pixels, recorded, time_s)


def _steadied(recorded: Recorded) -> Floats:
    """Return poses (n, 3) that are means of the robot's over a while, yaw without jumps."""
    poses = np.column_stack([recorded.poses[:, :2], np.unwrap(recorded.poses[:, 2])])
    period_s = float(np.median(np.diff(recorded.times_s))) if len(poses) > 1 else _STEADY_S
    half = round(0.5 * _STEADY_S / max(period_s, 1e-3))
    padded = np.pad(poses, ((half, half), (0, 0)), "edge")
    sums = np.cumsum(np.vstack([np.zeros(3), padded]), axis=0)
    means: Floats = (sums[2 * half + 1 :] - sums[: -2 * half - 1]) / (2 * half + 1)
    return means


def _captioned(pixels: Pixels, recorded: Recorded, time_s: float) -> Pixels:
    """Write below on the left whose trial it is, and the time."""
    picture = Image.fromarray(pixels)
    named = spelling(planner_of(recorded)) or recorded.name
    text = f"{named[:40]}   {time_s:5.1f} s   {outcome_by(recorded, time_s)}"
    draw, place = ImageDraw.Draw(picture), (12, picture.height - 26)
    left, above, right, below = draw.textbbox(place, text.rstrip(), font=_font())
    draw.rounded_rectangle((left - 6, above - 5, right + 6, below + 5), 4, fill=WHITE)
    draw.text(place, text.rstrip(), fill=PAGE["ink"][0], font=_font())
    return np.asarray(picture)


@cache
def _font() -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(16)
