"""Pages in Markdown from templates of the package."""

from __future__ import annotations

from functools import cache
from typing import Any

import jinja2

from barn_eval.analysis.planner_style import spelling
from barn_metrics.bootstrap import number


def render_markdown(template: str, **content: Any) -> str:
    """Return a page of the package's templates."""
    return _environment().get_template(template).render(content)


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("barn_eval", "data/markdown"),
        autoescape=False,  # noqa: S701 (Markdown, not HTML)
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {"number": number, "spelling": spelling}
    return environment
