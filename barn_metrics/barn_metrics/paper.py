"""Numbers that the paper publishes, for putting ours beside them (Tables I and II, section IV-A)."""

from dataclasses import dataclass

from barn_metrics.metrics import METRIC_NAMES


@dataclass(frozen=True)
class PublishedRow:
    """One line of Table II. The paper takes minimum and maximum over cells, for tortuosity over paths."""

    minimum: float
    maximum: float
    mean: float
    std: float


# Values by the name of the field of `barn_worlds.parameters.WorldParameters`; each combination was repeated.
TABLE_I: dict[str, tuple[float, ...]] = {
    "initial_fill": (0.15, 0.20, 0.25, 0.30),
    "smoothing_iterations": (2, 3, 4),
    "fill_threshold": (5,),
    "clear_threshold": (1,),
}
REPETITIONS = 25

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
