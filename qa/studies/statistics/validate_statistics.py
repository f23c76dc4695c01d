"""Check by simulation that the suite's intervals and tests keep what they promise.

    python qa/studies/statistics/validate_statistics.py --out docs/statistics.md

Simulated trials are judged by the functions that reports use, with two seeds: --seed
and the next. It takes some minutes. The exit code is 1 if a share is further from its
target than chance explains. `--out` writes the page of the documentation and, beside
it, statistics.csv with every check; a file ranking.json there (`ranking_power.py
--json`) gives the page its table of rankings.
"""

import csv
import json
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path

import click
import jinja2
import numpy as np
from ranking_power import RankingPower, ranking_table
from rich.console import Console
from simulated_checks import GROUPS, CheckGroup

from barn_eval.analysis.verdict import FEW_WORLDS
from barn_metrics.bootstrap import number
from barn_worlds.base.config import from_dict
from barn_worlds.base.files import markdown_table, read_json, write_durably

SIMULATIONS = 400
SEEDS = 2
_MAX_ERRORS = 3.0  # standard errors that chance explains
_TEMPLATE = Path(__file__).with_name("statistics.md")


@dataclass(frozen=True)
class Check:
    """How often an event came in simulations of a setting, and how often it may."""

    event: str
    setting: str
    simulations: int
    # Share of the simulations with each seed.
    shares: tuple[float, ...]
    # Least and greatest share allowed.
    target: tuple[float, float]

    @property
    def standard_error(self) -> float:
        """The Monte Carlo standard error of the shares."""
        return max(self._error(share) for share in self.shares)

    @property
    def conclusion(self) -> str:
        """Return "met", "met within chance" or "missed", with all seeds."""
        low, high = self.target
        worst = max(self.shares, key=lambda share: max(low - share, share - high))
        if low <= worst <= high:
            return "met"
        # The error at the limit counts: that of a share of 0 would be 0.
        limit = low if worst < low else high
        if abs(worst - limit) <= _MAX_ERRORS * self._error(limit):
            return "met within chance"
        return "missed"

    def _error(self, share: float) -> float:
        return math.sqrt(share * (1.0 - share) / self.simulations)


def run_checks(
    simulations: int = SIMULATIONS, *, seed: int = 0, groups: Sequence[CheckGroup] = ()
) -> Iterator[Check]:
    """Run checks one by one.

    Args:
        simulations: Number per check and seed.
        seed: All randomness comes from it and the next.
        groups: Kinds of checks; all by default.

    Yields:
        Each check with its shares.
    """
    for group in groups or GROUPS.values():
        for setting in group.settings:
            shares = tuple(
                _simulate_share(group, setting, simulations, check_seed)
                for check_seed in range(seed, seed + SEEDS)
            )
            text = group.setting_text.format(*setting)
            yield Check(group.event, text, simulations, shares, group.target)


def _simulate_share(
    group: CheckGroup, setting: Sequence[float], simulations: int, seed: int
) -> float:
    # Each check has draws of its own, whatever other checks run.
    setting_key = [round(1000 * value) for value in setting]
    generator = np.random.default_rng([seed, *group.event.encode(), *setting_key])
    events = (group.simulate(*setting, generator) for _ in range(simulations))
    return math.fsum(events) / simulations


def make_table(checks: Sequence[Check], seed: int) -> str:
    """Return a table of shares and targets in percent, as Markdown.

    Args:
        checks: Checks with the same numbers of simulations and seeds.
        seed: The first seed.

    Returns:
        A row for each check.
    """
    seeds = range(seed, seed + len(checks[0].shares))
    columns = (
        "in simulations",
        "of",
        *(f"seed {run_seed} [%]" for run_seed in seeds),
        "error [%]",
        "wanted [%]",
        "",
    )
    rows = [
        (
            check.event,
            check.setting,
            *(number(100.0 * share, 1) for share in check.shares),
            number(100.0 * check.standard_error, 1),
            f"{100.0 * check.target[0]:g} to {100.0 * check.target[1]:g}",
            check.conclusion,
        )
        for check in checks
    ]
    return markdown_table(columns, rows)


def summarize(checks: Sequence[Check], seed: int) -> str:
    """Return a Markdown table with one row per kind of check.

    Args:
        checks: Checks of one kind in a row, with the same seeds.
        seed: The first seed.

    Returns:
        The range of shares over the settings of each kind, in percent.
    """
    seeds = range(seed, seed + len(checks[0].shares))
    columns = (
        "in simulations",
        "settings",
        *(f"seed {run_seed} [%]" for run_seed in seeds),
        "wanted [%]",
        "conclusion",
    )
    rows = []
    for event, members in groupby(checks, key=lambda check: check.event):
        kind = list(members)
        ranges = [
            f"{number(100.0 * min(shares), 1)} to {number(100.0 * max(shares), 1)}"
            for shares in zip(*(check.shares for check in kind), strict=True)
        ]
        low, high = kind[0].target
        # The worst one counts: the words come in this order in the alphabet, too.
        conclusion = max(check.conclusion for check in kind)
        wanted = f"{100.0 * low:g} to {100.0 * high:g}"
        rows.append((event, str(len(kind)), *ranges, wanted, conclusion))
    return markdown_table(columns, rows)


def write_checks(path: Path, checks: Sequence[Check], seed: int) -> None:
    """Write every check as a row of a CSV file; `seed` is the first seed."""
    seeds = range(seed, seed + len(checks[0].shares))
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        shares = [f"share_seed_{run_seed}" for run_seed in seeds]
        head = ("event", "setting", "simulations", *shares)
        writer.writerow((*head, "standard_error", "low", "high", "conclusion"))
        for check in checks:
            row = (check.event, check.setting, check.simulations, *check.shares)
            error = f"{check.standard_error:.4f}"
            writer.writerow((*row, error, *check.target, check.conclusion))


def read_checks(path: Path) -> list[Check]:
    """Return the checks of a CSV file that `write_checks` has written."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    checks = []
    for row in rows:
        shares = tuple(
            float(value) for name, value in row.items() if name.startswith("share_")
        )
        target = (float(row["low"]), float(row["high"]))
        simulations = int(row["simulations"])
        checks.append(Check(row["event"], row["setting"], simulations, shares, target))
    return checks


def render_page(
    checks: Sequence[Check], seed: int, rankings: Path | None = None
) -> str:
    """Return docs/statistics.md.

    Args:
        checks: All checks.
        seed: Their first seed.
        rankings: JSON of `ranking_power.py`, for a second table.

    Returns:
        The page as Markdown.
    """
    ranking = ""
    if rankings is not None and rankings.exists():
        powers = []
        for content in read_json(rankings):
            # Keys of JSON are texts.
            shares = {int(worlds): share for worlds, share in content["shares"].items()}
            content["shares"] = shares
            powers.append(from_dict(RankingPower, content, str(rankings)))
        table = ranking_table(powers)
        ranking = markdown_table(table.columns, table.rows)

    template = jinja2.Template(
        _TEMPLATE.read_text("utf-8"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    page: str = template.render(
        few_worlds=FEW_WORLDS,
        simulations=checks[0].simulations,
        seed=seed,
        table=summarize(checks, seed),
        ranking=ranking,
    )
    return page


@click.command()
@click.option(
    "--simulations",
    default=SIMULATIONS,
    show_default=True,
    type=click.IntRange(10, 1_000_000),
    help="Number per check and seed.",
)
@click.option("--seed", default=0, show_default=True, help="Seed of all randomness.")
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write the page of the documentation.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def main(simulations: int, seed: int, out: Path | None, as_json: bool) -> None:
    """Check by simulation that intervals and tests keep what they promise.

    All checks run with two seeds, --seed and the next, and their table is printed. The
    exit code is 1 if a share is further from its target than chance explains.
    """
    checks = []
    with Console(stderr=True).status("simulating") as status:
        for check in run_checks(simulations, seed=seed):
            checks.append(check)
            status.update(f"simulated: {check.event}, {check.setting}")

    if as_json:
        rows = [
            {
                **asdict(check),
                "standard_error": check.standard_error,
                "conclusion": check.conclusion,
            }
            for check in checks
        ]
        content = {"simulations": simulations, "seed": seed, "checks": rows}
        click.echo(json.dumps(content, indent=1))
    else:
        click.echo(make_table(checks, seed))
    if out is not None:
        rankings = out.with_name("ranking.json")
        write_checks(out.with_suffix(".csv"), checks, seed)
        write_durably(out, render_page(checks, seed, rankings).encode())
    sys.exit(any(check.conclusion == "missed" for check in checks))


if __name__ == "__main__":
    main()
