"""`barn info`: what is installed, and what is off and why."""

import click

from barn_eval import suite
from barn_eval.commands.options import console, json_option, print_json
from barn_eval.commands.tables import table


@click.command("info")
@json_option
def command(as_json: bool) -> None:
    """Show what is installed, which ROS there is, and which optional parts are off and why."""
    content = suite.info()
    if as_json:
        print_json(content)
        return
    installed = [*content["versions"].items(), ("commit", _short(content["commit"]) or "not known")]
    parts = [(suite.OPTIONAL[name][0], state) for name, state in content["optional"].items()]
    parts += [(name, _listed(value) or "not set") for name, value in content["ros"].items()]
    parts.append(("machine", f"{content['machine']['processor']}, {content['machine']['cores']} cores"))
    parts += [("planners", ", ".join(content["planners"])), ("data sets", ", ".join(content["data_sets"]))]
    console.print(table(("installed", "version"), installed), table(("part", "state"), parts))


def _listed(value: str) -> str:
    """Return how many folders a variable names if there are several, which fit no terminal; --json has them."""
    folders = value.split(":")
    return value if len(folders) == 1 else f"{len(folders)} folders"


def _short(commit: str) -> str:
    """Return a commit in the length that fits a terminal, with what is said of changes after it."""
    number, plus, changes = commit.partition("+")
    return number[:12] + plus + changes
