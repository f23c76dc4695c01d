"""Is B no worse than A, by more than a margin: non-inferiority, which "cannot be told apart" does not show."""

from dataclasses import dataclass
from typing import Literal

from barn_eval.analysis.compare import Comparison
from barn_eval.analysis.measures import MEASURES
from barn_worlds.base.errors import ConfigError, format_value, suggest


@dataclass(frozen=True)
class Margin:
    """How much worse a measure, named by its key, may be: in its unit, or as a share of A's mean."""

    measure: str
    margin: float
    relative: bool

    @classmethod
    def parse(cls, text: str) -> "Margin":
        """Return the margin of a text such as "challenge:0.01" or "challenge:5%"; ConfigError for another."""
        key, _, size = text.partition(":")
        if key not in MEASURES or not MEASURES[key].better:
            known = [one.key for one in MEASURES.values() if one.better]
            raise ConfigError(
                f"--fail-if-worse: unknown measure {key!r}{suggest(key, known)}"
            )
        try:
            margin = float(size.removesuffix("%"))
        except ValueError:
            margin = -1.0
        if not 0.0 <= margin < float("inf"):
            rule = "must be MEASURE:MARGIN, a number from 0 or a share such as 5%"
            raise ConfigError(
                f"--fail-if-worse {key}: {rule}, got {format_value(size)}"
            )
        relative = size.endswith("%")
        return cls(key, margin / 100.0 if relative else margin, relative)


@dataclass(frozen=True)
class MarginTest:
    """Whether B is worse than A by more than a margin, both in the unit of the measure.

    decision: "not worse" where the 95 % interval of the loss lies within the margin, "worse" where it lies beyond it,
    else "not shown". loss: how much worse B is, on average; low, high: its limits, None where there are none.
    """

    a: str
    b: str
    measure: str
    margin: float
    loss: float
    low: float | None
    high: float | None
    decision: Literal["not worse", "worse", "not shown"]

    @property
    def text(self) -> str:
        """What it says, in a sentence."""
        measure = MEASURES[self.measure]
        unit = " percentage points" if measure.percent else measure.after
        limit = f"{measure.number(self.margin)}{unit}"
        words = {
            "not worse": f"{self.b} is not worse than {self.a} by more than {limit}",
            "worse": f"{self.b} is worse than {self.a} by more than {limit}",
            "not shown": f"it is not shown that {self.b} is not worse than {self.a} by more than {limit}",
        }
        high = (
            "none can be given"
            if self.high is None
            else f"{measure.number(self.high)}{unit}"
        )
        return (
            f"{words[self.decision]} ({measure.title}; upper limit of the loss: {high})"
        )


def decide_margin(found: Comparison, margin: Margin) -> MarginTest:
    """Return what a comparison, which has the measure among its rows, says of B by a margin."""
    row = found.row(margin.measure)
    of_a_less_b = row.paired.difference
    loss = of_a_less_b if row.larger_is_better else of_a_less_b.negate()
    limit = margin.margin * (abs(row.paired.mean_a) if margin.relative else 1.0)
    decision: Literal["not worse", "worse", "not shown"] = "not shown"
    if loss.low is not None and loss.high is not None:
        decision = (
            "not worse"
            if loss.high <= limit
            else "worse"
            if loss.low > limit
            else decision
        )
    return MarginTest(
        found.a,
        found.b,
        margin.measure,
        limit,
        loss.estimate,
        loss.low,
        loss.high,
        decision,
    )
