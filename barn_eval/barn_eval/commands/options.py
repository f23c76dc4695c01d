"""Options that several commands share, and how commands print."""

import json
import math
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import click
from click.shell_completion import CompletionItem
from rich.console import Console
from rich.progress import Progress

from barn_eval.commands.tables import quantities_table
from barn_eval.running.reporting import ConsoleReporter, OutcomeColors, Verbosity
from barn_eval.running.request import parse_parameters
from barn_eval.trials.protocol import PROTOCOLS
from barn_planners.registry import planner_names
from barn_worlds.base.config import fields_of
from barn_worlds.base.errors import (
    ConfigError,
    format_value,
    parse_number,
    strip_controls,
)
from barn_worlds.base.files import make_json_safe
from barn_worlds.datasets.dataset import dataset_files
from barn_worlds.robots.files import ROBOTS

_MAX_HELP_KEYS = 12  # in the help of an option

Command = TypeVar("Command", bound=Callable[..., Any])
Decorator = Callable[[Command], Command]

# Output goes to standard output alone, so that it can be piped.
# Texts may have brackets and numbers, which rich would take for markup or color.
console = Console(markup=False, highlighter=OutcomeColors())
notes = Console(stderr=True)
reporter = ConsoleReporter(notes)


class NameType(click.types.StringParamType):
    """A text that the shell completes with names, or with files if no name fits."""

    def __init__(self, list_names: Callable[[], Iterable[str]]):
        """Make a type whose names are those that `list_names` returns."""
        self._list_names = list_names

    def shell_complete(
        self,
        ctx: click.Context,  # noqa: ARG002
        param: click.Parameter,  # noqa: ARG002
        incomplete: str,
    ) -> list[CompletionItem]:
        """Return completions of the last name in a list such as "a,b=c", or files.

        Args:
            ctx: Context of the call.
            param: Option or argument.
            incomplete: Beginning of its value.
        """
        *earlier_names, start = re.split("[,=]", incomplete)
        before = incomplete.removesuffix(start)
        items = []
        for name in self._list_names():
            if name.startswith(start) and name not in earlier_names:
                items.append(CompletionItem(before + name))
        return items or [CompletionItem(incomplete, type="file")]


DATASET = NameType(dataset_files)
PLANNER = NameType(planner_names)
PROTOCOL = NameType(lambda: PROTOCOLS)
ROBOT = NameType(lambda: ROBOTS)
PATH = click.Path(path_type=Path)
FILE = click.Path(path_type=Path, dir_okay=False)
FOLDER = click.Path(path_type=Path, file_okay=False)

path_argument = partial(click.argument, type=PATH)
path_option = partial(click.option, type=PATH)
file_option = partial(click.option, type=FILE)
folder_option = partial(click.option, type=FOLDER)
flag_option = partial(click.option, is_flag=True)
count_option = partial(click.option, type=click.IntRange(1))
dataset_option = partial(click.option, "--dataset", type=DATASET, default="barn300")
source_argument = click.argument("source", type=DATASET, default="barn300")
folder_argument = path_argument("folder")
folders_argument = path_argument("folders", nargs=-1, required=True)
quiet_option = flag_option("-q", "--quiet", help="Show warnings only, no progress.")
verbose_option = flag_option("-v", "--verbose", help="Show a line for each trial.")
json_option = flag_option("--json", "as_json", help="Print JSON instead of tables.")
worlds_option = click.option(
    "--worlds",
    "select",
    default="all",
    help="Numbers of the worlds to use, such as 0-49.",
)

robot_option = click.option(
    "--robot",
    type=ROBOT,
    default="jackal",
    help="Robot that drives: a name (see barn robots) or a YAML file.",
)


def field_option(
    config: object, name: str, default: str = "", short: str = "", kind: Any = None
) -> Decorator[Any]:
    """Return a decorator that adds an option --NAME for a configuration's field.

    Args:
        config: A configuration with its default values.
        name: Name of the field and, with two dashes, of the option.
        default: What the help says of the default. By default, its value.
        short: Short name of the option, such as "-w".
        kind: Type of the value. By default, that of the field.
    """
    quantity, value = next(
        (quantity, value)
        for field, quantity, value in fields_of(config)
        if field == name
    )
    # click reads numbers and texts by the type of the default.
    kind = kind or type(value)
    if quantity.choices:
        kind = click.Choice(quantity.choices)
    elif kind is int and quantity.minimum is not None and quantity.maximum is not None:
        kind = click.IntRange(int(quantity.minimum), int(quantity.maximum))
    # Descriptions begin with a small letter, as tables show them.
    meaning = quantity.description[:1].upper() + quantity.description[1:]
    help_text = f"{meaning} [default: {default or value}]."
    if not (default or value):
        help_text = f"{meaning}."
    names = filter(None, (short, f"--{name.replace('_', '-')}"))
    return click.option(*names, type=kind, help=help_text)


def parameters_option(
    option: str,
    name: str,
    meaning: str,
    config: object = None,
    *,
    metavar: str = "KEY=VALUE",
) -> Decorator[Any]:
    """Return a decorator that adds a repeatable KEY=VALUE option, read as one mapping.

    Args:
        option: The option, such as "--set".
        name: Argument of the command.
        meaning: First words of the help.
        config: Configuration whose parameters the help lists.
        metavar: Form of a value in the help; the part after = is read as YAML.
    """
    help_text = f"{meaning}; repeatable."
    if config is not None:
        keys = [key for key, _, _ in fields_of(config)]
        # Many names would push the other options off the screen.
        if len(keys) > _MAX_HELP_KEYS:
            help_text += " --help-keys lists them."
        else:
            help_text += f" Keys: {', '.join(keys)}."

    def parse(
        _: click.Context, __: click.Parameter, texts: tuple[str, ...]
    ) -> dict[str, Any]:
        """Return KEY=VALUE texts as a mapping, with values read as YAML."""
        return parse_parameters(texts, option)

    return click.option(
        option,
        name,
        multiple=True,
        metavar=metavar,
        callback=parse,
        help=help_text,
        cls=_ParametersOption,
        config=config,
    )


class _ParametersOption(click.Option):
    """A repeatable option KEY=VALUE for the parameters of a configuration."""

    def __init__(self, *names: Any, config: object = None, **attributes: Any):
        """Make an option; `config` has the parameters with their defaults."""
        super().__init__(*names, **attributes)
        self.config = config


def _print_keys(context: click.Context, _: click.Parameter, is_requested: bool) -> None:
    """If --help-keys is given, print each KEY=VALUE option's keys, and exit."""
    # Completion parses half a line and must neither print nor exit.
    if not is_requested or context.resilient_parsing:
        return
    for parameter in context.command.params:
        if isinstance(parameter, _ParametersOption) and parameter.config is not None:
            console.print(
                quantities_table(parameter.config, f"{parameter.opts[0]} KEY")
            )
    context.exit()


help_keys_option = flag_option(
    "--help-keys",
    is_eager=True,
    expose_value=False,
    callback=_print_keys,
    help="Show the keys of all KEY=VALUE options, with defaults and meanings.",
)


def _parse_run_options(
    _: click.Context, __: click.Parameter, texts: tuple[str, ...]
) -> dict[str, Any]:
    """Return --run KEY=VALUE texts as options of a run, with values read as YAML.

    "ros.KEY" and "simulator.KEY" become mappings; ConfigError if such a mapping is
    given as well.
    """
    options: dict[str, Any] = {}
    parameters = parse_parameters(texts, "--run")
    for key, value in parameters.items():
        group, _dot, name = key.partition(".")
        # Only these two are nested. Other dots belong to planner parameters.
        if name and group in ("ros", "simulator"):
            if group in parameters:
                raise ConfigError(
                    f"--run {key}: cannot be combined with --run {group}=...; "
                    f"give either {group}=... or single {group}.KEY=VALUE"
                )
            options.setdefault(group, {})[name] = value
        else:
            options[key] = value
    return options


run_option = click.option(
    "--run",
    multiple=True,
    metavar="KEY=VALUE",
    callback=_parse_run_options,
    help="Any other key of a barn run file, such as dataset, repetitions, seed, workers or ros.lockstep; repeatable.",
)


def _read_course(text: str) -> tuple[float, ...]:
    """Return the 5 or 6 numbers of "X,Y,YAW:X,Y[,YAW]" [m, rad], or raise ConfigError."""
    start, _, goal = text.partition(":")
    start_texts = start.split(",")
    goal_texts = goal.split(",")
    numbers = tuple(map(parse_number, start_texts + goal_texts))
    is_finite = all(map(math.isfinite, numbers))
    # A sixth number is the yaw at the goal.
    if len(start_texts) != 3 or len(numbers) not in (5, 6) or not is_finite:
        raise ConfigError(
            f"--course {format_value(text)}: must be X,Y,YAW:X,Y, the start and goal in"
            " m and rad"
        )
    return numbers


_course_option = partial(
    click.option, "--course", type=_read_course, metavar="X,Y,YAW:X,Y"
)
_COURSE_HELP = "Start and goal in every world, in m and rad [default: those of the world, otherwise of the protocol]"
course_option = _course_option(help=f"{_COURSE_HELP}.")
courses_option = _course_option(
    multiple=True,
    help=f"{_COURSE_HELP}; repeatable: each course is then counted as a separate world.",
)


def make_console_reporter(quiet: bool, verbose: bool) -> ConsoleReporter:
    """Return a reporter to standard error by -q and -v; UsageError if both are set.

    Raises:
        click.UsageError: If both are set.
    """
    if quiet and verbose:
        raise click.UsageError("--quiet and --verbose cannot be used together")
    if quiet:
        return ConsoleReporter(notes, Verbosity.QUIET)
    if verbose:
        return ConsoleReporter(notes, Verbosity.VERBOSE)
    return reporter


def split_names(text: str) -> tuple[str, ...]:
    """Return the names in a comma-separated text, stripped, without empty ones."""
    names = (name.strip() for name in text.split(","))
    return tuple(name for name in names if name)


def print_json(content: object) -> None:
    """Print plain data as JSON to standard output; NaN and infinity become null."""
    click.echo(json.dumps(make_json_safe(content), indent=1, allow_nan=False))


def print_output(as_json: bool, content: object, *renderables: object) -> None:
    """Print `content` as JSON, or else lines and tables, to standard output.

    Args:
        as_json: Whether to print `content` instead of `renderables`.
        content: Plain data.
        renderables: Lines and tables.
    """
    if as_json:
        print_json(content)
    else:
        console.print(*renderables, sep="\n")


@contextmanager
def progress_bar(text: str) -> Iterator[Callable[[float], None]]:
    """Show a bar if on a terminal; yield a function to call with the share done, 0-1."""
    # A bar in a file or pipe would be noise.
    with Progress(console=notes, transient=True, disable=not notes.is_terminal) as bar:
        task = bar.add_task(text, total=1.0)
        yield lambda share: bar.update(task, completed=share)


def print_notes(*lines: object) -> None:
    """Print each line to standard error, without control characters or wrapping."""
    for line in lines:
        # A path may have brackets, and must stay in one line to be copied.
        notes.print(strip_controls(str(line)), markup=False, soft_wrap=True)
