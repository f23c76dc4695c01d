"""The replay of a trial as a picture, GIF or film."""

import io
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from PIL import Image

from barn_eval.bags.recorded import Floats, Recorded, Shown
from barn_eval.pages.drawing import discs
from barn_eval.pages.page import write_page
from barn_eval.pages.replay_page import subtitle
from barn_eval.pages.replay_payload import bounds
from barn_worlds.errors import ConfigError, one_line
from barn_worlds.formats.files import replacing
from barn_worlds.types import OccupancyMap, Pose2D

MOST_FRAMES = 3000
_DOTS_PER_INCH = 100
_TRAIL, _SCAN, _PLAN, _LOCAL, _BAND = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9"
_CANDIDATES, _ROBOT, _MAP, _UNKNOWN = "#8a8f98", "#E69F00", "#33373d", "#c9ced6"


def write_png(recorded: Recorded, path: Path) -> None:
    """Write the end of the trial as a picture."""
    picture = _Picture(recorded)
    picture.show(float(recorded.times_s[-1]))
    content = io.BytesIO()
    picture.figure.savefig(content, dpi=_DOTS_PER_INCH, format="png", metadata={"Software": None})
    write_page(path, content.getvalue())


def write_gif(recorded: Recorded, path: Path, frames_per_s: float, speed: float) -> None:
    """Write the trial as an animation that plays for ever."""
    frames = (
        Image.frombytes("RGB", size, data).quantize(64, dither=Image.Dither.NONE)
        for size, data in _frames(recorded, frames_per_s, speed)
    )
    content = io.BytesIO()
    period_ms = max(20, 10 * round(100.0 / frames_per_s))  # a GIF counts in hundredths of a second
    next(frames).save(content, "GIF", save_all=True, append_images=frames, duration=period_ms, loop=0, optimize=False)
    write_page(path, content.getvalue())


def write_mp4(recorded: Recorded, path: Path, frames_per_s: float, speed: float) -> None:
    """Write the trial as a film; ConfigError where ffmpeg is missing or fails."""
    ffmpeg = shutil.which("ffmpeg")
    if ffmpeg is None:
        raise ConfigError(
            "--mp4 needs ffmpeg, which is not installed (apt install ffmpeg); --gif and --html need nothing"
        )
    frames = _frames(recorded, frames_per_s, speed)
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with replacing(path) as partial:
            complaint = _encode(ffmpeg, frames, frames_per_s, partial)
            if complaint is not None:
                raise ConfigError(f"{path}: ffmpeg failed: {one_line(complaint)}")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror or error}") from None


def _encode(ffmpeg: str, frames: Iterator[Any], frames_per_s: float, path: Path) -> str | None:
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


class _Picture:
    """A figure that shows the trial at any time."""

    def __init__(self, recorded: Recorded) -> None:
        self._recorded = recorded
        left, below, right, above = bounds(recorded)
        height = 8.0
        width = float(np.clip(height * (right - left) / (above - below) + 1.6, 5.6, 12.0))
        # The lines above it need 5.6 inches. Films want even numbers of pixels.
        self.figure = Figure(figsize=(round(width * 50) / 50, height), dpi=_DOTS_PER_INCH)
        self.canvas: Any = FigureCanvasAgg(self.figure)
        axes = self.figure.add_axes((0.9 / width, 0.075, 1.0 - 1.05 / width, 0.82))
        axes.set(xlim=(left, right), ylim=(below, above), xlabel="x [m]", ylabel="y [m]", aspect="equal")
        self._axes = axes
        self._title = self.figure.text(0.12 / width, 0.915, "", fontsize=9.5, va="bottom", parse_math=False)
        if recorded.map is not None:
            _draw_map(axes, recorded.map)
        self._draw_goal()
        self._candidates: Any = axes.add_collection(
            LineCollection([], colors=_CANDIDATES, linewidths=0.6, label="candidates" if recorded.candidates else "")
        )
        self._band: Any = axes.add_collection(
            LineCollection([], colors=_BAND, linewidths=1.2, label="band" if recorded.bands else "")
        )
        self._plans = {}
        for name, colour, style, label in (("plans", _PLAN, "--", "plan"), ("local_plans", _LOCAL, "-", "local plan")):
            shown = label if getattr(recorded, name) else ""
            (self._plans[name],) = axes.plot([], [], color=colour, linewidth=1.8, linestyle=style, label=shown)
        self._scan = axes.plot([], [], ".", color=_SCAN, markersize=2.2, label="scan" if recorded.scans else "")[0]
        self._trail = axes.plot([], [], color=_TRAIL, linewidth=2.0, label="trail")[0]
        self._robot: Any = axes.add_patch(
            Polygon(np.zeros((4, 2)), closed=True, facecolor=_ROBOT + "88", edgecolor="black", zorder=5)
        )
        self._bubbles: EllipseCollection | None = None
        axes.legend(loc="lower center", fontsize=8, ncols=2)

    def show(self, time_s: float) -> None:
        """Draw what there is at a time."""
        recorded = self._recorded
        index = recorded.index_at(time_s)
        pose = Pose2D(*recorded.poses[index].tolist())
        self._trail.set_data(*recorded.poses[: index + 1, :2].T)
        self._robot.set_xy(pose.transform(_corners(recorded.extent)))
        self._robot.set_linewidth(3.0 if recorded.contact[index] else 1.0)
        self._show_scan(_latest(recorded.scans, time_s), pose)
        for name, line in self._plans.items():
            shown = _latest(getattr(recorded, name), time_s)
            line.set_data(*(recorded.to_frame(shown).transform(shown.content).T if shown else ([], [])))
        shown = _latest(recorded.candidates, time_s)
        lines = [recorded.to_frame(shown).transform(line) for line in shown.content.lines] if shown else []
        self._candidates.set_segments(lines)
        self._show_band(_latest(recorded.bands, time_s))
        speed, turn = recorded.speeds[index].tolist()
        clock = f"{recorded.times_s[index]:6.2f} of {recorded.times_s[-1]:.2f} s   {speed:5.2f} m/s   {turn:5.2f} rad/s"
        self._title.set_text("\n".join([recorded.name, subtitle(recorded), _score(recorded, time_s) + clock]))

    def pixels(self) -> tuple[tuple[int, int], bytes]:
        """Return the size and the pixels, three bytes each."""
        self.canvas.draw()
        data = np.asarray(self.canvas.buffer_rgba())[:, :, :3]
        return (data.shape[1], data.shape[0]), data.tobytes()

    def _show_scan(self, shown: Shown | None, pose: Pose2D) -> None:
        if shown is None:
            return
        scan = shown.content
        seen = np.isfinite(scan.ranges) & (scan.ranges >= scan.range_min)
        angles, ranges = scan.angles()[seen], scan.ranges[seen].astype(np.float64)
        ends = np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles)])
        self._scan.set_data(*(pose @ self._recorded.lidar).transform(ends).T)

    def _show_band(self, shown: Shown | None) -> None:
        if self._bubbles is not None:
            self._bubbles.remove()
            self._bubbles = None
        if shown is None:
            self._band.set_segments([])
            return
        where = self._recorded.to_frame(shown)
        self._band.set_segments([where.transform(line) for line in shown.content.lines])
        found = shown.content.discs
        if len(found):
            centres_m = where.transform(found[:, :2])
            self._bubbles = discs(self._axes, centres_m, found[:, 2], facecolor="none", edgecolor=_BAND)

    def _draw_goal(self) -> None:
        goal = self._recorded.goal_pose()
        if goal is not None:
            self._axes.plot(goal.x, goal.y, marker="*", color=_PLAN, markersize=13, linestyle="", label="goal")


def _frames(recorded: Recorded, frames_per_s: float, speed: float) -> Iterator[tuple[tuple[int, int], bytes]]:
    """Yield frames from the first to the last instant; ConfigError if they would be too many."""
    end_s = float(recorded.times_s[-1])
    count = int(np.ceil(end_s / speed * frames_per_s)) + 1
    if count > MOST_FRAMES:
        raise ConfigError(f"{recorded.name}: {count} frames are too many, at most {MOST_FRAMES}; raise --speed")
    picture = _Picture(recorded)
    for index in range(count):
        picture.show(min(end_s, index * speed / frames_per_s))
        yield picture.pixels()


def _draw_map(axes: Axes, grid: OccupancyMap) -> None:
    shown = np.where(grid.data >= 50, 1, np.where(grid.data < 0, 2, 0))
    rows, columns = shown.shape
    right, above = grid.origin_x + columns * grid.resolution, grid.origin_y + rows * grid.resolution
    axes.imshow(
        shown,
        cmap=ListedColormap(["white", _MAP, _UNKNOWN]),
        vmin=-0.5,
        vmax=2.5,
        origin="lower",
        extent=(grid.origin_x, right, grid.origin_y, above),
        interpolation="none",
    )


def _corners(extent: Floats) -> Floats:
    left, below, right, above = extent
    return np.array([[left, below], [right, below], [right, above], [left, above]])


def _latest(shown: list[Shown], time_s: float) -> Shown | None:
    return next((one for one in reversed(shown) if one.time_s <= time_s + 1e-6), None)


def _score(recorded: Recorded, time_s: float) -> str:
    """Return outcome and score once the trial has come to its end, what it is worth before."""
    if time_s < recorded.times_s[-1] - 1e-6:
        so_far = _latest(recorded.scores, time_s)
        return "" if so_far is None else f"running, worth {so_far.content:.3f}   "
    scores = recorded.result.get("scores")
    challenge = scores.get("challenge") if isinstance(scores, dict) else None
    value: Any = f", challenge metric {challenge:.3f}" if isinstance(challenge, (int, float)) else ""
    return f"{recorded.result.get('outcome', 'no result in the bag')}{value}   "
