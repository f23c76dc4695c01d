"""`barn reproduce`: the paper's results from one command, ours beside the published ones."""

from pathlib import Path

import click

from barn_eval.commands.options import FOLDER, notes, say
from barn_worlds.config import replace_dotted


@click.command()
@click.option("--quick", is_flag=True, help="Part of the worlds, spread over their order by difficulty; minutes.")
@click.option("--out", type=FOLDER, help="Folder of trials and page [default: out/results, or out/results_quick].")
@click.option(
    "--campaign",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="A finished campaign of the paper protocol to take in place of own trials.",
)
@click.option("--dataset", help="Data set: a name, folder or file [default: barn300].")
@click.option("--seed", type=int, help="Seed of everything [default: 0].")
@click.option("--workers", type=int, default=0, help="Trials at a time [default: one per processor].")
@click.option("--docs", type=FOLDER, help="Write the page into this folder as well.")
def reproduce(
    quick: bool,
    out: Path | None,
    campaign: Path | None,
    dataset: str | None,
    seed: int | None,
    workers: int,
    docs: Path | None,
) -> None:
    """Run the paper's 3000 trials and its experiment on new worlds, train its model, and write all of it up.

    OUT/results.md has Table II, times, failures, Figs. 6 and 8 and losses beside the published numbers,
    OUT/results.json every number. The same command goes on where it was interrupted, and when all is done writes the
    same bytes again.
    """
    from barn_eval.experiments.experiment import Execution  # noqa: PLC0415 (simulator and planners)
    from barn_eval.studies.reproduction import run  # noqa: PLC0415 (the difficulty model)
    from barn_eval.studies.reproduction.config import QUICK, ReproduceConfig  # noqa: PLC0415
    from barn_eval.studies.reproduction.page import write_results  # noqa: PLC0415 (matplotlib)

    given = {name: value for name, value in (("dataset", dataset), ("seed", seed)) if value is not None}
    config = replace_dotted(QUICK if quick else ReproduceConfig(), given, "options")
    folder = out or Path("out") / ("results_quick" if quick else "results")
    findings, origin = run.reproduce(config, folder, Execution(workers=workers), notes, campaign)
    for target in (folder, *([docs] if docs else [])):
        say(write_results(findings, origin, target))
