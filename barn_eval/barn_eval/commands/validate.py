"""`barn validate`: whether the suite's intervals and tests keep what they promise, by simulation."""

from dataclasses import asdict
from pathlib import Path

import click

from barn_eval.commands.options import FOLDER, SEED, console, json_option, notes, print_json, rich_table


@click.command()
@click.option(
    "--simulations", default=1000, show_default=True, type=click.IntRange(10, 1_000_000), help="So many per check."
)
@click.option("--seed", default=0, show_default=True, type=SEED, help="All randomness comes from it.")
@click.option("--docs", type=FOLDER, help="Folder that gets the page statistics.md as well.")
@json_option
def validate(simulations: int, seed: int, docs: Path | None, as_json: bool) -> int:
    """Simulate trials and count how often intervals cover the truth and tests raise a false alarm.

    About a minute. Exit code 1 if something is further from what it should be than chance explains.
    """
    from barn_eval.pages.page import write_page  # noqa: PLC0415 (worlds and their kernels)
    from barn_eval.studies.validation import checks, checks_table, statistics_page  # noqa: PLC0415 (scipy)

    found = []
    with notes.status("simulating") as status:
        for one in checks(simulations, seed):
            found.append(one)
            status.update(f"simulated: {one.what}, {one.setting}")
    if as_json:
        rows = [asdict(one) | {"standard_error": one.standard_error, "verdict": one.verdict} for one in found]
        print_json({"simulations": simulations, "seed": seed, "checks": rows})
    else:
        console.print(rich_table(checks_table(found)))
    if docs is not None:
        write_page(docs / "statistics.md", statistics_page(found, seed))
    return int(any(one.verdict == "missed" for one in found))
