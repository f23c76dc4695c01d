"""What the paper concludes from its numbers, and whether ours bear it out: judged by intervals, not by eye."""

from __future__ import annotations

from dataclasses import dataclass

from barn_eval.studies import learning, paper
from barn_eval.studies.findings import Findings
from barn_eval.studies.transfer import Regression
from barn_eval.studies.verdict import above, below


@dataclass(frozen=True)
class Claim:
    """A conclusion of the paper, its number, ours with its interval, and the verdict."""

    text: str
    published: str
    ours: str
    verdict: str


def claims(findings: Findings) -> tuple[Claim, ...]:
    """Return the paper's conclusions in its order."""
    trials, transfer = findings.trials, findings.transfer
    of = paper.TRIALS
    dwa, eband = trials.of("dwa"), trials.of("eband")
    return (
        Claim(
            "DWA's times spread more over a world's trials than E-Band's",
            f"{of['dwa'].spread_s_per_m:.2f} and {of['eband'].spread_s_per_m:.2f} s/m",
            f"{dwa.spread_s_per_m.estimate:.2f} and {eband.spread_s_per_m.estimate:.2f} s/m,"
            f" difference {trials.spread_difference.text()}",
            above(trials.spread_difference),
        ),
        Claim(
            "DWA is more sensitive to difficulty: its time grows more from the easiest to the hardest tenth",
            f"{_rise(of['dwa']):.1f} and {_rise(of['eband']):.1f} s",
            f"{dwa.hard_s - dwa.easy_s:.1f} and {eband.hard_s - eband.easy_s:.1f} s,"
            f" difference {trials.steeper_s.text(1)}",
            above(trials.steeper_s),
        ),
        Claim(
            "high difficulty goes with high variance",
            "shown in Fig. 6",
            f"Spearman correlation of mean and spread over worlds {trials.spread_correlation.text()}",
            above(trials.spread_correlation),
        ),
        *(claim for one in transfer.figure for claim in _of_lines(one, "the worlds of Fig. 8")),
        *(claim for one in transfer.all_worlds for claim in _of_lines(one, "all that were driven")),
        Claim(
            "in new worlds of low difficulty and without a map, DWA is faster than E-Band",
            "shown in Fig. 8",
            "difference in the half that the suite's model predicts to be easier"
            f" {transfer.easiest_difference_s_per_m.text()} s/m",
            below(transfer.easiest_difference_s_per_m),
        ),
    )


def _of_lines(found: Regression, where: str) -> tuple[Claim, Claim]:
    both, slopes, title = found.lines["both"].slope, paper.SLOPES, learning.TITLES[found.model]
    return (
        Claim(
            f"higher predicted difficulty, longer time in new worlds: {title}, {where}",
            f"slope {slopes['both']:.2f}",
            f"slope {both.text()}, Spearman correlation {found.correlation.text()}",
            above(both),
        ),
        Claim(
            f"DWA's line is steeper than E-Band's: {title}, {where}",
            f"{slopes['dwa']:.2f} and {slopes['eband']:.2f}",
            f"{found.lines['dwa'].slope.estimate:.2f} and {found.lines['eband'].slope.estimate:.2f},"
            f" difference {found.steeper.text()}",
            above(found.steeper),
        ),
    )


def _rise(published: paper.PublishedTrials) -> float:
    return published.hard_s - published.easy_s
