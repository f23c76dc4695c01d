"""What several commands have in common: options and the way values are written."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import click
from rich.console import Console
from rich.progress import Progress

from barn_eval.running.request import parse_settings
from barn_worlds.base.config import fields_of
from barn_worlds.base.errors import ConfigError, format_value
from barn_worlds.base.text_files import make_json_safe

Command = TypeVar("Command", bound=Callable[..., Any])

console = Console()
notes = Console(stderr=True)

PATH = click.Path(path_type=Path)
FILE = click.Path(path_type=Path, dir_okay=False)
FOLDER = click.Path(path_type=Path, file_okay=False)
SEED = click.IntRange(0, 2**62)
COUNT = click.IntRange(1)

json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print JSON instead of tables."
)
worlds_option = click.option(
    "--worlds", "select", default="all", help="Which, such as 0-49."
)


def keys_of(text: str) -> tuple[str, ...]:
    """Return names that are separated by commas."""
    return tuple(filter(None, map(str.strip, text.split(","))))


def seed_option(default: int = 0) -> Callable[[Command], Command]:
    """Return the option that gives the seed."""
    return click.option(
        "--seed", default=default, type=SEED, help="All randomness comes from it."
    )


def settings_option(
    option: str,
    name: str,
    about: str,
    config: object = None,
    *,
    metavar: str = "KEY=VALUE",
) -> Callable[[Command], Command]:
    """Return a repeatable option that gives a command parameters as a mapping; values are read as YAML.

    config: whose parameters the help lists.
    """
    keys = (
        ", ".join(key for key, _, _ in fields_of(config)) if config is not None else ""
    )
    text = f"{about}; repeatable." + (f" Keys: {keys}." if keys else "")

    def read(
        _: click.Context, __: click.Parameter, given: tuple[str, ...]
    ) -> dict[str, Any]:
        return parse_settings(given, option)

    return click.option(
        option, name, multiple=True, metavar=metavar, callback=read, help=text
    )


def run_option(command: Command) -> Command:
    """Return a command with the option for what a run's file may have and no option of its own stands for."""
    about = "What else a file for barn run has, as dataset, repetitions, seed, workers, ros.lockstep; repeatable."

    def read(
        _: click.Context, __: click.Parameter, given: tuple[str, ...]
    ) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for key, value in parse_settings(given, "--run").items():
            group, dot, name = key.partition(".")
            if dot and group in ("ros", "simulator"):
                found.setdefault(group, {})[name] = value
            else:
                found[key] = value
        return found

    return click.option(
        "--run", multiple=True, metavar="KEY=VALUE", callback=read, help=about
    )(command)


def read_course(
    _: click.Context, __: click.Parameter, given: str | None
) -> tuple[float, ...] | None:
    """Return the numbers of "X,Y,YAW:X,Y"; ConfigError for anything else."""
    if given is None:
        return None
    start, colon, goal = given.partition(":")
    try:
        numbers = tuple(
            float(number) for number in (*start.split(","), *goal.split(","))
        )
    except ValueError:
        numbers = ()
    if not colon or len(start.split(",")) != 3 or len(numbers) not in (5, 6):
        raise ConfigError(
            f"--course {format_value(given)}: must be X,Y,YAW:X,Y of start and goal, in m and rad"
        )
    return numbers


course_option = click.option(
    "--course",
    metavar="X,Y,YAW:X,Y",
    callback=read_course,
    help="Start and goal in every world, in m and rad [default: the world's own, else the protocol's].",
)


def print_json(content: object) -> None:
    """Print plain data as JSON; numbers that JSON does not have become null."""
    click.echo(json.dumps(make_json_safe(content), indent=1, allow_nan=False))


def tell(as_json: bool, content: object, *shown: object) -> None:
    """Print plain data as JSON, or else what is for readers: lines as they are, and tables."""
    if as_json:
        print_json(content)
    else:
        console.print(*shown, sep="\n", markup=False, highlight=False)


@contextmanager
def progress(text: str) -> Iterator[Callable[[float], None]]:
    """Show a bar on a terminal; yield what tells it the share that is done."""
    with Progress(console=notes, transient=True, disable=not notes.is_terminal) as bar:
        task = bar.add_task(text, total=1.0)
        yield lambda done: bar.update(task, completed=done)


def say(*lines: object) -> None:
    """Print lines that are not part of the results, such as paths, to standard error."""
    for line in lines:
        notes.print(str(line), markup=False, soft_wrap=True)
