"""Write replays of trials to files: a page, a picture, an animation or a film."""

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
from barn_eval.pages.replay.page import outcome_at, planner_of, replay_page
from barn_eval.pages.template import write_page
from barn_eval.results.bags.decode import read_specification
from barn_eval.results.bags.recorded import RecordedTrial, read_recorded_trial
from barn_eval.results.bags.sources import NO_SOURCES, Sources
from barn_sim.config import LidarConfig
from barn_sim.drawing.camera import CAMERAS, SIZES, Pixels, Studio, camera_at
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import ConfigError, convert_os_errors, format_error
from barn_worlds.base.files import replace_file
from barn_worlds.base.types import Pose2D
from barn_worlds.drawing.files import gif_bytes
from barn_worlds.drawing.palette import PAGE_INK, WHITE

ENDINGS = (".html", ".png", ".gif", ".mp4")
_MAX_BAGS = 6
_MAX_FRAMES = 3000
_GIF_COLORS = 64
# Maximum coverage keeps the color of the goal, which has few pixels.
_GIF_METHOD = Image.Quantize.MAXCOVERAGE
# The camera follows the mean of the robot's poses over this time, so it does not shake.
_CAMERA_WINDOW_S = 1.2


def write_replay(
    bags: Sequence[Path],
    outs: Sequence[str | Path] = (),
    *,
    frames_per_s: float = 10.0,
    speed: float = 2.0,
    camera: str = CAMERAS[1],
    sources: Sources = NO_SOURCES,
    note: Callable[[str], None] = lambda _: None,
    progress: Progress = lambda _: None,
) -> list[Path]:
    """Draw bags side by side into files by ending, by default a page; return paths.

    Args:
        bags: Bags of 1 to 6 trials, which are shown beside each other.
        outs: Files, at most one for each of `ENDINGS`. By default a page named after
            the bags.
        frames_per_s: Frames per second of an animation or film.
        speed: Speed of an animation or film; 1 is real time.
        camera: Camera of picture, animation and film: "chase", "top" or "side".
        sources: Which topics of the bags stand for the suite's.
        note: Receives a line for each thing that is wrong with a bag.
        progress: Receives the share of the frames that is drawn, from 0 to 1.

    Returns:
        The files.

    Raises:
        BagError: A bag cannot be read.
        ConfigError: There are too many bags or frames, or something cannot be drawn or
            written.
    """
    # Refuse bad names before anything is read.
    sort_by_ending(outs)
    if not 1 <= len(bags) <= _MAX_BAGS:
        raise ConfigError(f"a replay shows 1 to {_MAX_BAGS} bags, got {len(bags)}")
    trials = [read_recorded_trial(path, sources) for path in bags]
    for trial in trials:
        prefix = f"{trial.name}: " if len(trials) > 1 else ""
        for text in trial.notes:
            note(f"note: {prefix}{text}")
    name = "_and_".join(trial.name.removesuffix(".mcap") for trial in trials[:2])
    files = sort_by_ending(outs or [f"{name}.html"])
    end_s = max(float(trial.times_s[-1]) for trial in trials)

    def draw_frames(
        times_s: Sequence[float], oversampling: int = 1
    ) -> Iterator[Pixels]:
        """Yield RGB frames of all trials side by side; report the share drawn."""
        # Generators: thousands of frames would not fit into memory.
        views = [draw_views(trial, camera, times_s, oversampling) for trial in trials]
        for number, pictures in enumerate(zip(*views, strict=True), 1):
            progress(number / len(times_s))
            yield np.hstack(pictures)

    for ending, path in files.items():
        if ending == ".html":
            write_page(path, replay_page(*trials))
        elif ending == ".png":
            content = io.BytesIO()
            # For a single picture there is time to draw smooth edges.
            frame = next(draw_frames([end_s], oversampling=2))
            Image.fromarray(frame).save(content, "PNG")
            write_page(path, content.getvalue())
        else:
            times_s = _frame_times(end_s, frames_per_s, speed, trials[0].name)
            frames = draw_frames(times_s)
            if ending == ".gif":
                # Dithered pixels change between frames, so files would be far larger.
                images = (
                    Image.fromarray(frame).quantize(
                        _GIF_COLORS, _GIF_METHOD, dither=Image.Dither.NONE
                    )
                    for frame in frames
                )
                write_page(path, gif_bytes(images, frames_per_s))
            else:
                _write_film(frames, path, frames_per_s)
    return list(files.values())


def sort_by_ending(outs: Sequence[str | Path]) -> dict[str, Path]:
    """Return paths by ending; ConfigError for an unknown ending or two of one."""
    files: dict[str, Path] = {}
    for path in map(Path, outs):
        if path.suffix not in ENDINGS:
            raise ConfigError(f"out {str(path)!r}: must end in {', '.join(ENDINGS)}")
        if files.setdefault(path.suffix, path) != path:
            raise ConfigError(
                f"out {str(path)!r}: only one file of each kind can be written"
            )
    return {ending: files[ending] for ending in ENDINGS if ending in files}


def _frame_times(
    end_s: float, frames_per_s: float, speed: float, name: str
) -> list[float]:
    """Return the trial time of each frame, 0 to `end_s` [s]; ConfigError above 3000."""
    count = int(np.ceil(end_s / speed * frames_per_s)) + 1
    if count > _MAX_FRAMES:
        raise ConfigError(
            f"{name}: {count} frames are too many, must be at most {_MAX_FRAMES}; raise --speed"
        )
    # The last frame is of the end, where the outcome shows.
    return [min(end_s, number * speed / frames_per_s) for number in range(count)]


def _write_film(frames: Iterator[Pixels], path: Path, frames_per_s: float) -> None:
    """Write RGB frames as an MP4 file; ConfigError if ffmpeg is missing or fails."""
    ffmpeg = shutil.which("ffmpeg")
    if ffmpeg is None:
        raise ConfigError(
            "a video needs ffmpeg, which is not installed (apt install ffmpeg); .gif and .html do not"
        )
    with convert_os_errors(ConfigError, f"{path}: cannot be written"):
        path.parent.mkdir(parents=True, exist_ok=True)
        with replace_file(path) as partial:
            complaint = _encode_film(ffmpeg, frames, frames_per_s, partial)
            # Within the block, so that a film that failed does not replace the file.
            if complaint is not None:
                raise ConfigError(f"{path}: ffmpeg failed: {format_error(complaint)}")


def _encode_film(
    ffmpeg: str, frames: Iterator[Pixels], frames_per_s: float, path: Path
) -> str | None:
    """Write RGB frames as MP4 with ffmpeg; return its error message, None on success."""
    first = next(frames)
    height, width, _ = first.shape
    # The path is the last word, so it can be no option.
    # Many players decode no pixel format but yuv420p, and with faststart a browser
    # shows the film before it has loaded all of it.
    command = (
        f"-loglevel error -f rawvideo -pix_fmt rgb24 -s {width}x{height} "
        f"-r {frames_per_s:g} -i - "
        "-c:v libx264 -pix_fmt yuv420p -movflags +faststart -f mp4 -y"
    ).split()
    with subprocess.Popen(  # noqa: S603 (no shell; only the path is from outside)
        [ffmpeg, *command, str(path)], stdin=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdin is not None
        # A complaint follows if ffmpeg ends early.
        with suppress(BrokenPipeError):
            process.stdin.write(first.tobytes())
            for frame in frames:
                process.stdin.write(frame.tobytes())
        _, complaint = process.communicate()
    return complaint.decode(errors="replace") if process.returncode else None


def draw_views(
    recorded: RecordedTrial, camera: str, times_s: Sequence[float], oversampling: int
) -> Iterator[Pixels]:
    """Yield RGB frames of a camera at trial times [s]; ConfigError without a world.

    With oversampling, frames are drawn that many times as large, for smooth edges.
    """
    scene = recorded.scene
    if scene is None:
        raise ConfigError(
            f"{recorded.name}: its world is unknown, so a camera cannot draw it; write .html instead"
        )
    lidar = replace(LidarConfig(), mount_x_m=recorded.lidar.x)
    height = read_specification(recorded.trial, "lidar", "mount_z_m")
    if height:
        lidar = replace(lidar, mount_y_m=recorded.lidar.y, mount_z_m=height[0])
    moving = recorded.moving
    bodies = None
    if moving is not None:
        scene = scene._replace(boxes=moving.walls)
        bodies = moving.bodies

    camera_poses = _smooth_poses(recorded)
    with Studio(
        scene,
        lidar,
        trail_m=recorded.poses[:, :2],
        moving=bodies,
        chassis=recorded.chassis,
    ) as studio:
        for time_s in times_s:
            index = recorded.index_at(time_s)
            center = Pose2D(*camera_poses[index].tolist())
            view = camera_at(camera, center, studio.bounds_m)
            pose = recorded.pose(index)
            options: dict[str, Any] = {"driven": index, "finer": oversampling}
            if moving is not None:
                now_s = float(recorded.times_s[index])
                options["places"] = moving.at(np.array([now_s]))[0]
                trails = [np.empty((0, 2)), *moving.trails(now_s)]
                options["passed"] = np.vstack(trails)
            pixels = studio.picture(pose, view, SIZES[camera], **options)
            yield _add_caption(pixels, recorded, time_s)


def _smooth_poses(recorded: RecordedTrial) -> Floats:
    """Return running means of x, y, yaw over 1.2 s (n, 3); yaw is without jumps."""
    # A mean over the jump from pi to -pi would turn the camera around.
    poses = np.column_stack([recorded.poses[:, :2], np.unwrap(recorded.poses[:, 2])])
    period_s = _CAMERA_WINDOW_S
    if len(poses) > 1:
        period_s = float(np.median(np.diff(recorded.times_s)))
    # An odd number, so that each mean is about its own pose.
    window = 2 * round(0.5 * _CAMERA_WINDOW_S / max(period_s, 1e-3)) + 1
    return np.asarray(uniform_filter1d(poses, window, axis=0, mode="nearest"))


def _add_caption(pixels: Pixels, recorded: RecordedTrial, time_s: float) -> Pixels:
    """Return a frame with planner, time [s] and outcome in its lower left corner."""
    name = spelling(planner_of(recorded)) or recorded.name
    outcome = outcome_at(recorded, time_s)
    text = f"{name[:40]}   {time_s:5.1f} s   {outcome}".rstrip()
    picture = Image.fromarray(pixels)
    font = ImageFont.load_default(16)
    draw = ImageDraw.Draw(picture)
    position = (12, picture.height - 26)
    left, top, right, bottom = draw.textbbox(position, text, font=font)
    draw.rounded_rectangle((left - 6, top - 5, right + 6, bottom + 5), 4, fill=WHITE)
    draw.text(position, text, fill=PAGE_INK, font=font)
    return np.asarray(picture)
