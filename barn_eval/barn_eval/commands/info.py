"""`barn info`: what is installed, and what is off and why."""

import os
import subprocess
import sys
from importlib.util import find_spec
from typing import Any

import click

from barn_eval.commands.options import console, json_option, print_json, table
from barn_eval.experiments.provenance import commit, machine, versions

# Module: (what needs it, what is off without it).
OPTIONAL: dict[str, tuple[str, str]] = {
    "rclpy": ("ROS mode and nodes", "only direct mode works; install the ROS 2 wheels or source ROS 2 Jazzy"),
    "tf2_msgs": ("/tf and /tf_static", "the simulator does not publish transforms; a full ROS 2 installation has it"),
    "torch": ("training of difficulty models", "only the shipped weights work; pip install torch==2.13.0"),
    "ray": ("campaigns on a cluster", "--engine ray is off; pip install ray"),
}


@click.command()
@json_option
def info(as_json: bool) -> None:
    """Show what is installed, which ROS there is, and which optional parts are off and why."""
    from barn_planners.registry import planner_names  # noqa: PLC0415
    from barn_worlds.dataset import shipped  # noqa: PLC0415

    content: dict[str, Any] = {
        "versions": versions(),
        "commit": commit(),
        "machine": machine(),
        "ros": _ros(),
        "optional": {
            name: "on" if find_spec(name) else f"off: {name} is not installed; {remedy}"
            for name, (_, remedy) in OPTIONAL.items()
        },
        "planners": planner_names(),
        "data_sets": list(shipped()),
    }
    if as_json:
        print_json(content)
        return
    installed = [*content["versions"].items(), ("commit", content["commit"] or "not known")]
    parts = [(OPTIONAL[name][0], state) for name, state in content["optional"].items()]
    parts += [(name, value or "not set") for name, value in content["ros"].items()]
    parts.append(("machine", f"{content['machine']['processor']}, {content['machine']['cores']} cores"))
    parts += [("planners", ", ".join(content["planners"])), ("data sets", ", ".join(content["data_sets"]))]
    console.print(table(("installed", "version"), installed), table(("part", "state"), parts))


def _ros() -> dict[str, str]:
    """Return what of ROS there is, as text."""
    names = ("ROS_DISTRO", "RMW_IMPLEMENTATION", "ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "AMENT_PREFIX_PATH")
    found = {name: os.environ.get(name, "") for name in names}
    if find_spec("rclpy") is not None:
        found["middleware"] = _middleware()
    return found


def _middleware() -> str:
    """Return the name of ROS's middleware, or why it does not load; asked in a process that may well crash."""
    asked = "import rclpy; print(rclpy.get_rmw_implementation_identifier())"
    done = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, timeout=60, check=False)  # noqa: S603
    if done.returncode == 0:
        return done.stdout.strip()
    reason = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
    return f"does not load: {reason[-1]}"
