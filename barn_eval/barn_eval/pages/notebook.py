"""What a notebook shows of files that were written."""

import html
from base64 import b64encode
from dataclasses import dataclass
from pathlib import Path


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
        return image("image/gif", self.path.read_bytes(), self.path.stem) if self.path.suffix == ".gif" else None

    def _repr_png_(self) -> bytes | None:
        return self.path.read_bytes() if self.path.suffix == ".png" else None


def image(kind: str, content: bytes, about: str) -> str:
    """Return a picture, given by its media type and content, as an element of a page."""
    source = f"data:{kind};base64,{b64encode(content).decode()}"
    return f'<img alt="{html.escape(about)}" style="max-width: 100%" src="{source}">'
