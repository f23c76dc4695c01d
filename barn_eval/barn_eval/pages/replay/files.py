"""The replay of a trial, or of several on one clock, in files: a page, a picture, an animation, a film."""

import io
import shutil
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.ndimage import uniform_filter1d

from barn_eval.analysis.planners import spelling
from barn_eval.pages import Progress
from barn_eval.pages.replay.page import outcome_by, planner_of, replay_page
from barn_eval.pages.template import write_page
from barn_eval.results.bags.decode import read_specification
from barn_eval.results.bags.recorded import RecordedTrial, read_recorded_trial
from barn_sim.config import LidarConfig
from barn_sim.drawing.camera import CAMERAS, SIZES, Pixels, Studio, camera_at
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import ConfigError, format_error
from barn_worlds.base.files import replace_file
from barn_worlds.base.types import Pose2D
from barn_worlds.drawing.files import gif_bytes
from barn_worlds.drawing.palette import PAGE, WHITE

ENDINGS = (".html", ".png", ".gif", ".mp4")
MOST_BAGS = 6
MOST_FRAMES = 3000
_KEEPS_RARE = Image.Quantize.MAXCOVERAGE  # the goal's colour has few pixels


def write_replay(
    bags: Sequence[Path],
    outs: Sequence[str | Path] = (),
    *,
    frames_per_s: float = 10.0,
    speed: float = 2.0,
    camera: str = CAMERAS[1],
    note: Callable[[str], None] = lambda _: None,
    progress: Progress = lambda _: None,
) -> list[Path]:
    """Write the trials of bags to files and return these; without any, to a page named after the first bag.

    outs: one of each kind of `ENDINGS`. frames_per_s, speed, camera: of picture, animation and film, as `barn.replay`
    has them. note: gets a line for each thing that is amiss with a bag. progress: gets the share of the frames that is
    drawn. BagError for a bag that cannot be read, ConfigError for too many bags or frames, and for what cannot be drawn
    or written.
    """
    by_ending(outs)  # before anything is read
    if not 1 <= len(bags) <= MOST_BAGS:
        raise ConfigError(f"a replay shows 1 to {MOST_BAGS} bags, got {len(bags)}")
    found = [read_recorded_trial(path) for path in bags]
    for line in (
        f"{one.name}: " * (len(found) > 1) + line for one in found for line in one.notes
    ):
        note(f"note: {line}")
    named = "_and_".join(one.name.removesuffix(".mcap") for one in found[:2])
    files = by_ending(outs or [f"{named}.html"])
    end_s = max(float(recorded.times_s[-1]) for recorded in found)

    def frames(times_s: Sequence[float], finer: int = 1) -> Iterator[Pixels]:
        views = (camera_frames(recorded, camera, times_s, finer) for recorded in found)
        for number, beside in enumerate(zip(*views, strict=True), 1):
            progress(number / len(times_s))
            yield np.hstack(beside)

    for ending, path in files.items():
        times_s = (
            _frame_times(end_s, frames_per_s, speed, found[0].name)
            if ending in (".gif", ".mp4")
            else []
        )
        if ending == ".html":
            write_page(path, replay_page(*found))
        elif ending == ".png":
            content = io.BytesIO()
            Image.fromarray(next(frames([end_s], 2))).save(content, "PNG")
            write_page(path, content.getvalue())
        elif ending == ".gif":
            drawn = map(Image.fromarray, frames(times_s))
            images = (
                image.quantize(64, _KEEPS_RARE, dither=Image.Dither.NONE)
                for image in drawn
            )
            write_page(path, gif_bytes(images, frames_per_s))
        else:
            _save_mp4(frames(times_s), path, frames_per_s)
    return list(files.values())


def by_ending(outs: Sequence[str | Path]) -> dict[str, Path]:
    """Return files of replays by their endings; ConfigError for an unknown one, or for two of a kind."""
    found: dict[str, Path] = {}
    for path in map(Path, outs):
        if path.suffix not in ENDINGS:
            raise ConfigError(f"out {str(path)!r}: must end in {', '.join(ENDINGS)}")
        if found.setdefault(path.suffix, path) != path:
            raise ConfigError(f"out {str(path)!r}: one file of each kind is written")
    return {ending: found[ending] for ending in ENDINGS if ending in found}


def _frame_times(
    end_s: float, frames_per_s: float, speed: float, name: str
) -> list[float]:
    """Return the times of frames from the first to the last instant; ConfigError if they would be too many."""
    count = int(np.ceil(end_s / speed * frames_per_s)) + 1
    if count > MOST_FRAMES:
        raise ConfigError(
            f"{name}: {count} frames are too many, at most {MOST_FRAMES}; raise --speed"
        )
    return [min(end_s, index * speed / frames_per_s) for index in range(count)]


def _save_mp4(frames: Iterator[Pixels], path: Path, frames_per_s: float) -> None:
    """Write frames as a film; ConfigError where ffmpeg is missing or fails."""
    ffmpeg = shutil.which("ffmpeg")
    if ffmpeg is None:
        raise ConfigError(
            "a film needs ffmpeg, which is not installed (apt install ffmpeg); .gif and .html do not"
        )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replace_file(path) as partial:
            complaint = _encode(ffmpeg, frames, frames_per_s, partial)
            if complaint is not None:
                raise ConfigError(f"{path}: ffmpeg failed: {format_error(complaint)}")
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be written: {error.strerror or error}"
        ) from None


def _encode(
    ffmpeg: str, frames: Iterator[Pixels], frames_per_s: float, path: Path
) -> str | None:
    """Write frames as a film and return what ffmpeg complains of if it fails."""
    first = next(frames)
    height, width, _ = first.shape
    source = [
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "-s",
        f"{width}x{height}",
        "-r",
        f"{frames_per_s:g}",
        "-i",
        "-",
    ]
    target = [
        "-c:v",
        "libx264",
        "-pix_fmt",
        "yuv420p",
        "-movflags",
        "+faststart",
        "-f",
        "mp4",
        "-y",
        str(path),
    ]
    with subprocess.Popen(  # noqa: S603 (no shell; the only text from outside is the path)
        [ffmpeg, "-loglevel", "error", *source, *target],
        stdin=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        assert process.stdin is not None
        with suppress(BrokenPipeError):  # its complaint follows
            process.stdin.write(first.tobytes())
            for frame in frames:
                process.stdin.write(frame.tobytes())
        _, complaint = process.communicate()
    return complaint.decode(errors="replace") if process.returncode else None


_STEADY_S = 1.2  # over which the camera's own pose is the mean of the robot's


def camera_frames(
    recorded: RecordedTrial, camera: str, times_s: Sequence[float], finer: int
) -> Iterator[Pixels]:
    """Yield a trial as a camera sees it at times.

    camera: "chase", "top" or "side". finer: how many times as large frames are drawn, for smooth edges. ConfigError
    where the world is not known.
    """
    scene = recorded.scene
    if scene is None:
        raise ConfigError(
            f"{recorded.name}: its world is not known, so a camera has nothing to see; .html shows it"
        )
    steady = _steadied(recorded)
    lidar = replace(LidarConfig(), mount_x_m=recorded.lidar.x)
    if height := read_specification(recorded.trial, "lidar", "mount_z_m"):
        lidar = replace(lidar, mount_y_m=recorded.lidar.y, mount_z_m=height[0])
    moving = recorded.moving
    trail_m, bodies = recorded.poses[:, :2], None
    if moving is not None:
        scene, bodies = scene._replace(boxes=moving.walls), moving.bodies
    with Studio(
        scene, lidar, trail_m=trail_m, moving=bodies, chassis=recorded.chassis
    ) as studio:
        for time_s in times_s:
            index = recorded.index_at(time_s)
            view = camera_at(camera, Pose2D(*steady[index].tolist()), studio.bounds_m)
            pose = Pose2D(*recorded.poses[index].tolist())
            shown: dict[str, Any] = {"driven": index, "finer": finer}
            if moving is not None:
                now_s = float(recorded.times_s[index])
                shown |= {
                    "places": moving.bodies_at(now_s).poses[:, :2],
                    "passed": np.vstack([np.empty((0, 2)), *moving.trails(now_s)]),
                }
            pixels = studio.picture(pose, view, SIZES[camera], **shown)
            yield _captioned(pixels, recorded, time_s)


def _steadied(recorded: RecordedTrial) -> Floats:
    """Return poses (n, 3) that are means of the robot's over a while, yaw without jumps."""
    poses = np.column_stack([recorded.poses[:, :2], np.unwrap(recorded.poses[:, 2])])
    period_s = (
        float(np.median(np.diff(recorded.times_s))) if len(poses) > 1 else _STEADY_S
    )
    size = 2 * round(0.5 * _STEADY_S / max(period_s, 1e-3)) + 1
    return np.asarray(uniform_filter1d(poses, size, axis=0, mode="nearest"))


def _captioned(pixels: Pixels, recorded: RecordedTrial, time_s: float) -> Pixels:
    """Write below on the left whose trial it is, and the time."""
    picture, font = Image.fromarray(pixels), ImageFont.load_default(16)
    named = spelling(planner_of(recorded)) or recorded.name
    text = f"{named[:40]}   {time_s:5.1f} s   {outcome_by(recorded, time_s)}".rstrip()
    draw, place = ImageDraw.Draw(picture), (12, picture.height - 26)
    left, above, right, below = draw.textbbox(place, text, font=font)
    draw.rounded_rectangle((left - 6, above - 5, right + 6, below + 5), 4, fill=WHITE)
    draw.text(place, text, fill=PAGE["ink"][0], font=font)
    return np.asarray(picture)
