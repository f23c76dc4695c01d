"""The `barn` command: subcommands that are imported when they are called, and errors of one line."""

import atexit
import gc
import os
import sys
from collections.abc import Sequence
from importlib import import_module

import click
from click.shell_completion import CompletionItem

from barn_eval import __version__
from barn_worlds.base.errors import BarnError, suggest

# What each does; the list of commands imports none of them.
COMMANDS = {
    "demo": "Drive three worlds under DWA over ROS 2 and show the scores.",
    "run": "Run trials of a planner and score them.",
    "campaign": "Run thousands of trials, resumed where they stopped.",
    "check": "Check that the files of a run or campaign belong together.",
    "compare": "Compare planners on the same worlds and seeds.",
    "watch": "Serve a page that shows how a campaign stands, as it runs.",
    "report": "Write runs and campaigns up as one HTML page.",
    "replay": "Draw trials from their bags: page, picture, GIF or film.",
    "reproduce": "Reproduce the paper's results beside its numbers.",
    "leaderboard": "Rank the planners of many campaigns, ties as ties.",
    "worlds": "Generate, sample, move, import, export, order, show and list worlds.",
    "robots": "List, show and check robots.",
    "show": "Draw a world, or trials over it.",
    "metrics": "Compute the five difficulty metrics of worlds.",
    "difficulty": "Train, judge and use a model of how difficult worlds are.",
    "precision": "Say how many worlds a wanted precision needs.",
    "validate": "Check intervals and tests by simulation.",
    "bench": "Measure the speed of the suite on this machine.",
    "info": "Show what is installed, and what is off and why.",
}
# The modules of those that are not in the module of their name.
_MODULES = {
    **dict.fromkeys(("demo", "campaign"), "run"),
    **dict.fromkeys(("check", "compare", "precision", "leaderboard", "report", "replay"), "results"),
    **dict.fromkeys(("reproduce", "validate", "bench"), "studies"),
    "show": "metrics",
}


_COLLECT_EVERY = 200_000  # new objects; looking for garbage more often took a sixth of the time of a report


class LazyGroup(click.Group):
    """A group of commands that imports only the one that is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Return the names of the commands."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Return a command, imported now."""
        if cmd_name not in COMMANDS:
            raise click.UsageError(f"unknown command {cmd_name!r}{suggest(cmd_name, COMMANDS)}")
        module = import_module(f"barn_eval.commands.{_MODULES.get(cmd_name, cmd_name)}")
        command: click.Command = getattr(module, cmd_name)
        return command

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Return what may come next; click's own way would import every command."""
        names = [CompletionItem(name, help=summary) for name, summary in COMMANDS.items()]
        options = click.Command.shell_complete(self, ctx, incomplete)
        return [item for item in names if item.value.startswith(incomplete)] + options

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """Write the list of commands."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


def _print_version(ctx: click.Context, _: click.Parameter, asked: bool) -> None:
    """Print the version, and the commit where the source is in a repository."""
    if asked and not ctx.resilient_parsing:
        commit = import_module("barn_eval.experiments.provenance").commit()
        click.echo(f"barn {__version__}" + (f" (commit {commit})" if commit else ""))
        ctx.exit()


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
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
    other than the planner failed. 130: interrupted.
    """
    gc.set_threshold(_COLLECT_EVERY)
    atexit.register(gc.freeze)  # or all that is left would be looked through once more
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
    except (BarnError, click.ClickException, OSError) as error:
        click.echo("error: " + " ".join(_message(error).split()), err=True)
        return 1
    return result if isinstance(result, int) else 0


def _message(error: BarnError | click.ClickException | OSError) -> str:
    if isinstance(error, click.UsageError):
        command = error.ctx.command_path if error.ctx else "barn"
        return f"{error.format_message()} (see {command} --help)"
    if isinstance(error, click.ClickException):
        return error.format_message()
    if isinstance(error, OSError) and error.filename:
        return f"{error.filename}: {error.strerror}"
    return str(error)
