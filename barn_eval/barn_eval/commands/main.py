"""The `barn` command. A subcommand is imported when called; an error takes one line.

data/commands.json groups the subcommands by purpose and gives each a summary, an example,
a page, and the attribute MODULE:NAME that it is.
"""

import json
import os
import sys
import traceback
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import cast

import click
from click.shell_completion import CompletionItem

from barn_eval import __version__
from barn_worlds.base.errors import BarnError, ExitCode, join_lines, suggest
from barn_worlds.base.garbage import reduce_garbage_collection

_FILE = Path(__file__).parents[1] / "data" / "commands.json"
_GROUPS: dict[str, dict[str, list[str]]] = json.loads(_FILE.read_text("utf-8"))
_ENTRIES = {name: entry for group in _GROUPS.values() for name, entry in group.items()}

COMMANDS = {name: summary for name, (summary, *_) in _ENTRIES.items()}
"""Summary of each subcommand."""

MORE = {name: (example, page) for name, (_, example, page, _) in _ENTRIES.items()}
"""Example and page of each subcommand."""


class LazyGroup(click.Group):
    """The subcommands of the suite and of other packages.

    Listing and completing them imports none.
    """

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Return the names of all subcommands; those of other packages come last."""
        return [*COMMANDS, *_plugins()]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command:
        """Import and return a subcommand, with its example; UsageError if unknown.

        Args:
            ctx: Context of the call.
            cmd_name: Name of the subcommand.

        Raises:
            click.UsageError: If there is no such subcommand.
        """
        # The command had this name before, and scripts still use it.
        name = "run" if cmd_name == "campaign" else cmd_name
        if name in COMMANDS:
            _, example, page, place = _ENTRIES[name]
            module_name, _, attribute = place.partition(":")
            module = import_module(f"{__package__}.{module_name}")
            command = cast(click.Command, getattr(module, attribute))
            # click shows an epilog below the options, as an example should be.
            command.epilog = (
                f"Example: {example}\n\nMore: {page} in the suite's repository"
            )
            return command
        if name in _plugins():
            return cast(click.Command, _plugins()[name].load())
        raise click.UsageError(
            f"unknown command {name!r}{suggest(name, self.list_commands(ctx))}"
        )

    def shell_complete(
        self, ctx: click.Context, incomplete: str
    ) -> list[CompletionItem]:
        """Return completions of a word without importing any subcommand.

        Args:
            ctx: Context of the call.
            incomplete: Beginning of a word.
        """
        subcommands = []
        for name, summary in [*COMMANDS.items(), *_plugin_summaries()]:
            if name.startswith(incomplete):
                subcommands.append(CompletionItem(name, help=summary))
        return subcommands + click.Command.shell_complete(self, ctx, incomplete)

    def format_commands(
        self, ctx: click.Context, formatter: click.HelpFormatter
    ) -> None:
        """Write all subcommands with their summaries, by purpose, to a help page.

        Args:
            ctx: Context of the call.
            formatter: Takes the list.
        """
        width = max(map(len, self.list_commands(ctx)))
        for title, group in _GROUPS.items():
            with formatter.section(title):
                # Equal widths align the summaries of all groups.
                formatter.write_dl(
                    [(name.ljust(width), COMMANDS[name]) for name in group]
                )
        if _plugins():
            with formatter.section("Other packages"):
                formatter.write_dl(_plugin_summaries())


def _plugins() -> dict[str, EntryPoint]:
    """Return the entry points of other packages' subcommands by name, not loaded."""
    return {point.name: point for point in entry_points(group="barn_eval.commands")}


def _plugin_summaries() -> list[tuple[str, str]]:
    """Return (name, "From MODULE.") of each subcommand of other packages."""
    return [(name, f"From {point.module}.") for name, point in _plugins().items()]


def _print_version(ctx: click.Context, _: click.Parameter, is_requested: bool) -> None:
    """If --version is given, print version and known commit, and exit the command."""
    # Completion parses half a line and must neither print nor exit.
    if is_requested and not ctx.resilient_parsing:
        # Only here, because asking git takes longer than printing help.
        commit = import_module("barn_eval.results.provenance").commit()
        version = f"barn {__version__}"
        if commit:
            version += f" (commit {commit})"
        click.echo(version)
        ctx.exit()


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
    """Run the `barn` command and exit the process; arguments default to sys.argv's.

    `ExitCode` has the exit codes.
    """
    # Files name other files in UTF-8, which Python must expect of their names, too.
    # `-X utf8=0` would otherwise restart this for ever.
    is_restarted = os.environ.get("PYTHONUTF8") == "1"
    is_utf8 = is_restarted or sys.getfilesystemencoding() == "utf-8"
    if arguments is None and not is_utf8:
        os.environ["PYTHONUTF8"] = "1"
        utf8_mode = [sys.executable, "-X", "utf8", *sys.orig_argv[1:]]
        os.execv(sys.executable, utf8_mode)  # noqa: S606 (no shell)  # nosec B606
    reduce_garbage_collection()
    sys.exit(_run(arguments))


def _run(arguments: Sequence[str] | None) -> int:
    """Run `barn`; return its exit code. Errors are printed, in one line if expected."""
    try:
        # In standalone mode, click prints errors and exits with codes of its own.
        result = cli.main(args=arguments, prog_name="barn", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        return ExitCode.DONE
    except (KeyboardInterrupt, click.Abort):
        click.echo("interrupted", err=True)
        return ExitCode.INTERRUPTED
    except SystemExit as error:
        # click exits with 1 if the reader of the output is gone.
        if error.code == 1:
            return ExitCode.READER_GONE
        raise
    except (
        BarnError,
        click.ClickException,
        OSError,
        MemoryError,
        ImportError,
    ) as error:
        # Messages of YAML and libraries may have several lines.
        click.echo(f"error: {join_lines(_describe(error))}", err=True)
        return error.exit_code if isinstance(error, BarnError) else ExitCode.REFUSED
    except Exception:
        # A fault of the suite itself must not look like a finding.
        traceback.print_exc()
        return ExitCode.REFUSED
    return result if isinstance(result, int) else ExitCode.DONE


def _describe(error: Exception) -> str:
    """Return an error's message, with the command's --help or the file it names."""
    if isinstance(error, click.UsageError):
        command = error.ctx.command_path if error.ctx else "barn"
        return f"{error.format_message()} (see {command} --help)"
    if isinstance(error, click.ClickException):
        return error.format_message()
    if isinstance(error, OSError) and error.filename:
        return f"{error.filename}: {error.strerror}"
    return str(error) or "not enough memory"
