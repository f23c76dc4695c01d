"""Render pages from the package's templates, as one file with data packed into it."""

import json
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from barn_eval.analysis.planners import spelling
from barn_eval.analysis.text_table import count_noun, latex_text, one_line
from barn_metrics.bootstrap import number
from barn_worlds.base.errors import ConfigError, convert_os_errors
from barn_worlds.base.files import make_json_safe, write_durably
from barn_worlds.drawing import palette

# Characters that could end a script element or a line of JavaScript inside JSON.
_UNSAFE_IN_SCRIPTS = {
    "<": "\\u003c",
    ">": "\\u003e",
    "&": "\\u0026",
    "\u2028": "\\u2028",
    "\u2029": "\\u2029",
}


def render(template: str, **content: object) -> str:
    """Return the text of one of the package's templates, escaped if HTML, with `content`.

    A name that the template uses and `content` lacks raises an error.

    Args:
        template: File name of the template.
        **content: Values by the names that the template uses.
    """
    return _environment().get_template(template).render(content)


def write_page(path: Path, page: str | bytes) -> None:
    """Write text or bytes to a file, whole or not at all; make the folders above it.

    Args:
        path: The file.
        page: Its content.

    Raises:
        ConfigError: A folder cannot be made.
        StoreError: The file cannot be written.
    """
    with convert_os_errors(ConfigError, f"{path.parent}: cannot be written"):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_durably(path, page if isinstance(page, bytes) else page.encode("utf-8"))


def script_json(content: object) -> Markup:
    """Return a value as JSON that is safe in an HTML script; NaN and infinity are null."""
    options: Any = {"ensure_ascii": False, "allow_nan": False, "separators": (",", ":")}
    try:
        text = json.dumps(content, **options)
    # Nearly all content is safe, and a copy of it takes as long as the text.
    except ValueError:
        text = json.dumps(make_json_safe(content), **options)
    for character, escape in _UNSAFE_IN_SCRIPTS.items():
        text = text.replace(character, escape)
    # Every character that is markup has been replaced.
    return Markup(text)  # noqa: S704  # nosec B704


def asset(name: str) -> Markup:
    """Return the text of a style sheet or script of the package, for a page."""
    text = (resources.files("barn_eval") / "data" / "page" / name).read_text("utf-8")
    # The file is the package's own.
    return Markup(text)  # noqa: S704  # nosec B704


def themed(color: str) -> str:
    """Return a hexadecimal color as CSS that follows the page's light or dark theme.

    Only the colors of planners, outcomes and moving obstacles depend on the theme.
    """
    if color == palette.MOVER:
        return f"var(--mover, {color})"
    if color in palette.ON_DARK:
        return f"var({property_name(color)}, {color})"
    return color


def property_name(color: str) -> str:
    """Return the CSS property of a themed color, such as --c-0072b2."""
    return f"--c-{color[1:]}"


@cache
def _environment() -> jinja2.Environment:
    """Return the Jinja environment with the package's filters, made once."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("barn_eval", "data/page"),
        autoescape=jinja2.select_autoescape(["html"]),
        # A misspelled name must fail instead of leaving a gap in the page.
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.globals |= {
        "asset": asset,
        "palette": palette,
    }
    for function in (
        script_json,
        count_noun,
        latex_text,
        number,
        one_line,
        property_name,
        spelling,
        themed,
    ):
        environment.filters[function.__name__] = function
    return environment
