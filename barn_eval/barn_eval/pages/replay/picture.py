"""The replay of a trial, or of several beside each other, as a picture, GIF or film."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from barn_eval.analysis.planners import colours
from barn_eval.bags.recorded import Recorded, Shown
from barn_eval.pages import Share
from barn_eval.pages.replay.film import Frames, counted, frame_times, save_gif, save_mp4
from barn_eval.pages.replay.page import planner_of, subtitle
from barn_eval.pages.replay.payload import bounds
from barn_eval.pages.template import write_page
from barn_worlds.base.types import OccupancyMap, Pose2D
from barn_worlds.drawing.palette import (
    BAND,
    CANDIDATE,
    CONTACT,
    GOAL,
    LOCAL_PLAN,
    MOVER,
    OBSTACLE,
    PLAN,
    ROBOT,
    SCAN,
    TRAIL,
    UNKNOWN,
)
from barn_worlds.drawing.scene import discs, draw_bodies, draw_scene

_DOTS_PER_INCH = 100


def write_png(found: Sequence[Recorded], path: Path) -> None:
    """Write the end of trials as a picture, beside each other."""
    picture = _Picture(found)
    picture.show(_end_s(found))
    content = io.BytesIO()
    picture.figure.savefig(content, dpi=_DOTS_PER_INCH, format="png", metadata={"Software": None})
    write_page(path, content.getvalue())


def write_gif(
    found: Sequence[Recorded], path: Path, frames_per_s: float, speed: float, share: Share = lambda _: None
) -> None:
    """Write trials as an animation that plays for ever."""
    save_gif(_frames(found, frames_per_s, speed, share), path, frames_per_s)


def write_mp4(
    found: Sequence[Recorded], path: Path, frames_per_s: float, speed: float, share: Share = lambda _: None
) -> None:
    """Write trials as a film; ConfigError where ffmpeg is missing or fails."""
    save_mp4(_frames(found, frames_per_s, speed, share), path, frames_per_s)


class _Picture:
    """A figure that shows trials beside each other at any time of their common clock."""

    def __init__(self, found: Sequence[Recorded]) -> None:
        sides = np.array([bounds(recorded) for recorded in found])
        left, below = sides[:, :2].min(axis=0)
        right, above = sides[:, 2:].max(axis=0)
        height = 8.0
        one = float(np.clip(height * (right - left) / (above - below) + 1.6, 5.6, 12.0))
        # The lines above it need 5.6 inches. Films want even numbers of pixels.
        width = round(one * len(found) * 50) / 50
        self.figure = Figure(figsize=(width, height), dpi=_DOTS_PER_INCH)
        self.canvas: Any = FigureCanvasAgg(self.figure)
        self._views = []
        shades = colours([planner_of(recorded) for recorded in found]) if len(found) > 1 else [""]
        for index, (recorded, shade) in enumerate(zip(found, shades, strict=True)):
            axes = self.figure.add_axes(
                ((index + 0.9 / one) / len(found), 0.075, (1.0 - 1.05 / one) / len(found), 0.82)
            )
            axes.set(xlim=(left, right), ylim=(below, above), xlabel="x [m]", ylabel="y [m]", aspect="equal")
            self._views.append(_View(recorded, axes, (index + 0.12 / one) / len(found), shade))

    def show(self, time_s: float) -> None:
        """Draw what there is at a time."""
        for view in self._views:
            view.show(time_s)

    def pixels(self) -> tuple[tuple[int, int], bytes]:
        """Return the size and the pixels, three bytes each."""
        self.canvas.draw()
        data = np.asarray(self.canvas.buffer_rgba())[:, :, :3]
        return (data.shape[1], data.shape[0]), data.tobytes()


class _View:
    """The plan view of one trial in a figure.

    left: where its title begins, as a share of the figure's width. own: colour of the trail, if it has one of its own.
    """

    def __init__(self, recorded: Recorded, axes: Axes, left: float, own: str = "") -> None:
        self._recorded = recorded
        self._axes = axes
        self._title = axes.figure.text(left, 0.915, "", fontsize=9.5, va="bottom", parse_math=False)
        if recorded.map is not None:
            _draw_map(axes, recorded.map, faint=recorded.scene is not None)
        goal = recorded.goal_pose()
        if recorded.scene is not None:
            draw_scene(axes, recorded.scene)
        elif goal is not None:
            axes.plot(goal.x, goal.y, "*", color=GOAL, markersize=13, label="goal")
        self._pushed: EllipseCollection | None = None
        self._movers, self._trails = self._add_movers()
        self._candidates: Any = axes.add_collection(
            LineCollection([], colors=CANDIDATE, linewidths=0.6, label="candidates" if recorded.candidates else "")
        )
        self._band: Any = axes.add_collection(
            LineCollection([], colors=BAND, linewidths=1.2, label="band" if recorded.bands else "")
        )
        self._plans = {}
        for name, colour, style, label in (
            ("plans", PLAN, "--", "plan"),
            ("local_plans", LOCAL_PLAN, "-", "local plan"),
        ):
            shown = label if getattr(recorded, name) else ""
            (self._plans[name],) = axes.plot([], [], color=colour, linewidth=1.8, linestyle=style, label=shown)
        self._scan = axes.plot([], [], ".", color=SCAN, markersize=2.2, label="scan" if recorded.scans else "")[0]
        self._trail = axes.plot([], [], color=own or TRAIL, linewidth=2.0, label="trail")[0]
        self._robot: Any = axes.add_patch(
            Polygon(np.zeros((4, 2)), closed=True, facecolor=ROBOT + "88", edgecolor="black", zorder=5)
        )
        self._bubbles: EllipseCollection | None = None
        began = recorded.contact & ~np.concatenate(([False], recorded.contact[:-1]))
        self._began = np.flatnonzero(began)
        self._contacts = axes.plot([], [], "x", color=CONTACT, markersize=7, label="contact" if began.any() else "")[0]
        (left_m, right_m), (below_m, above_m) = axes.get_xlim(), axes.get_ylim()
        beside = axes.bbox.width / axes.bbox.height > 1.6 * (right_m - left_m) / (above_m - below_m)
        place: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (-0.3, 0.0)} if beside else {"ncols": 2}
        axes.set_anchor("E" if beside else "C")
        axes.legend(**{"loc": "lower center", "fontsize": 8} | place)

    def show(self, time_s: float) -> None:
        """Draw what there is at a time."""
        recorded = self._recorded
        index = recorded.index_at(time_s)
        pose = Pose2D(*recorded.poses[index].tolist())
        self._trail.set_data(*recorded.poses[: index + 1, :2].T)
        self._robot.set_xy(pose.transform(recorded.outline.corners_m))
        self._robot.set_linewidth(3.0 if recorded.contact[index] else 1.0)
        self._show_movers(time_s)
        self._show_scan(_latest(recorded.scans, time_s), pose)
        for name, line in self._plans.items():
            shown = _latest(getattr(recorded, name), time_s)
            line.set_data(*(recorded.to_frame(shown).transform(shown.content).T if shown else ([], [])))
        shown = _latest(recorded.candidates, time_s)
        lines = [recorded.to_frame(shown).transform(line) for line in shown.content.lines] if shown else []
        self._candidates.set_segments(lines)
        self._show_band(_latest(recorded.bands, time_s))
        self._contacts.set_data(*recorded.poses[self._began[self._began <= index], :2].T)
        self._show_pushed(shown=time_s >= recorded.times_s[-1] - 1e-6)
        speed, turn = (recorded.speeds[index].round(2) + 0.0).tolist()  # no minus before a zero
        clock = f"{recorded.times_s[index]:6.2f} of {recorded.times_s[-1]:.2f} s   {speed:5.2f} m/s   {turn:5.2f} rad/s"
        self._title.set_text("\n".join([recorded.name, subtitle(recorded), _score(recorded, time_s) + clock]))

    def _add_movers(self) -> tuple[Any, Any]:
        """Draw walls between moving obstacles, and return what shows these and their trails."""
        moving, axes = self._recorded.moving, self._axes
        if moving is not None:
            draw_bodies(axes, moving.walls)
        look: dict[str, Any] = {"facecolor": MOVER, "edgecolor": MOVER, "alpha": 0.8}
        bodies = PolyCollection(
            [], label="moving obstacle" if moving is not None and len(moving.bodies.poses) else "", **look
        )
        trails = LineCollection([], colors=MOVER, linewidths=1.6, alpha=0.55)
        return axes.add_collection(bodies), axes.add_collection(trails)

    def _show_movers(self, time_s: float) -> None:
        """Draw moving obstacles where they are, up to the end of the trial, and where they just were."""
        moving = self._recorded.moving
        if moving is not None:
            time_s = min(time_s, float(self._recorded.times_s[-1]))
            self._movers.set_verts(moving.placed(time_s).outlines())
            self._trails.set_segments(moving.trails(time_s))

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
            self._bubbles = discs(self._axes, centres_m, found[:, 2], facecolor="none", edgecolor=BAND)

    def _show_pushed(self, *, shown: bool) -> None:
        """Draw where obstacles were pushed to, which is known of the end only."""
        if self._pushed is not None:
            self._pushed.remove()
            self._pushed = None
        scene, places = self._recorded.scene, self._recorded.pushed_m
        if shown and scene is not None and len(places):
            self._pushed = discs(self._axes, places, scene.radius_m, facecolor="none", edgecolor=CONTACT, linewidth=1.2)


def _end_s(found: Sequence[Recorded]) -> float:
    return max(float(recorded.times_s[-1]) for recorded in found)


def _frames(found: Sequence[Recorded], frames_per_s: float, speed: float, share: Share) -> Frames:
    """Yield frames from the first to the last instant; ConfigError if they would be too many."""
    times = frame_times(_end_s(found), frames_per_s, speed, found[0].name)
    picture = _Picture(found)
    for time_s in counted(times, share):
        picture.show(time_s)
        yield picture.pixels()


def _draw_map(axes: Axes, grid: OccupancyMap, *, faint: bool) -> None:
    """Draw a map; faint: its cells are lighter than the true obstacles over it, and what is unknown is not shown."""
    shown = np.where(grid.data >= 50, 1, np.where(grid.data < 0, 2, 0))
    rows, columns = shown.shape
    right, above = grid.origin_x + columns * grid.resolution, grid.origin_y + rows * grid.resolution
    axes.imshow(
        shown,
        cmap=ListedColormap(["white", UNKNOWN, "white"] if faint else ["white", OBSTACLE, UNKNOWN]),
        vmin=-0.5,
        vmax=2.5,
        origin="lower",
        extent=(grid.origin_x, right, grid.origin_y, above),
        interpolation="none",
    )


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
