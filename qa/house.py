"""Count how large the suite is and how plainly it is written: lines, files, functions, commands, exceptions to rules.

    python qa/house.py
    python qa/house.py --json

Python is every file of the five packages but their tests, setup.py and launch files too, as this counts it:

    find barn_* -name '*.py' | grep -v /test/ | xargs cat | wc -l

Notebooks, examples and these tools are not counted.
`tests/test_house.py` holds what may not grow.
"""

import ast
import io
import json
import statistics
import tokenize
from collections import Counter
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from barn_eval.commands.main import cli

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("barn_worlds", "barn_sim", "barn_planners", "barn_metrics", "barn_eval")
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


class Source:
    """A file of Python."""

    def __init__(self, path: Path):
        """Read a file."""
        self.path = path
        self.text = path.read_text("utf-8")

    @property
    def lines(self) -> int:
        """How many lines it has."""
        return len(self.text.splitlines())

    @cached_property
    def comments(self) -> list[tokenize.TokenInfo]:
        """Its comments."""
        tokens = tokenize.generate_tokens(io.StringIO(self.text).readline)
        return [token for token in tokens if token.type == tokenize.COMMENT]

    @property
    def own_line_comments(self) -> int:
        """How many lines have nothing but a comment."""
        return sum(comment.line.lstrip().startswith("#") for comment in self.comments)

    @property
    def noqa(self) -> int:
        """How many lines are excepted from a rule of ruff."""
        return sum("noqa" in comment.string for comment in self.comments)

    @cached_property
    def nodes(self) -> list[ast.AST]:
        """All nodes of its tree."""
        return list(ast.walk(ast.parse(self.text)))

    @property
    def classes(self) -> list[str]:
        """The names of its classes."""
        return [node.name for node in self.nodes if isinstance(node, ast.ClassDef)]

    @property
    def functions(self) -> list[ast.FunctionDef | ast.AsyncFunctionDef]:
        """Its functions and methods."""
        return [node for node in self.nodes if isinstance(node, _FUNCTIONS)]

    @property
    def local_imports(self) -> int:
        """How many imports stand inside functions."""
        inside = {
            id(node)
            for function in self.functions
            for node in ast.walk(function)
            if _imports(node)
        }
        return len(inside)

    @property
    def signatures_with_any(self) -> int:
        """How many functions have a parameter or a result annotated as Any, and as nothing more."""
        return sum(
            any(_is_any(one) for one in _annotations(function))
            for function in self.functions
        )


def _imports(node: ast.AST) -> bool:
    return isinstance(node, ast.Import | ast.ImportFrom)


def _is_any(annotation: ast.expr | None) -> bool:
    return isinstance(annotation, ast.Name) and annotation.id == "Any"


def _annotations(
    function: ast.FunctionDef | ast.AsyncFunctionDef,
) -> Iterator[ast.expr | None]:
    given = function.args
    for one in (
        *given.posonlyargs,
        *given.args,
        *given.kwonlyargs,
        given.vararg,
        given.kwarg,
    ):
        yield one.annotation if one else None
    yield function.returns


def leaves(command: click.Command) -> Iterator[click.Command]:
    """Yield the commands that do something, under a command or a group of commands."""
    if not isinstance(command, click.Group):
        yield command
        return
    context = click.Context(command)
    for name in command.list_commands(context):
        if (one := command.get_command(context, name)) is not None:
            yield from leaves(one)


def lines_of(*patterns: str) -> int:
    """Return the number of lines of files of the repository."""
    return sum(
        len(path.read_text("utf-8").splitlines())
        for one in patterns
        for path in ROOT.glob(one)
    )


def counted() -> dict[str, float]:
    """Return what is counted, by name."""
    files = [path for name in PACKAGES for path in sorted((ROOT / name).rglob("*.py"))]
    sources = [
        Source(path) for path in files if "test" not in path.relative_to(ROOT).parts
    ]
    lengths = [source.lines for source in sources]
    classes = Counter(name for source in sources for name in source.classes)
    bodies = [
        (one.end_lineno or 0) - one.lineno + 1
        for source in sources
        for one in source.functions
    ]
    commands = {
        id(one): one for one in leaves(cli)
    }.values()  # one that goes by two names counts once
    return {
        "lines of Python": sum(lengths),
        "files of Python": len(sources),
        "lines of JavaScript": lines_of("barn_*/barn_*/**/*.js"),
        "lines of tests": lines_of("barn_*/test/**/*.py", "tests/**/*.py"),
        "lines of tools": lines_of("qa/**/*.py"),
        "median lines of a file": statistics.median(lengths),
        "lines of the biggest file": max(lengths),
        "lines of the longest function": max(bodies),
        "own-line comments, percent": round(
            100.0 * sum(one.own_line_comments for one in sources) / sum(lengths), 2
        ),
        "imports inside functions": sum(source.local_imports for source in sources),
        "exceptions from rules (noqa)": sum(source.noqa for source in sources),
        "signatures with a bare Any": sum(
            source.signatures_with_any for source in sources
        ),
        "class names used twice": sum(count > 1 for count in classes.values()),
        "leaf commands": len(commands),
        "options of commands": sum(
            isinstance(one, click.Option) for each in commands for one in each.params
        ),
    }


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
def main(as_json: bool) -> None:
    """Count."""
    found = counted()
    if as_json:
        click.echo(json.dumps(found, indent=2))
        return
    table = Table("", "", show_header=False)
    for name, value in found.items():
        table.add_row(name, f"{value:,}")
    Console().print(table)


if __name__ == "__main__":
    main()
