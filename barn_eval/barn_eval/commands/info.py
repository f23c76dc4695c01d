"""`barn info`: what is installed, and what is off and why."""

import click

from barn_eval import suite
from barn_eval.commands.options import json_option, tell
from barn_eval.commands.tables import table


@click.command("info")
@json_option
def command(as_json: bool) -> None:
    """Show what is installed, which ROS there is, and which optional parts are off and why."""
    content = suite.info()
    number, plus, changes = content["commit"].partition("+")  # in the length that fits a terminal; --json has all
    installed = [*content["versions"].items(), ("commit", number[:12] + plus + changes or "not known")]
    parts = [(suite.OPTIONAL[name][0], state) for name, state in content["optional"].items()]
    ros = content["ros"].items()
    folders = {name: value.split(":") if name.endswith("_PATH") else [value] for name, value in ros}
    parts += [(name, one[0] or "not set" if len(one) == 1 else f"{len(one)} folders") for name, one in folders.items()]
    parts.append(("machine", f"{content['machine']['processor']}, {content['machine']['cores']} cores"))
    parts += [("planners", ", ".join(content["planners"])), ("data sets", ", ".join(content["data_sets"]))]
    tell(as_json, content, table(("installed", "version"), installed), table(("part", "state"), parts))
