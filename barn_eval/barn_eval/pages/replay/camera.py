"""A recorded trial in three dimensions, as a camera sees it."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.ndimage import uniform_filter1d

from barn_eval.analysis.planners import spelling
from barn_eval.bags.decode import specified
from barn_eval.bags.recorded import Floats, Recorded
from barn_eval.pages.replay.page import outcome_by, planner_of
from barn_sim.config import LidarConfig
from barn_sim.drawing.camera import SIZES, Pixels, Studio, camera_at
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.types import Pose2D
from barn_worlds.drawing.palette import PAGE, WHITE

_STEADY_S = 1.2  # over which the camera's own pose is the mean of the robot's


def camera_frames(recorded: Recorded, camera: str, times_s: Sequence[float], finer: int) -> Iterator[Pixels]:
    """Yield a trial as a camera sees it at times.

    camera: "chase", "top" or "side". finer: how many times as large frames are drawn, for smooth edges. ConfigError
    where the world is not known.
    """
    scene = recorded.scene
    if scene is None:
        raise ConfigError(
            f"{recorded.name}: its world is not known, so a camera has nothing to look at; .html shows it"
        )
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
    size = 2 * round(0.5 * _STEADY_S / max(period_s, 1e-3)) + 1
    return np.asarray(uniform_filter1d(poses, size, axis=0, mode="nearest"))


def _captioned(pixels: Pixels, recorded: Recorded, time_s: float) -> Pixels:
    """Write below on the left whose trial it is, and the time."""
    picture, font = Image.fromarray(pixels), ImageFont.load_default(16)
    named = spelling(planner_of(recorded)) or recorded.name
    text = f"{named[:40]}   {time_s:5.1f} s   {outcome_by(recorded, time_s)}".rstrip()
    draw, place = ImageDraw.Draw(picture), (12, picture.height - 26)
    left, above, right, below = draw.textbbox(place, text, font=font)
    draw.rounded_rectangle((left - 6, above - 5, right + 6, below + 5), 4, fill=WHITE)
    draw.text(place, text, fill=PAGE["ink"][0], font=font)
    return np.asarray(picture)
