"""Groups of commands: each in a file of its own, imported when it is called."""

from collections.abc import Mapping
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import cast

import click
from click.shell_completion import CompletionItem

from barn_worlds.base.errors import suggest

PLUGINS = "barn_eval.commands"  # entry points of other packages that add a command
NAMES = {"help_option_names": ["-h", "--help"], "max_content_width": 110}


class LazyGroup(click.Group):
    """Commands by name, each the attribute `command` of a module of that name in a package.

    commands: name and summary of each, so that listing and completing them import none. aliases: further names.
    plugins: whether other packages may add commands.
    """

    def __init__(
        self,
        name: str,
        package: str,
        commands: Mapping[str, str],
        help: str,
        aliases: Mapping[str, str] | None = None,
        *,
        plugins: bool = False,
    ) -> None:
        super().__init__(name, help=help, context_settings=dict(NAMES))
        self.summaries = commands
        self._package, self._aliases, self._plugins = package, aliases or {}, plugins

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Return the names of the commands."""
        return [*self.summaries, *self._added()]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command:  # noqa: ARG002
        """Return a command, imported now."""
        name = self._aliases.get(cmd_name, cmd_name)
        if name in self.summaries:
            return cast(click.Command, import_module(f"{self._package}.{name}").command)
        added = self._added()
        if name not in added:
            raise click.UsageError(f"unknown command {name!r}{suggest(name, [*self.summaries, *added])}")
        return cast(click.Command, added[name].load())

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Return what may come next; click's own way would import every command."""
        names = [CompletionItem(name, help=summary) for name, summary in self._listed()]
        options = click.Command.shell_complete(self, ctx, incomplete)
        return [item for item in names if item.value.startswith(incomplete)] + options

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """Write the list of commands."""
        with formatter.section("Commands"):
            formatter.write_dl(self._listed())

    def _listed(self) -> list[tuple[str, str]]:
        return [*self.summaries.items(), *((name, f"Of {one.module}.") for name, one in self._added().items())]

    def _added(self) -> dict[str, EntryPoint]:
        """Return the commands of other packages."""
        return {one.name: one for one in entry_points(group=PLUGINS)} if self._plugins else {}
