"""Test non-inferiority: whether B is worse than A by at most a margin.

A difference that is not significant does not show this.
"""

from dataclasses import dataclass
from typing import Literal

from barn_eval.analysis.compare import Comparison
from barn_eval.analysis.measures import MEASURES
from barn_worlds.base.errors import ConfigError, format_value, parse_number, suggest

Decision = Literal["not worse", "worse", "not shown"]


@dataclass(frozen=True)
class Margin:
    """How much worse a measure may become."""

    measure: str
    """Key of the measure."""

    margin: float
    """In the unit of the measure, or a share of A's mean if `relative`."""

    relative: bool

    @classmethod
    def parse(cls, text: str) -> "Margin":
        """Parse "MEASURE:NUMBER" or "MEASURE:PERCENT%" of A; ConfigError if neither.

        Raises:
            ConfigError: If the text names no measure with a better direction, or the
                margin is neither a number from 0 nor a percentage.
        """
        key, _, size = text.partition(":")
        if key not in MEASURES or not MEASURES[key].better:
            keys = [measure.key for measure in MEASURES.values() if measure.better]
            raise ConfigError(
                f"--fail-if-worse: unknown measure {key!r}{suggest(key, keys)}"
            )
        # What is no number is NaN, which fails the check that follows.
        margin = parse_number(size.removesuffix("%"))
        if not 0.0 <= margin < float("inf"):
            rule = "must be MEASURE:MARGIN, with a number from 0 or a share such as 5%"
            raise ConfigError(
                f"--fail-if-worse {key}: {rule}, got {format_value(size)}"
            )
        # A percent sign always means a share of A's mean, also for shares.
        relative = size.endswith("%")
        return cls(key, margin / 100.0 if relative else margin, relative)


@dataclass(frozen=True)
class MarginTest:
    """The result of testing whether B is worse than A by more than a margin."""

    a: str
    b: str

    measure: str
    """Key of the measure, in whose unit the figures below are."""

    margin: float

    loss: float
    """How much worse B is on average."""

    low: float | None
    """Lower limit of the loss, None if there is none."""

    high: float | None

    # "not worse" if the 95% interval of the loss lies within the margin, "worse" if it
    # lies beyond the margin, else "not shown".
    decision: Decision

    @property
    def text(self) -> str:
        """A clause with decision, margin, measure and upper limit of the loss."""
        measure = MEASURES[self.measure]
        unit = " percentage points" if measure.percent else measure.after
        margin = f"{measure.number(self.margin)}{unit}"
        claim = f"{self.b} is not worse than {self.a} by more than {margin}"
        if self.decision == "worse":
            claim = f"{self.b} is worse than {self.a} by more than {margin}"
        elif self.decision == "not shown":
            claim = f"the data do not show that {claim}"

        limit = "unknown"
        if self.high is not None:
            limit = f"{measure.number(self.high)}{unit}"
        return f"{claim} ({measure.title}; upper limit of the loss: {limit})"


def decide_margin(comparison: Comparison, margin: Margin) -> MarginTest:
    """Test whether B is worse than A by more than a margin; it may stay undecided.

    Args:
        comparison: A and B, compared by at least the measure of the margin.
        margin: How much worse B may be.
    """
    row = comparison.row(margin.measure)
    loss = row.paired.difference
    if not row.larger_is_better:
        loss = loss.negate()
    limit = margin.margin
    if margin.relative:
        # A share of A's mean, because B's mean changes with what is tested.
        limit = margin.margin * abs(row.paired.mean_a)

    decision: Decision = "not shown"
    if loss.low is not None and loss.high is not None:
        # The whole interval must lie on one side: a lack of proof is no proof.
        if loss.high <= limit:
            decision = "not worse"
        elif loss.low > limit:
            decision = "worse"
    return MarginTest(
        a=comparison.a,
        b=comparison.b,
        measure=margin.measure,
        margin=limit,
        loss=loss.estimate,
        low=loss.low,
        high=loss.high,
        decision=decision,
    )
