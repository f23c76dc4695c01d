"""`barn reproduce`, `validate` and `bench`: the suite beside the paper and theory, and its speed."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from barn_eval import suite
from barn_eval.commands.options import FILE, FOLDER, SEED, console, json_option, notes, print_json, say
from barn_eval.commands.tables import rich_table, table
from barn_eval.experiments.provenance import provenance

if TYPE_CHECKING:
    from barn_eval.studies.bench import Change


@click.command()
@click.option("--quick", is_flag=True, help="Part of the worlds, spread over their order by difficulty; minutes.")
@click.option("--out", type=FOLDER, help="Folder of trials and page [default: out/results, or out/results_quick].")
@click.option(
    "--campaign",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="A finished campaign of protocol paper2020 to take in place of own trials.",
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
    """Run the paper's 3000 trials and its experiment on new worlds, and write all of it up.

    OUT/results.md has Table II, times, failures, Figs. 6 and 8 and losses beside the published numbers,
    OUT/results.json every number. The same command goes on where it was interrupted, and when all is done writes the
    same bytes again.
    """
    for page in suite.reproduce(
        quick=quick, out=out, campaign=campaign, dataset=dataset, seed=seed, workers=workers, docs=docs
    ):
        say(page)


@click.command()
@click.option("--dataset", default="barn300", show_default=True, help="Data set that worlds are from.")
@click.option("--world", type=click.IntRange(0), help="World of the trials [default: the middle one].")
@click.option("--planners", default="dwa,eband", show_default=True, help="Planners to measure, joined by commas.")
@click.option(
    "--repeats", default=3, show_default=True, type=click.IntRange(1, 100), help="The best of so many counts."
)
@click.option("--ros/--no-ros", default=None, help="Measure a trial over ROS [default: if rclpy is installed].")
@click.option(
    "--against", type=FILE, help="Earlier result of --json from this machine: print how many times as good figures are."
)
@json_option
def bench(
    dataset: str, world: int | None, planners: str, repeats: int, ros: bool | None, against: Path | None, as_json: bool
) -> None:
    """Measure the speed of the suite on this machine, as ratios that can be followed over time.

    A figure that has become worse by more than its noise is called slower; the exit code stays 0.
    """
    before = suite.read_bench(against) if against is not None else []
    names = [name.strip() for name in planners.split(",")]
    with notes.status("measuring") as status:
        figures = list(suite.bench(dataset, world, names, repeats=repeats, ros=ros, note=status.update))
    about = provenance()
    compared = {one.name: one for one in suite.compare_bench(figures, before)}
    for change in compared.values():
        if change.slower:
            say(f"slower: {change.name}, {change.ratio:.2f} ± {change.noise:.2f} times as good as before")
    if as_json:
        print_json(
            {
                "schema_version": 1,
                "figures": [asdict(figure) for figure in figures],
                "changes": [{**asdict(one), "slower": one.slower} for one in compared.values()],
                **about,
            }
        )
        return
    machine = about["machine"]
    rows = [
        (figure.name, f"{figure.value:.3g}", figure.unit, *_compared(compared.get(figure.name))) for figure in figures
    ]
    title = f"{machine['processor']}, {machine['cores']} cores"
    console.print(table(("figure", ">value", "unit", ">times as good", ""), rows, title=title))


def _compared(change: Change | None) -> tuple[str, str]:
    if change is None:
        return "", ""
    return f"{change.ratio:.2f} ± {change.noise:.2f}", "slower" if change.slower else ""


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
    from barn_eval.pages.template import write_page  # noqa: PLC0415 (worlds and their kernels)
    from barn_eval.studies.validation import checks_table, statistics_page  # noqa: PLC0415 (scipy)

    found = []
    with notes.status("simulating") as status:
        for one in suite.validate(simulations, seed=seed):
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
