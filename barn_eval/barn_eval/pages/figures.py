"""The look of a report's figures, and their way into pages and files.

Figures are drawn in black on nothing. In a page what is black takes the colour of its text, so that it is read on dark
paper as well.
"""

import html
import itertools
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
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.style import context

from barn_eval.pages.template import themed
from barn_eval.trials.outcome import Outcome
from barn_metrics.bootstrap import Interval
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.files import write_durably
from barn_worlds.drawing import palette
from barn_worlds.drawing.files import figure_bytes
from barn_worlds.drawing.palette import FAINT, INK, WHITE

WIDTH_IN = 12.0  # at 96 pixels per inch the width of a page for 1280 pixels
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
# Failures of the machinery share one colour, their names are in the table of trials.
OUTCOME_COLOURS = dict.fromkeys(Outcome, palette.BROKEN) | {
    Outcome.SUCCESS: palette.SUCCEEDED,
    Outcome.COLLISION: palette.COLLIDED,
    Outcome.TIMEOUT: palette.TIMED_OUT,
    Outcome.NO_FIRST_MOTION: palette.UNMOVED,
}
_DECIMALS = re.compile(r"(\.\d\d)\d+")  # of pixels, beyond what a page shows
_COLUMN_PX = 860
_TYPE = ("xtick.labelsize", "ytick.labelsize", "legend.fontsize")
_IN_PAPERS = dict.fromkeys(_TYPE, 7.0) | {
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.labelsize": 8.0,
}
_IN_PAPERS |= {
    "lines.markersize": 4.0,
    "legend.handlelength": 1.6,
    "legend.columnspacing": 1.0,
}
_numbers = itertools.count(
    1
)  # of figures: their identifiers are their own in a page that shows several
_IN_INK = (
    "text.color",
    "axes.edgecolor",
    "axes.labelcolor",
    "axes.titlecolor",
    "xtick.color",
    "ytick.color",
)


def style(width_mm: float | None = None) -> AbstractContextManager[None]:
    """Return the context in which figures are made and written.

    width_mm: of a figure in a paper, whose type is of 7 to 9 pt whatever its width.
    """
    own = resources.files("barn_eval") / "data" / "figures.mplstyle"
    sizes = _IN_PAPERS if width_mm else {}
    return context(
        [str(own), dict.fromkeys(_IN_INK, INK) | {"grid.color": FAINT} | sizes]
    )


def small() -> float:
    """Return the size of small type in points, within `style`."""
    return FontProperties(size=rcParams["legend.fontsize"]).get_size_in_points()


def new_figure(height_in: float, width_in: float = WIDTH_IN) -> Figure:
    """Return an empty figure."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasSVG(figure)
    return figure


def figure_of(panels: Sequence[Axes]) -> Figure:
    """Return the figure that axes are in."""
    figure = panels[0].get_figure(root=True)
    assert figure is not None
    return figure


def marker_of(index: int) -> str:
    """Return the marker of an entry: after seven, when colours come again, they go on by one."""
    return MARKERS[(index + index // len(MARKERS)) % len(MARKERS)]


def label_axes(axes: Axes, x: str, y: str, title: str = "") -> None:
    """Name both axes, with units, and draw a faint grid."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.set_title(title)
    axes.grid(visible=True)
    axes.set_axisbelow(True)


def points(
    axes: Axes,
    x: Sequence[Interval] | Floats,
    y: Sequence[Interval],
    colour: str,
    marker: str,
    size: float = 6,
) -> ErrorbarContainer:
    """Draw estimates with their limits at places along x, or at estimates; return what a legend shows of them."""
    shown: dict[str, Any] = {"x": x}
    for name, found in (("x", x), ("y", y)):
        if not isinstance(found, np.ndarray):
            middle, low, high = np.array(
                [(one.estimate, one.low, one.high) for one in found], np.float64
            ).T
            shown[name] = middle
            shown[f"{name}err"] = np.array(
                [np.maximum(middle - low, 0.0), np.maximum(high - middle, 0.0)]
            )
    return axes.errorbar(
        **shown, color=colour, marker=marker, linestyle="", capsize=3, markersize=size
    )


class ReportFigure(NamedTuple):
    """A finished figure of a page: as SVG, as an element of the page, and as PDF, which is empty where nobody wants it.

    The element is as wide as there is room. What is black in it takes the colour of the text, and a planner's colour is
    the one it has on the page's paper.
    """

    name: str
    about: str
    svg: str
    element: Markup
    pdf: bytes

    def write(self, folder: Path) -> None:
        """Write it as SVG and PDF, both on white; StoreError if that fails."""
        paper = f'<rect width="100%" height="100%" fill="{WHITE}"/>'
        text = re.sub(r"(<svg[^>]*>)", rf"\1\n {paper}", self.svg, count=1)
        write_durably(
            folder / f"{self.name}.svg",
            f'<?xml version="1.0" encoding="utf-8"?>\n{text}'.encode(),
        )
        write_durably(folder / f"{self.name}.pdf", self.pdf)


def finished(figure: Figure, name: str, about: str, *, pdf: bool) -> ReportFigure:
    """Draw a figure once for page and files; its layout stays what it is then."""
    svg = own_svg(figure, name, about)
    figure.set_layout_engine(None)
    text = re.sub(
        r'(?:\bd|\bx|\by)="[^"]*"', lambda found: _DECIMALS.sub(r"\1", found[0]), svg
    )
    text = text.replace(INK, "currentColor")
    if not any(
        axes.images for axes in figure.axes
    ):  # pixels keep their colours, and so does their legend
        text = re.sub(r"#[0-9a-fA-F]{6}\b", lambda found: themed(found[0]), text)
    for side in ("width", "height"):
        text = re.sub(rf'(<svg[^>]*?) {side}="[^"]*"', r"\1", text, count=1)
    figure.patch.set_facecolor(WHITE)
    element = Markup(text)  # matplotlib's own markup: texts are paths  # noqa: S704  # nosec B704
    return ReportFigure(
        name, about, svg, element, _content(figure, "pdf") if pdf else b""
    )


def own_svg(figure: Figure, name: str, description: str) -> str:
    """Return a figure as SVG, its identifiers made its own."""
    text = _content(figure, "svg").decode()
    text = text[text.index("<svg") :]
    text = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{name}-", text)
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.S)
    return text.replace(
        "<svg", f'<svg role="img" aria-label="{escape(description)}"', 1
    )


def write_figure(figure: Figure, path: Path) -> None:
    """Write a figure on white to a file ending in .png, .svg or .pdf; StoreError if it cannot be written."""
    figure.patch.set_facecolor(WHITE)
    write_durably(path, _content(figure, path.suffix[1:]))


@dataclass(frozen=True, eq=False)
class Plot:
    """A figure of matplotlib, which a notebook shows as SVG on white."""

    figure: Figure
    about: str

    def save(self, path: str | Path) -> Path:
        """Write the figure on white, in the format of the file's ending (.svg, .pdf, .png), and return the path."""
        if Path(path).suffix not in (".png", ".svg", ".pdf"):
            raise ConfigError(f"{path}: must end in .png, .svg or .pdf")
        with style():
            self.figure.savefig(path, facecolor=WHITE, dpi=150)
        return Path(path)

    def picture(self) -> str:
        """Return the figure as a picture in HTML."""
        return image("image/svg+xml", self._repr_svg_().encode(), self.about)

    def _repr_svg_(self) -> str:
        self.figure.patch.set_facecolor(WHITE)
        text = own_svg(self.figure, f"barn{next(_numbers)}", self.about)
        # As wide as a notebook's column: not every viewer fits a picture to it.
        return re.sub(
            r'width="[^"]*" height="[^"]*"',
            f'width="{_COLUMN_PX}" style="max-width: 100%"',
            text,
            count=1,
        )


def plain(text: str) -> str:
    """Return a text that matplotlib shows as it is: no mathematics, no line breaks, at most 40 characters."""
    shown = " ".join(text.split()).replace("$", r"\$")
    shown = shown if len(shown) <= 40 else shown[:39] + "…"
    return shown.lstrip("_") or "-"


def _content(figure: Figure, kind: str) -> bytes:
    """Return the content of a file without what differs from one writing to the next."""
    with style():
        return figure_bytes(figure, kind, 110)


@dataclass(frozen=True)
class Page:
    """A page or picture that is one file; a notebook shows it."""

    path: Path

    def __fspath__(self) -> str:
        """Return the path, for whatever opens files."""
        return str(self.path)

    def _repr_html_(self) -> str | None:
        if self.path.suffix == ".html":
            content = html.escape(self.path.read_text("utf-8"))
            return f'<iframe srcdoc="{content}" style="width: 100%; height: 45em; border: 0"></iframe>'
        return (
            image("image/gif", self.path.read_bytes(), self.path.stem)
            if self.path.suffix == ".gif"
            else None
        )

    def _repr_png_(self) -> bytes | None:
        return self.path.read_bytes() if self.path.suffix == ".png" else None


def image(kind: str, content: bytes, about: str) -> str:
    """Return a picture, given by its media type and content, as an element of a page."""
    source = f"data:{kind};base64,{b64encode(content).decode()}"
    return f'<img alt="{html.escape(about)}" style="max-width: 100%" src="{source}">'
