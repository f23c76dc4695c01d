"""The replay of a trial, or of several on one clock, in files: a page, a picture, an animation, a film."""

import io
import shutil
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from PIL import Image

from barn_eval.bags.recorded import Recorded, read_recorded
from barn_eval.pages import Progress
from barn_eval.pages.replay.camera import camera_frames
from barn_eval.pages.replay.page import replay_page
from barn_eval.pages.template import write_page
from barn_sim.drawing.camera import CAMERAS, Pixels
from barn_worlds.base.errors import ConfigError, one_line
from barn_worlds.base.files import replacing
from barn_worlds.drawing.files import gif_bytes

MOST_BAGS = 6
MOST_FRAMES = 3000
_KEEPS_RARE = Image.Quantize.MAXCOVERAGE  # the goal's colour has few pixels


def write_replay(
    bags: Path | Sequence[Path],
    *,
    html: Path | None = None,
    png: Path | None = None,
    gif: Path | None = None,
    mp4: Path | None = None,
    frames_per_s: float = 10.0,
    speed: float = 2.0,
    camera: str = CAMERAS[1],
    note: Callable[[str], None] = lambda _: None,
    progress: Progress = lambda _: None,
) -> list[Path]:
    """Write the trials of bags to files and return these; without any, to a page named after the first bag.

    frames_per_s, speed, camera: of picture, animation and film, as `barn.replay` has them. note: gets a line for each
    thing that is amiss with a bag. progress: gets the share of the frames that is drawn. BagError for a bag that cannot
    be read, ConfigError for too many bags or frames, and for what cannot be drawn or written.
    """
    found = _read([bags] if isinstance(bags, Path) else bags, note)
    if not (html or png or gif or mp4):
        names = [recorded.name.removesuffix(".mcap") for recorded in found]
        html = Path(f"{'_and_'.join(names[:2])}.html")
    if html:
        write_page(html, replay_page(*found))
    end_s = max(float(recorded.times_s[-1]) for recorded in found)

    def frames(times_s: Sequence[float], finer: int = 1) -> Iterator[Pixels]:
        views = (camera_frames(recorded, camera, times_s, finer) for recorded in found)
        for number, beside in enumerate(zip(*views, strict=True), 1):
            progress(number / len(times_s))
            yield np.hstack(beside)

    if png:
        content = io.BytesIO()
        Image.fromarray(next(frames([end_s], 2))).save(content, "PNG")
        write_page(png, content.getvalue())
    times_s = _frame_times(end_s, frames_per_s, speed, found[0].name) if gif or mp4 else []
    if gif:
        images = (
            Image.fromarray(frame).quantize(64, _KEEPS_RARE, dither=Image.Dither.NONE) for frame in frames(times_s)
        )
        write_page(gif, gif_bytes(images, frames_per_s))
    if mp4:
        _save_mp4(frames(times_s), mp4, frames_per_s)
    return [path for path in (html, png, gif, mp4) if path]


def _read(paths: Sequence[Path], note: Callable[[str], None]) -> list[Recorded]:
    if not 1 <= len(paths) <= MOST_BAGS:
        raise ConfigError(f"a replay shows 1 to {MOST_BAGS} bags, got {len(paths)}")
    found = [read_recorded(path) for path in paths]
    for recorded in found:
        for line in recorded.notes:
            note(f"note: {line}" if len(found) == 1 else f"note: {recorded.name}: {line}")
    return found


def _frame_times(end_s: float, frames_per_s: float, speed: float, name: str) -> list[float]:
    """Return the times of frames from the first to the last instant; ConfigError if they would be too many."""
    count = int(np.ceil(end_s / speed * frames_per_s)) + 1
    if count > MOST_FRAMES:
        raise ConfigError(f"{name}: {count} frames are too many, at most {MOST_FRAMES}; raise --speed")
    return [min(end_s, index * speed / frames_per_s) for index in range(count)]


def _save_mp4(frames: Iterator[Pixels], path: Path, frames_per_s: float) -> None:
    """Write frames as a film; ConfigError where ffmpeg is missing or fails."""
    ffmpeg = shutil.which("ffmpeg")
    if ffmpeg is None:
        raise ConfigError(
            "a film needs ffmpeg, which is not installed (apt install ffmpeg); .gif and .html need nothing"
        )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as partial:
            complaint = _encode(ffmpeg, frames, frames_per_s, partial)
            if complaint is not None:
                raise ConfigError(f"{path}: ffmpeg failed: {one_line(complaint)}")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror or error}") from None


def _encode(ffmpeg: str, frames: Iterator[Pixels], frames_per_s: float, path: Path) -> str | None:
    """Write frames as a film and return what ffmpeg complains of if it fails."""
    first = next(frames)
    height, width, _ = first.shape
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{frames_per_s:g}", "-i", "-"]
    target = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-movflags", "+faststart", "-f", "mp4", "-y", str(path)]
    with subprocess.Popen(  # noqa: S603 (no shell; the only text from outside is the path)
        [ffmpeg, "-loglevel", "error", *source, *target], stdin=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdin is not None
        with suppress(BrokenPipeError):  # its complaint follows
            process.stdin.write(first.tobytes())
            for frame in frames:
                process.stdin.write(frame.tobytes())
        _, complaint = process.communicate()
    return complaint.decode(errors="replace") if process.returncode else None
