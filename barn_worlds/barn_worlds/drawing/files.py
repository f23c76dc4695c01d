"""Figures and animations as the content of files, with the same bytes every time."""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from barn_worlds.base.files import write_bytes

# Left out of files, by format: versions and times differ from run to run.
_OMITTED_METADATA: dict[str, Any] = {
    "png": ("Software",),
    "svg": ("Date", "Creator"),
    "pdf": ("CreationDate",),
}


def figure_bytes(
    figure: Figure,
    kind: str = "png",
    dots_per_inch: float = 120,
    *,
    tight: bool = False,
) -> bytes:
    """Return a figure as the bytes of a PNG, SVG or PDF file, the same every time.

    Args:
        figure: Figure to save in its own size in inches.
        kind: Format: png, svg or pdf.
        dots_per_inch: Resolution of the pixels.
        tight: Whether to cut off empty margins.
    """
    if kind == "png":
        # The renderer of pixels, which needs no display.
        FigureCanvasAgg(figure)
    content = io.BytesIO()
    # Without this salt the identifiers in an SVG file would be random.
    with rc_context({"svg.hashsalt": "barn"}):
        figure.savefig(
            content,
            format=kind,
            dpi=dots_per_inch,
            bbox_inches="tight" if tight else None,
            metadata=dict.fromkeys(_OMITTED_METADATA[kind]),
        )
    return content.getvalue()


def write_png(figure: Figure, path: Path) -> None:
    """Write a figure as PNG without empty margins, atomically.

    Args:
        figure: Figure to write. Its content decides the size.
        path: File to write; its ending does not matter.
    """
    write_bytes(path, figure_bytes(figure, tight=True))


def gif_bytes(frames: Iterator[Image.Image], frames_per_s: float) -> bytes:
    """Return images as the bytes of a GIF that plays forever; consumes `frames`.

    Args:
        frames: The images, at least one.
        frames_per_s: Speed of the animation.
    """
    # A GIF counts in hundredths of a second; browsers slow down periods below 20 ms.
    period_ms = max(20, 10 * round(100.0 / frames_per_s))
    content = io.BytesIO()
    next(frames).save(
        content,
        "GIF",
        save_all=True,
        append_images=frames,
        duration=period_ms,
        loop=0,
        optimize=False,
    )
    return content.getvalue()
