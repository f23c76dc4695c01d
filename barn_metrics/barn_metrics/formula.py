"""The variants of the metrics: as published, corrected, or as described in the paper's text."""

from dataclasses import dataclass

from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import ConfigError, suggest


@dataclass(frozen=True)
class Formula(Checked):
    """The variants of the metrics on which the paper's text and its published numbers differ.

    The defaults are the corrected formula. Closest obstacle and tortuosity have one form only.
    """

    visibility: str = quantity(
        "corrected",
        "corrected: every ray counts, a diagonal cell is worth sqrt 2; published: every cell is worth 1, "
        "rays that leave the grid do not count, the mean over the rays is rounded down",
        choices=("corrected", "published"),
    )
    dispersion: str = quantity(
        "published",
        "published: four of the eight in-between rays reach 6 cells far, the others 4; even: all of them 4; "
        "ordered: as even, with the rays ordered by angle; the published order swaps two of them",
        choices=("published", "even", "ordered"),
    )
    axes: int = quantity(4, "axes of the characteristic dimension: 4 (published) or 8 (the paper's text)", minimum=4)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require(self.axes in (4, 8), "axes", "must be 4 or 8")


PUBLISHED = Formula(visibility="published")
CORRECTED = Formula()
PAPER_TEXT = Formula(dispersion="ordered", axes=8)

FORMULAS: dict[str, Formula] = {"published": PUBLISHED, "corrected": CORRECTED, "paper_text": PAPER_TEXT}


def as_formula(formula: Formula | str) -> Formula:
    """Return the formula of that name (a key of `FORMULAS`), or the formula itself; ConfigError names the near one."""
    if isinstance(formula, Formula):
        return formula
    if formula not in FORMULAS:
        raise ConfigError(f"unknown formula {formula!r}{suggest(formula, FORMULAS)}")
    return FORMULAS[formula]
