"""`barn info`: what is installed, and what is off and why."""

import click

from barn_eval import suite
from barn_eval.commands.options import console, json_option, print_json, table


@click.command()
@json_option
def info(as_json: bool) -> None:
    """Show what is installed, which ROS there is, and which optional parts are off and why."""
    content = suite.info()
    if as_json:
        print_json(content)
        return
    installed = [*content["versions"].items(), ("commit", content["commit"] or "not known")]
    parts = [(suite.OPTIONAL[name][0], state) for name, state in content["optional"].items()]
    parts += [(name, value or "not set") for name, value in content["ros"].items()]
    parts.append(("machine", f"{content['machine']['processor']}, {content['machine']['cores']} cores"))
    parts += [("planners", ", ".join(content["planners"])), ("data sets", ", ".join(content["data_sets"]))]
    console.print(table(("installed", "version"), installed), table(("part", "state"), parts))
