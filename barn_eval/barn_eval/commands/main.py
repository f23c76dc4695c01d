"""The `barn` command: subcommands that are imported when they are called, and errors of one line.

data/commands.json says of each what it does, with an example and where to read on.
"""

import json
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import cast

import click
from click.shell_completion import CompletionItem

from barn_eval import __version__
from barn_worlds.base.errors import BarnError, suggest
from barn_worlds.base.garbage import reduce_garbage_collection

_TOLD = json.loads(
    (Path(__file__).parents[1] / "data" / "commands.json").read_text("utf-8")
)
COMMANDS: dict[str, str] = {name: about for name, (about, _, _) in _TOLD.items()}
MORE: dict[str, tuple[str, str]] = {
    name: (example, page) for name, (_, example, page) in _TOLD.items()
}
# Where the verbs are that have no module of their own.
_BESIDE = {"demo": "run", "precision": "compare", "submit": "check", "verify": "check"}
_BESIDE |= dict.fromkeys(("reproduce", "bench", "info"), "suite")


def _print_version(ctx: click.Context, _: click.Parameter, asked: bool) -> None:
    """Print the version, and the commit where the source is in a repository."""
    if asked and not ctx.resilient_parsing:
        commit = import_module("barn_eval.results.run_file").commit()
        click.echo(f"barn {__version__}" + (f" (commit {commit})" if commit else ""))
        ctx.exit()


class LazyGroup(click.Group):
    """The verbs, most of them the attribute `command` of a module of their name, and those of other packages.

    None is imported before it is called: listing and completing them need only what the file says.
    """

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Return the names of the commands."""
        return [*COMMANDS, *_added()]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command:
        """Return a command, imported now."""
        name = {"campaign": "run"}.get(cmd_name, cmd_name)
        if name in COMMANDS:
            module = import_module(f"{__package__}.{_BESIDE.get(name, name)}")
            command = cast(
                click.Command, getattr(module, name if name in _BESIDE else "command")
            )
            command.epilog = "Example: {}\n\nMore: {} in the suite's repository".format(
                *MORE[name]
            )
            return command
        if name not in _added():
            raise click.UsageError(
                f"unknown command {name!r}{suggest(name, self.list_commands(ctx))}"
            )
        return cast(click.Command, _added()[name].load())

    def shell_complete(
        self, ctx: click.Context, incomplete: str
    ) -> list[CompletionItem]:
        """Return what may come next; click's own way would import every command."""
        names = [
            CompletionItem(name, help=summary)
            for name, summary in _listed()
            if name.startswith(incomplete)
        ]
        return names + click.Command.shell_complete(self, ctx, incomplete)

    def format_commands(
        self,
        ctx: click.Context,  # noqa: ARG002
        formatter: click.HelpFormatter,
    ) -> None:
        """Write the list of commands."""
        with formatter.section("Commands"):
            formatter.write_dl(_listed())


def _added() -> dict[str, EntryPoint]:
    """Return the commands of other packages."""
    return {one.name: one for one in entry_points(group="barn_eval.commands")}


def _listed() -> list[tuple[str, str]]:
    return [
        *COMMANDS.items(),
        *((name, f"Of {one.module}.") for name, one in _added().items()),
    ]


@click.group(
    cls=LazyGroup,
    context_settings={
        "help_option_names": ["-h", "--help"],
        "max_content_width": 110,
        "show_default": True,
    },
)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_version,
    help="Show version and commit.",
)
def cli() -> None:
    """Benchmark ground-robot navigation: worlds, metrics, trials and their scores."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command and exit.

    0: done. 1: a mistake in the input (told in one line). 3: done, but trials are left without a score, as something
    other than the planner failed, or no planner drove to the end of any. 130: interrupted.
    """
    reduce_garbage_collection()
    sys.exit(_exit_code(arguments))


def _exit_code(arguments: Sequence[str] | None) -> int:
    try:
        result = cli.main(args=arguments, prog_name="barn", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        return 0
    except (KeyboardInterrupt, click.Abort):
        click.echo("interrupted", err=True)
        return 130
    except BrokenPipeError:
        # Whoever read the output has gone; the interpreter would complain of it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (
        BarnError,
        click.ClickException,
        OSError,
        MemoryError,
        ImportError,
    ) as error:
        click.echo("error: " + " ".join(_message(error).split()), err=True)
        return 1
    return result if isinstance(result, int) else 0


def _message(
    error: BarnError | click.ClickException | OSError | MemoryError | ImportError,
) -> str:
    if isinstance(error, click.UsageError):
        command = error.ctx.command_path if error.ctx else "barn"
        return f"{error.format_message()} (see {command} --help)"
    if isinstance(error, click.ClickException):
        return error.format_message()
    if isinstance(error, OSError) and error.filename:
        return f"{error.filename}: {error.strerror}"
    return str(error) or "there is not enough memory"
