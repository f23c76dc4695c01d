"""Frames into files: GIF, and film by ffmpeg."""

import io
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from PIL import Image

from barn_eval.pages import Share
from barn_eval.pages.template import write_page
from barn_worlds.base.errors import ConfigError, one_line
from barn_worlds.base.files import replacing

MOST_FRAMES = 3000
_KEEPS_RARE = Image.Quantize.MAXCOVERAGE  # the goal's colour has few pixels
Frames = Iterator[tuple[tuple[int, int], bytes]]  # width and height in pixels, and the pixels, three bytes each


def frame_times(end_s: float, frames_per_s: float, speed: float, name: str) -> list[float]:
    """Return the times of frames from the first to the last instant; ConfigError if they would be too many."""
    count = int(np.ceil(end_s / speed * frames_per_s)) + 1
    if count > MOST_FRAMES:
        raise ConfigError(f"{name}: {count} frames are too many, at most {MOST_FRAMES}; raise --speed")
    return [min(end_s, index * speed / frames_per_s) for index in range(count)]


def counted(times: Sequence[float], share: Share) -> Iterator[float]:
    """Yield the times of frames, and tell of each once it has been drawn."""
    for number, time_s in enumerate(times, 1):
        yield time_s
        share(number / len(times))


def save_gif(found: Frames, path: Path, frames_per_s: float, colours: int = 64) -> None:
    """Write frames as an animation that plays for ever."""
    frames = (
        Image.frombytes("RGB", size, data).quantize(colours, _KEEPS_RARE, dither=Image.Dither.NONE)
        for size, data in found
    )
    content = io.BytesIO()
    period_ms = max(20, 10 * round(100.0 / frames_per_s))  # a GIF counts in hundredths of a second
    next(frames).save(content, "GIF", save_all=True, append_images=frames, duration=period_ms, loop=0, optimize=False)
    write_page(path, content.getvalue())


def save_mp4(frames: Frames, path: Path, frames_per_s: float) -> None:
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


def _encode(ffmpeg: str, frames: Frames, frames_per_s: float, path: Path) -> str | None:
    """Write frames as a film and return what ffmpeg complains of if it fails."""
    size, first = next(frames)
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}", "-r", f"{frames_per_s:g}", "-i", "-"]
    target = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-movflags", "+faststart", "-f", "mp4", "-y", str(path)]
    with subprocess.Popen(  # noqa: S603 (no shell; the only text from outside is the path)
        [ffmpeg, "-loglevel", "error", *source, *target], stdin=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdin is not None
        with suppress(BrokenPipeError):  # its complaint follows
            process.stdin.write(first)
            for _, data in frames:
                process.stdin.write(data)
        _, complaint = process.communicate()
    return complaint.decode(errors="replace") if process.returncode else None
