"""`barn demo`: three trials over ROS, to see that all is there."""

from pathlib import Path

import click

from barn_eval.commands.options import FOLDER, json_option, say
from barn_eval.commands.run import carry_out
from barn_eval.experiments.request import read_request
from barn_eval.experiments.ros_config import MODES
from barn_worlds.worlds.dataset import open_dataset

SHARES = (5, 40, 70)  # percent of the worlds that are easier; they are numbered by difficulty


@click.command("demo")
@click.option("--dataset", default="barn300", help="Data set that the three worlds are from.")
@click.option("--mode", type=click.Choice(MODES), default="ros", help="One process or ROS nodes.")
@click.option("--out", default="out/demo", type=FOLDER, help="Results.")
@json_option
def command(dataset: str, mode: str, out: Path, as_json: bool) -> int:
    """Drive an easy, a medium and a harder world under DWA with the challenge's protocol, and show the scores.

    Simulator, planner and evaluator are three ROS 2 nodes in processes of their own. Earlier results in the folder are
    replaced.
    """
    indices = open_dataset(dataset).indices
    worlds = ",".join(str(indices[len(indices) * share // 100]) for share in SHARES)
    say(f"worlds {worlds} of {dataset}")
    kept = {"bags": "all", "pictures": True, "workers": 1, "trial_limit_s": 0.0}
    request = read_request(None, {"dataset": dataset, "worlds": worlds, "mode": mode, "out": out} | kept)
    return carry_out(request, overwrite=True, as_json=as_json)
