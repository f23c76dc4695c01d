"""Study whether difficulty carries over from robot to robot.

The tables and the figure of docs/carry_over.md.

    python qa/studies/carry_over.py docs/carry_over.csv \
        --figure docs/figures/carry_over.png
    python qa/studies/carry_over.py out/jackal out/husky out/turtlebot4 \
        --csv docs/carry_over.csv

The trials are those of several robots in worlds of the same grids, each in cells of its
robot's size (`barn.worlds.resize`). Courses and reference speeds are in these cells as
well, so that times can be compared as they are.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from pathlib import Path

import click
import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator, StrMethodFormatter

from barn_eval.analysis.planners import spelling
from barn_eval.analysis.sources import read_source
from barn_eval.analysis.statistics import mean_interval, rank_correlation
from barn_eval.pages.figures import label_axes, new_figure, style, write_figure
from barn_metrics.bootstrap import Interval, bootstrap_interval
from barn_metrics.metrics import METRICS, world_metrics
from barn_metrics.model import load_model
from barn_worlds.base.arrays import Floats, Integers
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.base.files import markdown_table, write_bytes
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.drawing.palette import FAINT, PLANNERS

GRIDS = "barn300"
LEARNED = "Predicted difficulty"
TOGETHER = "all"
_TICKS_S = (10.0, 20.0, 30.0, 50.0, 100.0)


@dataclass(frozen=True)
class Trials:
    """Trials of robots and planners in the same worlds, as many of each."""

    table: pd.DataFrame
    """A row per trial; time_s is as counted, for failures what the protocol counts."""

    @property
    def robots(self) -> list[str]:
        """Robots in the order in which they come."""
        return list(self.table["robot"].unique())

    @property
    def planners(self) -> list[str]:
        """Planners in the order in which they come."""
        return list(self.table["planner"].unique())

    @cached_property
    def worlds(self) -> Integers:
        """Numbers of the worlds that every planner drove with every robot."""
        driven = self.table.groupby(["robot", "planner"])["world"].agg(set)
        shared = set.intersection(*driven)
        if len(driven) < len(self.robots) * len(self.planners) or len(shared) < 3:
            raise ConfigError(
                "every planner must have driven with every robot, in 3 worlds at least"
            )
        return np.array(sorted(shared), np.int64)

    def of(self, robot: str, planner: str) -> pd.DataFrame:
        """Return the trials of a robot under a planner in the shared worlds."""
        table = self.table
        is_asked = (table["robot"] == robot) & (table["planner"] == planner)
        return table[is_asked & table["world"].isin(self.worlds)]

    def tries(self, robot: str, planner: str) -> Floats:
        """Return the times of each complete try in each world, (tries, worlds)."""
        trials = self.of(robot, planner).set_index(["seed", "repetition", "world"])
        times: Floats = trials["time_s"].unstack().dropna().to_numpy()
        return times

    def failed(self, robot: str, planner: str) -> npt.NDArray[np.bool_]:
        """Return in which worlds (worlds,) any try failed."""
        trials = self.of(robot, planner)
        return np.isin(self.worlds, trials["world"][trials["success"] == 0])

    def times(self, robot: str, planner: str) -> Floats:
        """Return the mean time of a robot in each world (worlds,).

        It is that of all planners if they are taken together.
        """
        planners = self.planners if planner == TOGETHER else [planner]
        mean_times: Floats = np.mean(
            [self.tries(robot, name).mean(axis=0) for name in planners], axis=0
        )
        return mean_times


def read_folders(folders: Sequence[Path]) -> Trials:
    """Return the trials of folders of results.

    Raises:
        ConfigError: For worlds whose grids are not those of barn300.
    """
    rows = []
    for folder in folders:
        source = read_source(folder)
        dataset = open_dataset(str(source.configuration["dataset"]))
        standard = open_dataset(GRIDS)
        for result in source.results:
            world = dataset.load(result.world)
            if not np.array_equal(world.grid, standard.load(result.world).grid):
                raise ConfigError(
                    f"{folder}: world {result.world} has not the grid of that of {GRIDS}"
                )
            row = {
                "robot": source.chassis.name,
                "planner": result.planner,
                "seed": int(source.configuration["seed"]),
                "repetition": result.repetition,
                "world": result.world,
                "success": int(result.scores.success),
                "time_s": round(result.scores.scored_time_s, 3),
            }
            rows.append(row)
    return Trials(pd.DataFrame(rows))


def read_trials(path: Path) -> Trials:
    """Return the trials of a CSV file that `csv_text` made."""
    return Trials(pd.read_csv(path))


def csv_text(trials: Trials) -> str:
    """Return the trials as CSV."""
    text: str = trials.table.to_csv(index=False, lineterminator="\n")
    return text


def results_table(trials: Trials) -> str:
    """Return success and mean time of each robot and planner."""
    rows = []
    for planner in trials.planners:
        for robot in trials.robots:
            table = trials.of(robot, planner)
            success, time = (
                mean_interval(values.to_numpy(np.float64), table["world"].to_numpy())
                for values in (100.0 * table["success"], table["time_s"])
            )
            texts = [str(len(table)), success.text(0), time.text(1)]
            rows.append([spelling(planner), f"`{robot}`", *texts])
    return markdown_table(
        ["planner", "robot", "trials", "success [%]", "time as counted [s]"], rows
    )


def predictors(worlds: Integers) -> dict[str, Floats]:
    """Return what may predict times, by name.

    Metrics of barn300's worlds and the shipped model's difficulty.
    """
    dataset = open_dataset(GRIDS)
    model = load_model()
    loaded = [dataset.load(number) for number in worlds.tolist()]
    values = np.array([world_metrics(world).as_array() for world in loaded])
    columns = {metric.title: values[:, column] for column, metric in enumerate(METRICS)}
    predictions = [model.predict(world).difficulty_s_per_m for world in loaded]
    return columns | {LEARNED: np.array(predictions)}


def metrics_table(trials: Trials, planners: Sequence[str]) -> str:
    """Return Spearman's correlation of predictors and mean times.

    There is a row per planner and predictor.
    """
    rows = [
        [*([spelling(planner)] if len(planners) > 1 else []), name]
        + [
            _rank(trials, values, trials.times(robot, planner)).text()
            for robot in trials.robots
        ]
        for planner in planners
        for name, values in predictors(trials.worlds).items()
    ]
    headings = [
        *(["planner"] if len(planners) > 1 else []),
        "predictor",
        *(f"`{name}`" for name in trials.robots),
    ]
    return markdown_table(headings, rows)


def robots_table(trials: Trials) -> str:
    """Return Spearman's correlation of the times of each two robots.

    The last columns show what repetition alone would leave of it.
    """
    pairs = list(combinations(trials.robots, 2))
    rows = []
    for planner in [*trials.planners, TOGETHER]:
        times = {robot: trials.times(robot, planner) for robot in trials.robots}
        across = [_rank(trials, times[a], times[b]).text() for a, b in pairs]
        again = [_repeatability(trials, robot, planner) for robot in trials.robots]
        rows.append([spelling(planner), *across, *again])
    headings = [
        "planner",
        *(f"`{a}`, `{b}`" for a, b in pairs),
        *(f"`{robot}`, itself" for robot in trials.robots),
    ]
    return markdown_table(headings, rows)


def regression_table(trials: Trials) -> str:
    """Return the linear regression of other robots' times on those of the first.

    It is over worlds where none failed.

    The last column is of all worlds, failures as they count.
    """
    first, *other_robots = trials.robots
    rows = []
    for planner in trials.planners:
        for robot in other_robots:
            x = trials.times(first, planner)
            y = trials.times(robot, planner)
            solved = ~(trials.failed(first, planner) | trials.failed(robot, planner))
            line = [
                _over(part, x[solved], y[solved])
                for part in (intercept, slope, determination)
            ]
            intervals = [*line, _over(determination, x, y)]
            texts = [intervals[0].text(1), *(part.text(2) for part in intervals[1:])]
            count = str(int(solved.sum()))
            rows.append([spelling(planner), f"`{robot}`", count, *texts])
    headings = [
        "planner",
        "robot",
        "worlds",
        "intercept [s]",
        "slope",
        "R2",
        "R2, all worlds",
    ]
    return markdown_table(headings, rows)


def slope(x: Floats, y: Floats) -> Floats:
    """Return the slope of the least-squares line along the last axis."""
    x = x - x.mean(axis=-1, keepdims=True)
    y = y - y.mean(axis=-1, keepdims=True)
    line_slope: Floats = (x * y).sum(axis=-1) / (x**2).sum(axis=-1)
    return line_slope


def intercept(x: Floats, y: Floats) -> Floats:
    """Return where that line is at x = 0."""
    line_intercept: Floats = y.mean(axis=-1) - slope(x, y) * x.mean(axis=-1)
    return line_intercept


def determination(x: Floats, y: Floats) -> Floats:
    """Return the share of the variance of y that the line explains."""
    share: Floats = slope(x, y) * slope(y, x)
    return share


def scatter(trials: Trials) -> Figure:
    """Return the times of other robots over those of the first, a panel per planner."""
    first, *other_robots = trials.robots
    figure = new_figure(8.8, 8.4)
    all_s = trials.table["time_s"]
    limits = (0.9 * min(all_s), 1.1 * max(all_s))
    for place, planner in enumerate(trials.planners):
        axes = figure.add_subplot(2, -(-len(trials.planners) // 2), place + 1)
        axes.plot(limits, limits, color=FAINT, lw=1.0)
        for color, robot in zip(PLANNERS, other_robots, strict=False):
            times = trials.times(first, planner), trials.times(robot, planner)
            axes.scatter(*times, s=26, facecolor="none", edgecolor=color, label=robot)
        label_axes(axes, f"{first} [s]", "other robot [s]", spelling(planner))
        axes.set(xscale="log", yscale="log", xlim=limits, ylim=limits, box_aspect=1.0)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(FixedLocator(_TICKS_S))
            axis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axis.set_minor_locator(NullLocator())
    figure.legend(
        *figure.axes[0].get_legend_handles_labels(),
        loc="outside lower center",
        ncols=len(other_robots),
    )
    return figure


def _rank(trials: Trials, x: Floats, y: Floats) -> Interval:
    return rank_correlation((x, trials.worlds), (y, trials.worlds))


def _repeatability(trials: Trials, robot: str, planner: str) -> str:
    """Return the correlation of mean times with those of as many trials again.

    It is a dash where there are not two.
    """
    planners = trials.planners if planner == TOGETHER else [planner]
    tries = [trials.tries(robot, name)[:2] for name in planners]
    if min(map(len, tries)) < 2:
        return "-"
    correlation = _rank(trials, *np.mean(tries, axis=0))
    if correlation.low is None or correlation.high is None:
        return "-"
    doubled = (
        2.0 * r / (1.0 + r)
        for r in (correlation.estimate, correlation.low, correlation.high)
    )  # Spearman and Brown
    return Interval(*doubled).text()


def _over(
    statistic: Callable[[Floats, Floats], Floats], x: Floats, y: Floats
) -> Interval:
    return bootstrap_interval(lambda sample: statistic(x[sample], y[sample]), len(x))


def tables(trials: Trials) -> dict[str, str]:
    """Return the tables of the page by title."""
    return {
        "Times": results_table(trials),
        "Predictors, all planners together": metrics_table(trials, [TOGETHER]),
        "Predictors by planner": metrics_table(trials, trials.planners),
        "Robots": robots_table(trials),
        "Regression": regression_table(trials),
    }


@click.command()
@click.argument("sources", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--csv", "target", type=click.Path(path_type=Path), help="Write the trials here."
)
@click.option("--figure", type=click.Path(path_type=Path), help="Draw the times here.")
def main(sources: Sequence[Path], target: Path | None, figure: Path | None) -> None:
    """Print the tables, of a CSV file of trials or of folders of results."""
    try:
        single = len(sources) == 1 and sources[0].suffix == ".csv"
        trials = read_trials(sources[0]) if single else read_folders(sources)
        if target is not None:
            write_bytes(target, csv_text(trials).encode())
        if figure is not None:
            with style():
                scatter_figure = scatter(trials)
            write_figure(scatter_figure, figure)
        for title, text in tables(trials).items():
            click.echo(f"{title}, {len(trials.worlds)} worlds:\n\n{text}\n")
    except BarnError as error:
        raise click.ClickException(str(error)) from None


if __name__ == "__main__":
    main()
