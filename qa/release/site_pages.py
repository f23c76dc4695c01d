"""Lay out the repository's pages and the files they link to for the site.

    python qa/release/site_pages.py build/pages

makes a folder of links that has each page under its path in the repository, so that a
link between two pages works in the site as it does where the repository is browsed.
"""

import re
import shutil
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = (
    "*.md",
    "docs/**/*.md",
    "barn_*/README.md",
    "qa/README.md",
    "barn_*/barn_*/data/*.md",
    "examples/**/README.md",
)
ASSETS = ("docs/site.css", "docs/iframe-worker.js")
LINK = re.compile(r"\]\(([^)\s#]+)|<img src=\"([^\"]+)\"")


def pages() -> list[Path]:
    """Return all pages of the repository."""
    return sorted({path for pattern in PAGES for path in ROOT.glob(pattern)})


def targets(page: Path) -> set[Path]:
    """Return the files within the repository that a page links to or shows."""
    paths = {
        (page.parent / (link or image)).resolve()
        for link, image in LINK.findall(page.read_text("utf-8"))
    }
    return {path for path in paths if path.is_file() and path.is_relative_to(ROOT)}


def lay_out(folder: Path) -> None:
    """Make the folder anew."""
    shutil.rmtree(folder, ignore_errors=True)
    for path in {
        *pages(),
        *(target for page in pages() for target in targets(page)),
        *map(ROOT.joinpath, ASSETS),
    }:
        place = folder / path.relative_to(ROOT)
        place.parent.mkdir(parents=True, exist_ok=True)
        place.symlink_to(path)
    (
        folder.parent / "COLCON_IGNORE"
    ).touch()  # as colcon does: no packages are looked for among the links


if __name__ == "__main__":
    lay_out(Path(sys.argv[1]))
