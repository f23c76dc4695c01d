"""Recorded trials from above, beside each other, drawn by matplotlib."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from barn_eval.analysis.planners import colours
from barn_eval.bags.recorded import Recorded, Shown
from barn_eval.pages.replay.page import outcome_by, planner_of, subtitle
from barn_eval.pages.replay.payload import bounds, line_layers, placed_discs, placed_lines
from barn_sim.drawing.camera import Pixels
from barn_worlds.base.arrays import Points
from barn_worlds.base.types import OccupancyMap, Pose2D
from barn_worlds.drawing import palette
from barn_worlds.drawing.scene import circles, draw_bodies, draw_scene

_DOTS_PER_INCH = 100
_HEIGHT_IN = 8.0
# How layers of lines look, the lowest first.
_LINES: dict[str, dict[str, Any]] = {
    "candidates": {"colors": palette.CANDIDATE, "linewidths": 0.6},
    "band": {"colors": palette.BAND, "linewidths": 1.2},
    "plan": {"colors": palette.PLAN, "linewidths": 1.8, "linestyles": "--"},
    "local_plan": {"colors": palette.LOCAL_PLAN, "linewidths": 1.8},
}


def plan_frames(found: Sequence[Recorded], times_s: Sequence[float]) -> Iterator[Pixels]:
    """Yield trials beside each other at times of their common clock."""
    sides = np.array([bounds(recorded) for recorded in found])
    left, below = sides[:, :2].min(axis=0)
    right, above = sides[:, 2:].max(axis=0)
    one = float(np.clip(_HEIGHT_IN * (right - left) / (above - below) + 1.6, 5.6, 12.0))
    # The lines above it need 5.6 inches. Films want even numbers of pixels.
    figure = Figure(figsize=(round(one * len(found) * 50) / 50, _HEIGHT_IN), dpi=_DOTS_PER_INCH)
    canvas: Any = FigureCanvasAgg(figure)
    views = []
    shades = colours([planner_of(recorded) for recorded in found]) if len(found) > 1 else [palette.TRAIL]
    for index, (recorded, shade) in enumerate(zip(found, shades, strict=True)):
        axes = figure.add_axes(((index + 0.9 / one) / len(found), 0.075, (1.0 - 1.05 / one) / len(found), 0.82))
        axes.set(xlim=(left, right), ylim=(below, above), xlabel="x [m]", ylabel="y [m]", aspect="equal")
        views.append(_PlanView(recorded, axes, (index + 0.12 / one) / len(found), shade))
    for time_s in times_s:
        for view in views:
            view.show(time_s)
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[:, :, :3].copy()


class _PlanView:
    """The plan view of one trial in a figure.

    left: where its title begins, as a share of the figure's width. trail: colour of the trail.
    """

    def __init__(self, recorded: Recorded, axes: Axes, left: float, trail: str) -> None:
        self._recorded = recorded
        self._title = axes.figure.text(left, 0.915, "", fontsize=9.5, va="bottom", parse_math=False)
        self._layers = line_layers(recorded)
        began = recorded.contact & ~np.concatenate(([False], recorded.contact[:-1]))
        self._began = np.flatnonzero(began)
        self._draw_ground(axes)
        mover: dict[str, Any] = {"facecolor": palette.MOVER, "edgecolor": palette.MOVER, "alpha": 0.8}
        some = recorded.moving is not None and len(recorded.moving.bodies.poses)
        self._movers = PolyCollection([], label="moving obstacle" if some else "", **mover)
        self._ways = LineCollection([], colors=palette.MOVER, linewidths=1.6, alpha=0.55)
        self._lines = {
            name: LineCollection([], label=name.replace("_", " ") if self._layers[name] else "", **look)
            for name, look in _LINES.items()
        }
        self._bubbles = PolyCollection([], facecolor="none", edgecolor=palette.BAND)
        for collection in (self._movers, self._ways, *self._lines.values(), self._bubbles):
            axes.add_collection(collection)
        scan, contact = "scan" if recorded.scans else "", "contact" if began.any() else ""
        (self._scan,) = axes.plot([], [], ".", color=palette.SCAN, markersize=2.2, label=scan)
        (self._trail,) = axes.plot([], [], color=trail, linewidth=2.0, label="trail")
        robot: dict[str, Any] = {"facecolor": palette.ROBOT + "88", "edgecolor": "black", "zorder": 5}
        self._robot = Polygon(np.zeros((4, 2)), closed=True, **robot)
        axes.add_patch(self._robot)
        (self._contacts,) = axes.plot([], [], "x", color=palette.CONTACT, markersize=7, label=contact)
        _legend(axes)

    def show(self, time_s: float) -> None:
        """Draw what there is at a time."""
        recorded = self._recorded
        index, over = recorded.index_at(time_s), time_s >= recorded.times_s[-1] - 1e-6
        pose = Pose2D(*recorded.poses[index].tolist())
        self._trail.set_data(*recorded.poses[: index + 1, :2].T)
        self._robot.set_xy(pose.transform(recorded.outline.corners_m))
        self._robot.set_linewidth(3.0 if recorded.contact[index] else 1.0)
        if recorded.moving is not None:
            now_s = min(time_s, float(recorded.times_s[-1]))
            self._movers.set_verts(recorded.moving.placed(now_s).outlines())
            self._ways.set_segments(recorded.moving.trails(now_s))
        if scan := _latest(recorded.scans, time_s):
            self._scan.set_data(*_returns(scan, pose @ recorded.lidar))
        for name, lines in self._lines.items():
            shown = _latest(self._layers[name], time_s)
            lines.set_segments(placed_lines(recorded, shown) if shown else [])
        band = _latest(recorded.bands, time_s)
        discs = placed_discs(recorded, band) if band else np.empty((0, 3))
        self._bubbles.set_verts(circles(discs[:, :2], discs[:, 2]))
        self._contacts.set_data(*recorded.poses[self._began[self._began <= index], :2].T)
        self._pushed.set_visible(over)  # which is known of the end only
        speed, turn = (recorded.speeds[index].round(2) + 0.0).tolist()  # no minus before a zero
        clock = f"{recorded.times_s[index]:6.2f} of {recorded.times_s[-1]:.2f} s   {speed:5.2f} m/s   {turn:5.2f} rad/s"
        self._title.set_text("\n".join([recorded.name, subtitle(recorded), _score(recorded, time_s) + clock]))

    def _draw_ground(self, axes: Axes) -> None:
        """Draw what stays: map, world, walls between moving obstacles, goal; what was pushed, until it is shown."""
        recorded, goal = self._recorded, self._recorded.goal_pose()
        if recorded.map is not None:
            _draw_map(axes, recorded.map, faint=recorded.scene is not None)
        if recorded.scene is not None:
            draw_scene(axes, recorded.scene)
        elif goal is not None:
            axes.plot(goal.x, goal.y, "*", color=palette.GOAL, markersize=13, label="goal")
        if recorded.moving is not None:
            draw_bodies(axes, recorded.moving.walls)
        rings = circles(recorded.pushed_m, recorded.scene.radius_m if recorded.scene else 0.0)
        self._pushed = PolyCollection(rings, facecolor="none", edgecolor=palette.CONTACT, linewidth=1.2)
        axes.add_collection(self._pushed)


def _legend(axes: Axes) -> None:
    """Put the legend beside a narrow world, below in it otherwise."""
    (left_m, right_m), (below_m, above_m) = axes.get_xlim(), axes.get_ylim()
    beside = axes.bbox.width / axes.bbox.height > 1.6 * (right_m - left_m) / (above_m - below_m)
    place: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (-0.3, 0.0)} if beside else {"ncols": 2}
    axes.set_anchor("E" if beside else "C")
    axes.legend(**{"loc": "lower center", "fontsize": 8} | place)


def _returns(shown: Shown, lidar: Pose2D) -> Points:
    """Return where a scan from a pose ends (2, k)."""
    scan = shown.content
    seen = np.isfinite(scan.ranges) & (scan.ranges >= scan.range_min)
    angles, ranges = scan.angles()[seen], scan.ranges[seen].astype(np.float64)
    ends: Points = lidar.transform(np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles)])).T
    return ends


def _draw_map(axes: Axes, grid: OccupancyMap, *, faint: bool) -> None:
    """Draw a map; faint: its cells are lighter than the true obstacles over it, and what is unknown is not shown."""
    shown = np.where(grid.data >= 50, 1, np.where(grid.data < 0, 2, 0))
    rows, columns = shown.shape
    right, above = grid.origin_x + columns * grid.resolution, grid.origin_y + rows * grid.resolution
    white, solid, unknown = palette.WHITE, palette.OBSTACLE, palette.UNKNOWN
    look: dict[str, Any] = {"vmin": -0.5, "vmax": 2.5, "origin": "lower", "interpolation": "none"}
    cells = ListedColormap([white, unknown, white] if faint else [white, solid, unknown])
    axes.imshow(shown, cmap=cells, extent=(grid.origin_x, right, grid.origin_y, above), **look)


def _latest(shown: Sequence[Shown], time_s: float) -> Shown | None:
    return next((one for one in reversed(shown) if one.time_s <= time_s + 1e-6), None)


def _score(recorded: Recorded, time_s: float) -> str:
    """Return outcome and score once the trial has come to its end, what it is worth before."""
    if not (outcome := outcome_by(recorded, time_s)):
        so_far = _latest(recorded.scores, time_s)
        return "" if so_far is None else f"running, worth {so_far.content:.3f}   "
    scores = recorded.result.get("scores")
    challenge = scores.get("challenge") if isinstance(scores, dict) else None
    value = f", challenge metric {challenge:.3f}" if isinstance(challenge, (int, float)) else ""
    return f"{outcome}{value}   "
