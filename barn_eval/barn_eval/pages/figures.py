"""The look of figures, and how they get into pages and files.

Figures are drawn in black on nothing. In a page black becomes the color of the text, so
that a figure is readable in the dark theme too.
"""

import html
import itertools
import json
import re
from base64 import b64encode
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup, escape
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.style import context

from barn_eval.pages.template import themed, write_page
from barn_eval.trials.result import Outcome
from barn_metrics.bootstrap import Interval
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import ConfigError
from barn_worlds.drawing import palette
from barn_worlds.drawing.files import figure_bytes
from barn_worlds.drawing.palette import INK, WHITE

# At 96 pixels per inch this is the width of a page on a screen of 1280 pixels.
WIDTH_IN = 12.0
# Of the planners, in the order of their colors.
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
DASHES: tuple[Any, ...] = (
    "-",
    (0, (5, 2)),
    (0, (1, 1.4)),
    (0, (7, 1.5, 1, 1.5)),
    (0, (2.5, 1.2)),
    (0, (9, 3)),
    (0, (3, 1.2, 1, 1.2, 1, 1.2)),
)
# Failures of the machinery share one color; the table of trials names them.
OUTCOME_COLORS = dict.fromkeys(Outcome, palette.BROKEN) | {
    Outcome.SUCCESS: palette.SUCCEEDED,
    Outcome.COLLISION: palette.COLLIDED,
    Outcome.LEFT_WORLD: palette.TIMED_OUT,
    Outcome.TIMEOUT: palette.TIMED_OUT,
    Outcome.NO_FIRST_MOTION: palette.UNMOVED,
}
# A text that a page shows beside the pointer, and what picks the trial that a click
# opens: the entry, the world and the outcome, as far as they are known.
Tip = tuple[str | int, ...]

_TIPS = "tips:"
_MAX_TEXT_LENGTH = 40
_NOTEBOOK_WIDTH_PX = 860
# Digits of a coordinate in pixels beyond what a page shows.
_INVISIBLE_DIGITS = re.compile(r"(\.\d\d)\d+")
# A notebook shows several figures in one page, so their identifiers must differ.
_figure_numbers = itertools.count(1)


def style(width_mm: float | None = None) -> AbstractContextManager[None]:
    """Return a context in which matplotlib draws figures in the suite's style.

    Args:
        width_mm: Width of a figure in a paper, which gets type of 7 to 9 pt. By default
            the figure is for a page.
    """
    folder = resources.files("barn_eval") / "data"
    styles = [str(folder / "figures.mplstyle")]
    if width_mm:
        styles.append(str(folder / "paper.mplstyle"))
    return context(styles)


def new_figure(height_in: float, width_in: float = WIDTH_IN) -> Figure:
    """Return an empty figure with constrained layout, not known to pyplot.

    Args:
        height_in: Height in inches.
        width_in: Width in inches.
    """
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasSVG(figure)
    return figure


def figure_of(panels: Sequence[Axes]) -> Figure:
    """Return the top-level figure that contains the first of these axes."""
    figure = panels[0].get_figure(root=True)
    assert figure is not None
    return figure


def look_numbers(colors: Sequence[str]) -> list[int]:
    """Return for each planner's color the position of its marker and its dashes.

    A color has always the same marker. Where it repeats, the next marker is taken, so
    that the pair of both stays unique.
    """
    numbers = []
    for position, color in enumerate(colors):
        repeats = list(colors[:position]).count(color)
        numbers.append((palette.PLANNERS.index(color) + repeats) % len(MARKERS))
    return numbers


def add_tips(artist: Artist, tips: Sequence[Tip]) -> None:
    """Store in an artist's gid, as JSON, texts that a page shows beside the pointer.

    Args:
        artist: What is drawn.
        tips: One for each of its markers or areas, or a single one for all of it.
    """
    artist.set_gid(_TIPS + json.dumps(tips, separators=(",", ":")))


def label_axes(axes: Axes, x: str, y: str, title: str = "") -> None:
    """Set the labels of both axes and the title, and draw a faint grid.

    Args:
        axes: What is labeled.
        x: Name of the horizontal axis with its unit.
        y: Name of the vertical axis with its unit.
        title: Title above the axes.
    """
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.set_title(title)
    axes.grid(visible=True)
    axes.set_axisbelow(True)


def draw_estimates(
    axes: Axes,
    x: Sequence[Interval] | Floats,
    y: Sequence[Interval],
    size: float = 6,
    tips: Sequence[Tip] = (),
    **look: Any,
) -> Line2D:
    """Draw estimates as markers with bars to their limits; return a legend entry.

    Args:
        axes: What is drawn onto.
        x: Horizontal positions (n,), or estimates with limits of their own.
        y: Estimates.
        size: Size of the markers in points.
        tips: One for each estimate.
        **look: Color, marker and label, as matplotlib takes them.

    Returns:
        The markers, which alone a legend shows: caps would hide their shapes.
    """
    values: dict[str, Any] = {"x": x}
    for name, estimates in (("x", x), ("y", y)):
        if isinstance(estimates, np.ndarray):
            continue
        rows = [(e.estimate, e.low, e.high) for e in estimates]
        middle, low, high = np.array(rows, np.float64).T
        values[name] = middle
        # An estimate may lie outside its limits, if only by rounding, but matplotlib
        # refuses negative errors.
        below = np.maximum(middle - low, 0.0)
        above = np.maximum(high - middle, 0.0)
        values[f"{name}err"] = np.array([below, above])
    bars = axes.errorbar(**values, linestyle="", capsize=3, markersize=size, **look)
    marks: Line2D = bars[0]
    marks.set_label(look["label"])
    # What has no value is not drawn.
    is_drawn = np.isfinite(values["x"]) & np.isfinite(values["y"])
    add_tips(marks, list(itertools.compress(tips, is_drawn)))
    return marks


class ReportFigure(NamedTuple):
    """A finished figure of a page.

    The element is as wide as its place on the page. Its black is the color of the text,
    and planners have the colors of the theme.
    """

    name: str
    about: str
    svg: str
    element: Markup
    pdf: bytes

    def write(self, folder: Path) -> None:
        """Write the figure as NAME.svg and NAME.pdf into a folder, both on white.

        Raises:
            StoreError: A file cannot be written.
        """
        background = f'<rect width="100%" height="100%" fill="{WHITE}"/>'
        text = re.sub(r"(<svg[^>]*>)", rf"\1\n {background}", self.svg, count=1)
        document = f'<?xml version="1.0" encoding="utf-8"?>\n{text}'
        write_page(folder / f"{self.name}.svg", document)
        write_page(folder / f"{self.name}.pdf", self.pdf)


def finish_figure(figure: Figure, name: str, about: str) -> ReportFigure:
    """Return a figure as SVG, page element and PDF; fix its layout, make it white.

    Args:
        figure: What is drawn; made within `style`, so that its sizes fit.
        name: Name of its files and prefix of its identifiers.
        about: Description for readers who do not see it.
    """
    svg = unique_svg(figure, name, about)
    # A second layout, for the PDF, would move what the first has placed.
    figure.set_layout_engine(None)
    text = re.sub(
        r'(?:\bd|\bx|\by)="[^"]*"',
        lambda match: _INVISIBLE_DIGITS.sub(r"\1", match[0]),
        svg,
    )
    text = text.replace(INK, "currentColor")
    text = re.sub(r"#[0-9a-fA-F]{6}\b", lambda match: themed(match[0]), text)
    # The style sheet decides the size; the view box keeps the ratio.
    for side in ("width", "height"):
        text = re.sub(rf'(<svg[^>]*?) {side}="[^"]*"', r"\1", text, count=1)
    figure.patch.set_facecolor(WHITE)
    # This is matplotlib's markup, in which texts are paths.
    element = Markup(text)  # noqa: S704  # nosec B704
    document = _figure_content(figure, "pdf")
    return ReportFigure(name, about, svg, element, document)


def unique_svg(figure: Figure, name: str, description: str) -> str:
    """Return a figure as SVG text, with `name` in front of every identifier.

    Args:
        figure: What is drawn; its layout is made anew.
        name: Prefix of its identifiers.
        description: Text for readers who do not see it.
    """
    text = _figure_content(figure, "svg").decode()
    text = text[text.index("<svg") :]
    # Equal clip paths have equal identifiers in all figures of a page.
    text = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{name}-", text)
    # A text with quotes has gone between the other ones.
    text = re.sub(rf"""\bid=(["'])(?:{name}-)?{_TIPS}""", r"data-tips=\1", text)
    # It names the program that drew the figure, which no page shows.
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.S)
    label = f'<svg role="img" aria-label="{escape(description)}"'
    return text.replace("<svg", label, 1)


def write_figure(figure: Figure, path: Path) -> None:
    """Write a figure on white as PNG, SVG or PDF, by the ending of the path.

    Args:
        figure: What is drawn; its background becomes white.
        path: A file ending in .png, .svg or .pdf.

    Raises:
        StoreError: The file cannot be written.
    """
    figure.patch.set_facecolor(WHITE)
    write_page(path, _figure_content(figure, path.suffix[1:]))


@dataclass(frozen=True, eq=False)
class Plot:
    """A figure of matplotlib, which a notebook shows as SVG on white."""

    figure: Figure
    about: str

    def save(self, path: str | Path) -> Path:
        """Write the figure to .svg, .pdf or .png, else ConfigError; return its path.

        Raises:
            ConfigError: The ending is another.
        """
        if Path(path).suffix not in (".png", ".svg", ".pdf"):
            raise ConfigError(f"{path}: must end in .png, .svg or .pdf")
        with style():
            self.figure.savefig(path, facecolor=WHITE, dpi=150)
        return Path(path)

    def picture(self) -> str:
        """Return an HTML img element that has the figure embedded as SVG."""
        return image("image/svg+xml", self._repr_svg_().encode(), self.about)

    def _repr_svg_(self) -> str:
        """Return the figure as SVG on white, as wide as a notebook's column."""
        self.figure.patch.set_facecolor(WHITE)
        text = unique_svg(self.figure, f"barn{next(_figure_numbers)}", self.about)
        # As wide as a notebook's column: not every viewer fits a picture to it.
        size = f'width="{_NOTEBOOK_WIDTH_PX}" style="max-width: 100%"'
        return re.sub(r'width="[^"]*" height="[^"]*"', size, text, count=1)


def plain_text(text: str) -> str:
    """Return text as a line of up to 40 characters, "$" escaped; "-" for none."""
    # A label comes from a folder's name, in which a dollar would begin mathematics.
    line = " ".join(text.split()).replace("$", r"\$")
    if len(line) > _MAX_TEXT_LENGTH:
        line = line[: _MAX_TEXT_LENGTH - 1] + "…"
    # matplotlib leaves labels that begin with an underscore out of legends.
    return line.lstrip("_") or "-"


def _figure_content(figure: Figure, kind: str) -> bytes:
    """Return the bytes of a figure's svg, pdf or png file, the same at each call."""
    with style():
        return figure_bytes(figure, kind, 110)


@dataclass(frozen=True)
class Page:
    """A page or picture in one file; a notebook shows it."""

    path: Path

    def __fspath__(self) -> str:
        """Return the path, for functions that open files."""
        return str(self.path)

    def _repr_html_(self) -> str | None:
        """Return an HTML page in a frame or a GIF as HTML; None for other files."""
        if self.path.suffix == ".html":
            content = html.escape(self.path.read_text("utf-8"))
            look = "width: 100%; height: 45em; border: 0"
            return f'<iframe srcdoc="{content}" style="{look}"></iframe>'
        if self.path.suffix == ".gif":
            return image("image/gif", self.path.read_bytes(), self.path.stem)
        return None

    def _repr_png_(self) -> bytes | None:
        """Return the bytes of a .png file; None for other files."""
        return self.path.read_bytes() if self.path.suffix == ".png" else None


def image(media_type: str, content: bytes, about: str) -> str:
    """Return an HTML img element that has a picture embedded as base64.

    Args:
        media_type: Such as "image/png".
        content: Content of the picture's file.
        about: Description for readers who do not see it.
    """
    source = f"data:{media_type};base64,{b64encode(content).decode()}"
    return f'<img alt="{html.escape(about)}" style="max-width: 100%" src="{source}">'
