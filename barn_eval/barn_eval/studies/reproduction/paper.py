"""What the paper reports of its trials and its model (sections IV-A and IV-B).

Numbers that the text does not give were taken from the trial table published with it: times and failures by kind,
repeatability, and the model's held-out figures. Table II is in barn_metrics.report.
"""

from dataclasses import dataclass

WORLDS = 300
REPETITIONS = 5
# A tenth of the worlds: the easiest and the most difficult whose mean times are compared.
EXTREME_SHARE = 0.1


@dataclass(frozen=True)
class PublishedTrials:
    """One planner's 1500 trials.

    spread_s_per_m: standard deviation over a world's five trials, averaged over worlds; over_worlds_s_per_m: that of
    the worlds' means. failures_30_s, failures_50_s: trials that count 30 s (penalty) and 50 s (cut-off). easy_s,
    hard_s: mean time in the 30 easiest and the 30 most difficult worlds.
    """

    normalised_s_per_m: float
    spread_s_per_m: float
    over_worlds_s_per_m: float
    time_s: float
    success_time_s: float
    trials: int
    failures_30_s: int
    failures_50_s: int
    easy_s: float
    hard_s: float

    @property
    def failures(self) -> int:
        """Number of failed trials."""
        return self.failures_30_s + self.failures_50_s

    @property
    def failure_share(self) -> float:
        """Share of failed trials, 0 to 1."""
        return self.failures / self.trials

    @property
    def failure_time_s(self) -> float:
        """Time that a failed trial counts with, on average."""
        return (30.0 * self.failures_30_s + 50.0 * self.failures_50_s) / self.failures


TRIALS: dict[str, PublishedTrials] = {
    "dwa": PublishedTrials(3.30, 0.50, 1.03, 18.09, 16.53, 1500, 102, 29, 12.8, 30.0),
    "eband": PublishedTrials(3.24, 0.38, 0.57, 17.60, 16.12, 1500, 109, 21, 15.8, 23.1),
}
PLANNERS = tuple(TRIALS)

# Spearman's correlation over worlds of DWA's means with E-Band's.
PLANNERS_CORRELATION = 0.37


# The difficulty model: loss (mean squared error, (s/m)^2) as quoted, and of 10-fold cross-validation. variance: over
# worlds of what is predicted, (s/m)^2, as error and R2 give it.
MODEL = {"training_mse": 0.10, "mse": 0.31, "r2": 0.29, "spearman": 0.60, "mae_s_per_m": 0.42, "variance": 0.31 / 0.71}
