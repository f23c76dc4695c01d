"""`barn worlds`: generate, sample, move, convert and list worlds."""

import click

from barn_eval.commands.group import LazyGroup

COMMANDS = {
    "generate": "Generate a data set.",
    "sample": "Write worlds of a wanted difficulty.",
    "move": "Generate worlds in which obstacles move.",
    "convert": "Read worlds of any format and write them in another, or in another order.",
    "list": "List data sets, the worlds of one, or how their obstacles move.",
}

command = LazyGroup("worlds", __name__, COMMANDS, "Generate, sample, move, convert and list worlds.")

robot_option = click.option(
    "--robot",
    default="jackal",
    show_default=True,
    help="Robot that paths are planned for: a name (see barn robots) or a YAML file.",
)
