"""`barn reproduce`: the paper's results beside its numbers."""

from typing import Any

import click

from barn_eval import suite
from barn_eval.commands.options import FOLDER, say, settings_option
from barn_eval.studies.reproduction.findings import ReproduceConfig


@click.command("reproduce")
@click.option("--quick", is_flag=True, help="Part of the worlds, spread over their order by difficulty; minutes.")
@click.option("--out", type=FOLDER, help="Folder of trials and page [default: out/results, or out/results_quick].")
@settings_option("--set", "settings", "What is run", ReproduceConfig())
@click.option(
    "--workers",
    type=click.IntRange(0),
    default=0,
    show_default=False,
    help="Trials at a time [default: as processors].",
)
@click.option("--docs", type=FOLDER, help="Write the page into this folder as well.")
def command(**options: Any) -> None:
    """Run the paper's 3000 trials and write all of it up.

    OUT/results.md has Table II, times, failures, Fig. 6 and losses beside the published numbers,
    OUT/results.json every number. The same command goes on where it was interrupted, in OUT/campaign,
    and when all is done writes the same bytes again.
    """
    say(*suite.reproduce(**options))
