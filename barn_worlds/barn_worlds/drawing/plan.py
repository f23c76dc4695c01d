"""The plan for building a world: tiles to scale, overview and coordinates as PDF."""

import io
import math
from collections.abc import Iterator
from dataclasses import dataclass

import jinja2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from barn_worlds.base.arrays import Floats, Points
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import ConfigError, WorldError
from barn_worlds.base.types import Pose2D
from barn_worlds.drawing.palette import FAINT, INK, OBSTACLE, START, WHITE
from barn_worlds.drawing.scene import draw_discs, draw_outlines, draw_scene
from barn_worlds.worlds.scene import scene_of
from barn_worlds.worlds.world import World

# Width and height in m.
PAPERS = {"a4": (0.210, 0.297), "letter": (0.2159, 0.2794)}
_INCH_M = 0.0254
_MARGIN_M = 0.012
_HEADER_M = 0.010
_OVERLAP_M = 0.01
_BAR_M = 0.1
_MOST_TILES = 1000
# Of a page of coordinates.
_ROWS = 56
_COLUMNS = 5


@dataclass(frozen=True)
class PlanConfig(Checked):
    """The parts that a course is built from, and the print of its plan."""

    shape: str = quantity("post", "object in a filled cell", choices=("post", "box"))
    size_m: float = quantity(
        0.15, "diameter of a post or side of a box", "m", 0.01, 10.0
    )
    tolerance_m: float = quantity(
        0.01,
        "largest allowed distance of each object from its planned position",
        "m",
        0.001,
        0.1,
    )
    scale: int = quantity(10, "scale of the tiles; 10 means 1:10", "", 1, 100)
    paper: str = quantity("a4", "size of the pages", choices=tuple(PAPERS))


@dataclass(frozen=True, eq=False)
class CoursePlan:
    """The plan of a world with a course, for a robot."""

    world: World
    start: Pose2D
    goal: Pose2D
    goal_distance_m: float
    outline_m: Points  # corners (k, 2) of the robot in base_link
    config: PlanConfig

    def __post_init__(self) -> None:
        """Raise WorldError if obstacles move, or parts are larger than a cell."""
        world = self.world
        if world.moving:
            raise WorldError(f"{world.name}: its moving obstacles cannot be built")
        if self.config.size_m > world.resolution_m:
            raise WorldError(
                f"{world.name}: size_m must be at most a cell, {world.resolution_m:g} m,"
                f" got {self.config.size_m:g}: neighbors would overlap"
            )

    def pdf(self) -> bytes:
        """Return all pages as PDF, always the same bytes; ConfigError above 1000 tiles.

        Raises:
            ConfigError: If the scale needs too many tiles.
        """
        content = io.BytesIO()
        with PdfPages(content, metadata={"CreationDate": None}) as pages:
            for figures in ([self._overview()], self._tables(), self._tiles()):
                for figure in figures:
                    pages.savefig(figure)
        return content.getvalue()

    def _page(self, title: str) -> Figure:
        """Return an empty page with a title."""
        width_m, height_m = PAPERS[self.config.paper]
        figure = Figure(figsize=(width_m / _INCH_M, height_m / _INCH_M))
        top = 1.0 - _MARGIN_M / height_m
        figure.text(0.06, top, title, va="top", size=8, parse_math=False)
        return figure

    def _draw(self, axes: Axes, low: Floats, high: Floats) -> None:
        """Draw the course onto axes, and limit the axes to two corners (2,) in m."""
        scene = scene_of(self.world, self.start, self.goal, self.goal_distance_m)
        size_m = self.config.size_m
        if self.config.shape == "box":
            square = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
            squares = scene.cylinders_m[:, None] + square * size_m
            axes.add_collection(
                PolyCollection(list(squares), facecolor=OBSTACLE, edgecolor=WHITE)
            )
        else:
            draw_discs(axes, scene.cylinders_m, 0.5 * size_m, facecolor=OBSTACLE)
        empty = np.empty((0, 2))
        draw_scene(axes, scene._replace(obstacles_m=empty, walls_m=empty))
        start = np.array([self.start.numbers])
        draw_outlines(axes, start, self.outline_m, START)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        axes.grid(linewidth=0.3, color=FAINT)

    def _overview(self) -> Figure:
        """Return the page with the whole course, its parts and instructions."""
        figure = self._page(f"{self.world.name}: plan of the course")
        axes = figure.add_axes((0.07, 0.05, 0.5, 0.87))
        self._draw(axes, *self._extent())
        axes.set(xlabel="x [m]", ylabel="y [m]")
        cylinders_m = self.world.cylinders_m
        span_m = np.ptp(cylinders_m, axis=0).tolist()
        between_m = self.world.path_m()[:, None] - cylinders_m
        distances_m = np.hypot(*between_m.T)
        environment = jinja2.Environment(
            loader=jinja2.PackageLoader("barn_worlds", "data/formats"),
            trim_blocks=True,
            autoescape=False,  # it is drawn, not parsed  # noqa: S701  # nosec B701
        )
        text = environment.get_template("plan.txt.jinja").render(
            vars(self),
            degrees=math.degrees,
            span_m=span_m,
            diagonal_m=math.hypot(*span_m),
            nearest_m=distances_m.min(initial=math.inf) - 0.5 * self.config.size_m,
            half_width_m=0.5 * np.ptp(self.outline_m[:, 1]),
            corners=self.start.transform(self.outline_m).tolist(),
        )
        figure.text(0.6, 0.92, text, va="top", size=7.5, parse_math=False)
        return figure

    def _tables(self) -> Iterator[Figure]:
        """Yield pages that list number, x and y (m) of each cylinder's center."""
        lines = [
            f"{number:4d} {x:7.3f} {y:7.3f}"
            for number, (x, y) in enumerate(self.world.cylinders_m.tolist())
        ]
        title = (
            f"{self.world.name}: number, x and y of each center in m; from number"
            f" {len(self.world.obstacles_m)} on, they are the walls around"
        )
        for begin in range(0, len(lines), _ROWS * _COLUMNS):
            figure = self._page(title)
            for column in range(_COLUMNS):
                top = begin + column * _ROWS
                text = "\n".join(lines[top : top + _ROWS])
                left = 0.06 + column * 0.18
                figure.text(left, 0.93, text, va="top", size=7, family="monospace")
            yield figure

    def _extent(self) -> tuple[Floats, Floats]:
        """Return corners (2,) in m of all that is built, with a margin of 0.2 m."""
        goal_m = np.array([self.goal.position])
        start_m = self.start.transform(self.outline_m)
        radius_m = self.goal_distance_m
        bounds_m = np.reshape(self.world.bounds_m, (2, 2))
        points_m = np.concatenate(
            [bounds_m, start_m, goal_m - radius_m, goal_m + radius_m]
        )
        return points_m.min(axis=0) - 0.2, points_m.max(axis=0) + 0.2

    def _tiles(self) -> Iterator[Figure]:
        """Yield each tile to scale, top row first; ConfigError if more than 1000."""
        scale = self.config.scale
        paper_m = np.array(PAPERS[self.config.paper])
        area_m = paper_m - (2.0 * _MARGIN_M, 2.0 * _MARGIN_M + _HEADER_M)
        step_m = (area_m - _OVERLAP_M) * scale
        low, high = self._extent()
        across, down = np.ceil((high - low) / step_m).astype(int).tolist()
        if across * down > _MOST_TILES:
            raise ConfigError(
                f"scale {scale}: the plan would have {across * down} tiles, and at most"
                f" {_MOST_TILES} are allowed; use a larger scale number"
            )
        frame = np.concatenate([(_MARGIN_M, _MARGIN_M), area_m])
        left, bottom, width, height = (frame / np.tile(paper_m, 2)).tolist()
        centers_m = self.world.cylinders_m
        # In points, within the object.
        size = min(7.0, 28.0 * self.config.size_m / _INCH_M / scale)
        for row, column in np.ndindex(down, across):
            corner = low + step_m * (column, down - 1 - row)
            inside = (centers_m > corner) & (centers_m < corner + area_m * scale)
            figure = self._page(
                f"{self.world.name}, 1:{scale}, row {row + 1} of {down}, column"
                f" {column + 1} of {across}. Print at 100%: the bar is"
                f" {1000.0 * _BAR_M:g} mm. Tiles overlap by {1000.0 * _OVERLAP_M:g} mm."
                " x and y are in m."
            )
            axes = figure.add_axes((left, bottom, width, height))
            self._draw(axes, corner, corner + area_m * scale)
            for number in np.flatnonzero(inside.all(axis=1)).tolist():
                x, y = centers_m[number]
                axes.text(
                    x, y, str(number), size=size, color=WHITE, ha="center", va="center"
                )
            # Above the frame, where nothing else is drawn.
            bar_x, bar_y = corner + (0.0, area_m[1] * scale + 0.003 * scale)
            bar = [bar_x, bar_x + _BAR_M * scale]
            axes.plot(bar, [bar_y, bar_y], color=INK, clip_on=False)
            # A mark or a grid line through a label would look like a minus sign.
            axes.tick_params(length=0, labelsize=6, pad=-12)
            for label in (*axes.get_xticklabels(), *axes.get_yticklabels()):
                label.set_bbox({"color": WHITE, "pad": 1.0})
            yield figure
