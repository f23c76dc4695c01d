"""Whether intervals and tests keep what they promise: simulated trials, judged by the functions that reports use."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from barn_eval.analysis.ranking_power import RankingPower, ranking_table
from barn_eval.analysis.text_table import TextTable
from barn_eval.analysis.verdict import FEW_WORLDS
from barn_eval.pages.template import render
from barn_eval.studies.simulations import GROUPS, Group
from barn_metrics.bootstrap import number
from barn_worlds.base.config import from_dict
from barn_worlds.base.text_files import markdown_table, read_json

SIMULATIONS, SEEDS = 400, 2
_CHANCE = 3.0  # standard errors


@dataclass(frozen=True)
class Check:
    """How often something came in simulations, and how often it should. what: is counted; setting: of the trials.

    found: shares, one for each seed.
    """

    what: str
    setting: str
    simulations: int
    found: tuple[float, ...]
    wanted: tuple[float, float]

    @property
    def standard_error(self) -> float:
        """The Monte Carlo standard error of what was found with one seed."""
        return max(
            math.sqrt(one * (1.0 - one) / self.simulations) for one in self.found
        )

    @property
    def verdict(self) -> str:
        """Whether it is as wanted, with all seeds: "met", "met within chance" or "missed"."""
        low, high = self.wanted
        worst = max(self.found, key=lambda one: max(low - one, one - high))
        if low <= worst <= high:
            return "met"
        # The error of a share at the limit, as that of one that is found to be 0 is 0.
        limit = low if worst < low else high
        error = math.sqrt(limit * (1.0 - limit) / self.simulations)
        return (
            "met within chance" if abs(worst - limit) <= _CHANCE * error else "missed"
        )


def validate(
    simulations: int = SIMULATIONS, *, seed: int = 0, groups: Sequence[Group] = ()
) -> Iterator[Check]:
    """Yield how often simulated intervals cover the truth and simulated tests raise a false alarm, check by check.

    Args:
        simulations: So many per check.
        seed: All randomness comes from it and the next: each check is made with both.
        groups: Kinds of checks. Default: all.
    """
    for group in groups or GROUPS.values():
        for setting in group.settings:
            found = []
            for own in range(seed, seed + SEEDS):
                generator = np.random.default_rng(
                    [
                        own,
                        *group.what.encode(),
                        *map(round, (1000 * x for x in setting)),
                    ]
                )
                found.append(
                    sum(group.once(*setting, generator) for _ in range(simulations))
                    / simulations
                )
            yield Check(
                group.what,
                group.setting.format(*setting),
                simulations,
                tuple(found),
                group.wanted,
            )


def checks_table(found: Sequence[Check], seed: int) -> TextTable:
    """Return what was found beside what was wanted, in percent."""
    by_seed = [f"seed {own} [%]" for own in range(seed, seed + len(found[0].found))]
    columns = ("in simulations", "of", *by_seed, "error [%]", "wanted [%]", "")
    rows = [
        (
            one.what,
            one.setting,
            *(number(100.0 * share, 1) for share in one.found),
            number(100.0 * one.standard_error, 1),
            f"{100.0 * one.wanted[0]:g} to {100.0 * one.wanted[1]:g}",
            one.verdict,
        )
        for one in found
    ]
    return TextTable(
        "validation",
        f"{found[0].simulations} simulations each",
        columns,
        tuple(rows),
        texts=2,
    )


def statistics_page(
    found: Sequence[Check], seed: int, rankings: Path | None = None
) -> str:
    """Return docs/statistics.md, with tables of what was found and of what `barn precision --ranking --json` says."""
    made = checks_table(found, seed)
    powers = read_json(rankings) if rankings and rankings.exists() else []
    shares = (
        {int(n): share for n, share in one["shares"].items()} for one in powers
    )  # keys of JSON are texts
    read = (one | {"shares": own} for one, own in zip(powers, shares, strict=True))
    ranked = ranking_table(
        [from_dict(RankingPower, one, str(rankings)) for one in read]
    )
    return render(
        "statistics.md",
        few_worlds=FEW_WORLDS,
        simulations=found[0].simulations,
        seed=seed,
        table=markdown_table(made.columns, made.rows),
        ranking=markdown_table(ranked.columns, ranked.rows) if powers else "",
    )
