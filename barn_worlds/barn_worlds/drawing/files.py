"""Figures and animations as content of files, the same bytes every time."""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from barn_worlds.base.files import write_bytes

# By format: what matplotlib would say of itself and of the time.
_NOT_WRITTEN: dict[str, Any] = {
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
    """Return the content of a file with a figure; tight: without its empty margins."""
    if kind == "png":
        FigureCanvasAgg(figure)
    content, unsaid = io.BytesIO(), dict.fromkeys(_NOT_WRITTEN[kind])
    around = "tight" if tight else None
    figure.savefig(
        content, format=kind, dpi=dots_per_inch, bbox_inches=around, metadata=unsaid
    )
    return content.getvalue()


def write_png(
    figure: Figure, path: Path, dots_per_inch: float = 120, *, tight: bool = True
) -> None:
    """Write a figure as PNG, whatever the file's ending, atomically; tight: without its empty margins."""
    write_bytes(path, figure_bytes(figure, dots_per_inch=dots_per_inch, tight=tight))


def gif_bytes(frames: Iterator[Image.Image], frames_per_s: float) -> bytes:
    """Return the content of a GIF that plays for ever; at least one frame."""
    content = io.BytesIO()
    period_ms = max(
        20, 10 * round(100.0 / frames_per_s)
    )  # a GIF counts in hundredths of a second
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
