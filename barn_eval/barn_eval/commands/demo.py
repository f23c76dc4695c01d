"""`barn demo`: the suite at work, from ROS nodes to scores."""

from pathlib import Path

import click

from barn_eval.commands.options import FOLDER, SEED, json_option, say
from barn_eval.commands.run import DEFAULTS, carry_out_run
from barn_eval.experiments.ros_config import MODES


@click.command()
@click.option("--dataset", default="barn300", show_default=True, help="Data set that the three worlds are from.")
@click.option("--mode", type=click.Choice(MODES), default="ros", show_default=True, help="One process or ROS nodes.")
@click.option("--seed", default=0, show_default=True, type=SEED, help="Seed of the run.")
@click.option("--out", default="out/demo", show_default=True, type=FOLDER, help="Results.")
@json_option
def demo(dataset: str, mode: str, seed: int, out: Path, as_json: bool) -> None:
    """Drive an easy, a medium and a harder world under DWA with the paper's protocol, and show the scores.

    Simulator, planner and evaluator are three ROS 2 nodes in processes of their own. Earlier results in the folder are
    replaced.
    """
    from barn_eval.experiments.request import read_request  # noqa: PLC0415 (worlds and their kernels)
    from barn_worlds.dataset import open_dataset  # noqa: PLC0415

    indices = open_dataset(dataset).indices
    # Worlds are numbered by difficulty, easiest first.
    worlds = ",".join(str(indices[len(indices) * share // 100]) for share in (5, 40, 70))
    say(f"worlds {worlds} of {dataset}")
    asked = {"dataset": dataset, "worlds": worlds, "mode": mode, "seed": seed, "out": out}
    carry_out_run(read_request(None, DEFAULTS | asked), overwrite=True, dry_run=False, as_json=as_json)
