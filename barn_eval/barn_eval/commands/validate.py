"""`barn validate`: intervals and tests, checked by simulation."""

from dataclasses import asdict
from pathlib import Path

import click

from barn_eval import suite
from barn_eval.commands.options import FILE, json_option, notes, seed_option, tell
from barn_eval.commands.tables import rich_table
from barn_eval.pages.template import write_page
from barn_eval.studies.validation import checks_table, statistics_page


@click.command("validate")
@click.option("--simulations", default=400, type=click.IntRange(10, 1_000_000), help="So many per check.")
@seed_option()
@click.option(
    "--out",
    type=FILE,
    help="Write the page of the documentation that says it, .md; with ranking.json beside it, that table as well.",
)
@json_option
def command(simulations: int, seed: int, out: Path | None, as_json: bool) -> int:
    """Simulate trials and count how often intervals cover the truth and tests raise a false alarm.

    By two seeds, this one and the next. Some minutes. Exit code 1 if something is further from what it should be than
    chance explains.
    """
    found = []
    with notes.status("simulating") as status:
        for one in suite.validate(simulations, seed=seed):
            found.append(one)
            status.update(f"simulated: {one.what}, {one.setting}")
    rows = [asdict(one) | {"standard_error": one.standard_error, "verdict": one.verdict} for one in found]
    content = {"simulations": simulations, "seed": seed, "checks": rows}
    tell(as_json, content, rich_table(checks_table(found, seed)))
    if out is not None:
        write_page(out, statistics_page(found, seed, out.with_name("ranking.json")))
    return int(any(one.verdict == "missed" for one in found))
