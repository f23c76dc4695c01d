"""`barn bench`: the speed of the suite on this machine."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from barn_eval import suite
from barn_eval.commands.options import FILE, json_option, notes, say, settings_option, tell
from barn_eval.commands.tables import table
from barn_eval.experiments.run_file import provenance
from barn_eval.studies.bench import changes, read_figures


@click.command("bench")
@click.option("--planners", default="dwa,eband", help="Planners to measure, joined by commas.")
@settings_option("--set", "settings", "What is measured", suite.BenchSetup())
@click.option(
    "--against", type=FILE, help="Earlier result of --json from this machine: print how many times as good figures are."
)
@json_option
def command(planners: str, settings: dict[str, Any], against: Path | None, as_json: bool) -> None:
    """Measure the speed of the suite on this machine, as ratios that can be followed over time.

    A figure that has become worse by more than its noise is called slower; the exit code stays 0.
    """
    before = read_figures(against) if against is not None else []
    names = [name.strip() for name in planners.split(",")]
    with notes.status("measuring") as status:
        figures = list(suite.bench(names, settings, note=status.update))
    about = provenance()
    compared = changes(figures, before)
    for change in compared:
        if change.slower:
            say(f"slower: {change.name}, {change.ratio:.2f} ± {change.noise:.2f} times as good as before")
    changed = [{**asdict(one), "slower": one.slower} for one in compared]
    content = {"schema_version": 1, "figures": list(map(asdict, figures)), "changes": changed, **about}
    ratios = {one.name: (f"{one.ratio:.2f} ± {one.noise:.2f}", "slower" if one.slower else "") for one in compared}
    rows = [(one.name, f"{one.value:.3g}", one.unit, *ratios.get(one.name, ("", ""))) for one in figures]
    title = f"{about['machine']['processor']}, {about['machine']['cores']} cores"
    tell(as_json, content, table(("figure", ">value", "unit", ">times as good", ""), rows, title=title))
