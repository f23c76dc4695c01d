"""Pages from the package's templates: Markdown, and HTML that is one file, with data packed into it."""

import json
from functools import cache
from importlib import resources
from pathlib import Path

import jinja2
from markupsafe import Markup

from barn_eval.analysis.planners import spelling
from barn_eval.analysis.text_table import count_noun
from barn_metrics.bootstrap import number
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.files import write_durably
from barn_worlds.base.text_files import make_json_safe
from barn_worlds.drawing.palette import MOVER, PAGE, PLANNERS, PLANNERS_ON_DARK

# What in JSON could end a script element, or a line of JavaScript, before its time.
_UNSAFE = {
    "<": "\\u003c",
    ">": "\\u003e",
    "&": "\\u0026",
    "\u2028": "\\u2028",
    "\u2029": "\\u2029",
}


def render(template: str, **content: object) -> str:
    """Return a page of the package's templates; in HTML all that is not markup of the package's own is escaped."""
    return _environment().get_template(template).render(content)


def write_page(path: Path, page: str | bytes) -> None:
    """Write a page or picture whole or not at all; ConfigError or StoreError if it cannot be."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(
            f"{path.parent}: cannot be written: {error.strerror or error}"
        ) from None
    write_durably(path, page if isinstance(page, bytes) else page.encode("utf-8"))


def script_json(content: object) -> Markup:
    """Return JSON that is safe within a script element; numbers that JSON does not have become null."""
    text = json.dumps(
        make_json_safe(content),
        ensure_ascii=False,
        allow_nan=False,
        separators=(",", ":"),
    )
    for character, escape in _UNSAFE.items():
        text = text.replace(character, escape)
    return Markup(text)  # every character that is markup has been replaced  # noqa: S704  # nosec B704


def asset(name: str) -> Markup:
    """Return a style sheet or script of the package, to be written into a page."""
    text = (resources.files("barn_eval") / "data" / "page" / name).read_text("utf-8")
    return Markup(text)  # the package's own file  # noqa: S704  # nosec B704


def colour_sheet() -> Markup:
    """Return the palette as properties of a style sheet, on white and on dark paper."""
    on_white = "".join(f"--{name}: {white}; " for name, (white, _) in PAGE.items())
    on_dark = "".join(f"--{name}: {dark}; " for name, (_, dark) in PAGE.items())
    on_dark += "".join(
        f"{_property(colour)}: {dark}; " for colour, dark in PLANNERS_ON_DARK.items()
    )
    dark = f"@media screen and (prefers-color-scheme: dark) {{ :root {{ {on_dark}}} }}"
    return Markup(f":root {{ color-scheme: light dark; {on_white}}}\n{dark}\n")  # noqa: S704  # nosec B704


def themed(colour: str) -> str:
    """Return a colour for style sheets: that of planners and moving obstacles is the theme's, any other is itself."""
    if colour == MOVER:
        return f"var(--mover, {MOVER})"
    return (
        f"var({_property(colour)}, {colour})" if colour.upper() in PLANNERS else colour
    )


def _property(colour: str) -> str:
    """Return the name that a planner's colour has in style sheets."""
    return f"--c-{colour[1:].lower()}"


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("barn_eval", "data/page"),
        autoescape=jinja2.select_autoescape(["html"]),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.globals |= {"asset": asset, "colour_sheet": colour_sheet}
    environment.filters |= {
        one.__name__: one for one in (script_json, count_noun, number, spelling, themed)
    }
    return environment
