"""Numbers that the paper publishes, for putting ours beside them (Tables I and II, section IV-A)."""

from __future__ import annotations

from dataclasses import dataclass

from barn_metrics.metrics import METRIC_NAMES


@dataclass(frozen=True)
class PublishedRow:
    """One line of Table II. The paper takes minimum and maximum over cells, for tortuosity over paths."""

    minimum: float
    maximum: float
    mean: float
    std: float


TABLE_I: dict[str, str] = {
    "initial fill percentage": "0.15, 0.20, 0.25, 0.30",
    "smoothing iterations": "2, 3, 4",
    "fill threshold": "5",
    "clear threshold": "1",
}

TABLE_II: dict[str, PublishedRow] = dict(
    zip(
        METRIC_NAMES,
        (
            PublishedRow(1.0, 10.20, 2.37, 0.93),
            PublishedRow(1.0, 14.00, 4.42, 1.64),
            PublishedRow(0.0, 12.00, 4.35, 0.89),
            PublishedRow(0.0, 20.00, 4.05, 2.66),
            PublishedRow(1.0, 1.71, 1.21, 0.14),
        ),
        strict=True,
    )
)
