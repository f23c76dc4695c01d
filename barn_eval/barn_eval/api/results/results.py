"""The results of one experiment."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import cached_property, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import overload

import pandas as pd
from matplotlib.axes import Axes
from rich.console import Console

from barn_eval.analysis.measures import ranking_measure
from barn_eval.analysis.pandas_tables import pandas_of_arrow, pandas_table
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.precision import estimate_precision
from barn_eval.analysis.ranking_power import ranking_power
from barn_eval.analysis.sources import (
    Source,
    entries_of,
    group_by_planner,
    read_source,
    select_planners,
)
from barn_eval.analysis.summary import summarize, summarize_run
from barn_eval.analysis.tables import headline_table, paper_table
from barn_eval.analysis.verdict import conclude_results, list_cautions
from barn_eval.api.results.folders import Folder, compare, overlay, replay, report
from barn_eval.api.results.trial import Trial
from barn_eval.pages.figures import Page, Plot, figure_of
from barn_eval.pages.replay.files import by_ending
from barn_eval.pages.report.charts import CHARTS
from barn_eval.pages.report.page import plot
from barn_eval.pages.template import render
from barn_eval.results.bags import BAGS
from barn_eval.results.folder import REPLAYS
from barn_eval.results.rows import results_table, timing_table
from barn_eval.results.run_file import RunFile
from barn_eval.results.store import BagStore, TrialRecord
from barn_eval.ros.work import work_of
from barn_eval.running.engine import Job
from barn_eval.running.planner_objects import (
    LivePlanner,
    Planners,
    fingerprint,
    split_planners,
)
from barn_eval.trials.result import TrialResult, unpack_delays
from barn_eval.trials.run_config import ExecutionConfig
from barn_eval.verification.check import describe_difference
from barn_worlds.base.errors import ConfigError, suggest


def load(folder: str | Path, planners: Planners | None = None) -> "Results":
    """Return the results of an experiment.

    Args:
        folder: Of `run` or `barn run`, finished or not.
        planners: Those that were given as Python objects, should one of their trials have to be driven again.

    Returns:
        The results.

    Raises:
        BarnError: There are none.
    """
    return Results(
        Path(folder), split_planners(planners)[1] if planners is not None else {}
    )


class Results:
    """The results of an experiment, finished or not, read from its folder.

    Tables are DataFrames, whose columns have the same types whatever is in them. Shown in a notebook, results draw
    themselves. live: planners that were given as Python objects, by name.
    """

    def __init__(
        self, folder: Path, live: Mapping[str, LivePlanner] | None = None
    ) -> None:
        self.folder = Path(folder)
        self._live = dict(live or {})
        self._source: Source = read_source(self.folder)

    @property
    def trials(self) -> tuple[TrialResult, ...]:
        """The results of single trials, in the order of the plan."""
        return self._source.results

    @property
    def planners(self) -> list[str]:
        """Names of the planners that have results."""
        return list(group_by_planner(self.trials))

    @cached_property
    def table(self) -> pd.DataFrame:
        """A row per trial, without wall-clock figures; docs/campaigns.md describes the columns."""
        return pandas_of_arrow(results_table(self.trials))

    @cached_property
    def timing(self) -> pd.DataFrame:
        """A row per trial with its wall-clock figures, among them the planner's time per cycle (compute_*_ms)."""
        return pandas_of_arrow(timing_table(self.trials))

    @cached_property
    def summary(self) -> pd.DataFrame:
        """A row per planner: trials, worlds, and means of what is scored with the limits of their 95 % intervals.

        Columns: planner, trials, worlds, and for each of success (share), traversal_time_s (of successes),
        scored_time_s, normalised_time_s_per_m, challenge, challenge_2022 and efficiency the mean, NAME_low and
        NAME_high.
        """
        return pandas_table(
            {"planner": name} | summarize(one).columns()
            for name, one in group_by_planner(self.trials).items()
        )

    def trial(self, trial: str | int) -> Trial:
        """Return a trial, with its `result` and its `trajectory`.

        Args:
            trial: Its name, such as "dwa_w0120_r00", or its place among the rows.

        Raises:
            BarnError: There is no such trial.
        """
        result = self._result(trial)
        return Trial(result, self._source.tracks.get(result.trial_id))

    def compare(self, other: Folder | None = None) -> pd.DataFrame:
        """Compare each pair of planners on the same worlds and seeds, or these results with others.

        Args:
            other: `Results`, a folder, or "FOLDER:PLANNER".

        Returns:
            What `barn.compare` does.

        Raises:
            BarnError: There is one planner only, and no other results; or they are not of the same task.
        """
        if other is not None:
            return compare(self, other)
        found = summarize_run(self.trials).comparisons
        if not found:
            raise ConfigError(
                f"{self.folder}: has one planner only; give other results to compare with"
            )
        return pandas_table(row for one in found for row in one.columns())

    def verdict(self) -> str:
        """Return in a sentence or two which planner is better by the protocol's metric, by how much and how sure.

        Or that they cannot be told apart, and how many worlds it would take.
        """
        groups = {
            spelling(name): group
            for name, group in group_by_planner(self.trials).items()
        }
        notes = list_cautions(len({one.world for one in self.trials}), [self._source])
        return " ".join((str(conclude_results(groups)), *notes))

    def estimate_precision(
        self,
        half_width: float | None = None,
        difference: float | None = None,
        *,
        planners: Sequence[str] = (),
        measure: str = "",
        repetitions: int | None = None,
    ) -> pd.DataFrame:
        """Return how many worlds a wanted precision needs, told from these results.

        Args:
            half_width: Wanted, of the 95 % interval of a mean, in the unit of the measure. Default: 5 % of the mean.
            difference: Of two planners, to be found 8 times in 10, likewise.
            planners: One or two of those there are.
            measure: A column of `table`, without one the protocol's metric.
            repetitions: Trials per world. Default: 1, 2, 3, 5 and 10.

        Returns:
            A row per question and number of repetitions: of (a planner, or a difference of two), kind (half_width or
            difference), wanted, repetitions, and worlds needed (missing: over a million).

        Raises:
            BarnError: The planners or the measure are not known, or there is too little to tell from.
        """
        chosen = select_planners(self.folder, group_by_planner(self.trials), planners)
        found = estimate_precision(
            chosen,
            half_width,
            difference,
            measure_key=measure,
            repetitions=repetitions,
        )
        return pandas_table((asdict(one) for one in found.needs), worlds="Int64")

    def latex(
        self,
        columns: Sequence[str] = (),
        *,
        caption: str = "",
        label: str = "tab:planners",
    ) -> str:
        """Return a table of the planners for a paper, in LaTeX with the package booktabs.

        Bold are the best by each measure, and those that are not clearly worse, as `verdict` judges it.

        Args:
            columns: Measures, columns of `table`. Default: the protocol's metric, success, time and clearance.
            caption: Its caption. Default: what the figures are, and of how many worlds.
            label: By which a text refers to it.

        Returns:
            A table environment.

        Raises:
            BarnError: A measure is not known, or the label not one of LaTeX.
        """
        groups = {
            spelling(name): group
            for name, group in group_by_planner(self.trials).items()
        }
        return paper_table(groups, columns, caption=caption, label=label)

    def ranking(self, measures: Sequence[str] = ()) -> pd.DataFrame:
        """Return how often draws of some worlds bring the planners that differ into the right order.

        Args:
            measures: Columns of `table`, without any the protocol's metric.

        Returns:
            A row per measure and number of worlds: dataset, measure, worlds, share, and enough, the fewest worlds from
            which the share is 95 % (missing: not even all are).

        Raises:
            BarnError: There is one planner only, or a measure is not known.
        """
        return pandas_table(
            (
                {
                    "dataset": one.dataset,
                    "measure": one.measure,
                    "worlds": n,
                    "share": share,
                    "enough": one.enough,
                }
                for one in ranking_power(group_by_planner(self.trials), measures)
                for n, share in one.shares.items()
            ),
            enough="Int64",
        )

    @overload
    def plot(
        self, what: str = ..., ax: None = None, *, width_mm: float | None = ...
    ) -> Plot: ...
    @overload
    def plot(self, what: str = ..., *, ax: Axes | Sequence[Axes]) -> list[Axes]: ...
    def plot(
        self,
        what: str = "worlds",
        ax: Axes | Sequence[Axes] | None = None,
        *,
        width_mm: float | None = None,
    ) -> Plot | list[Axes]:
        """Draw a figure of a report.

        Args:
            what: worlds (time per metre in each), outcomes (of each trial), distributions, compute, trade,
                bands, paired or hardest (maps of worlds with the trajectories of their trials).
            ax: Axes of matplotlib to draw onto, as many as the figure has panels; for worlds one.
            width_mm: Width of the figure in a paper [mm], such as 88 for a column and 180 for two. Its type is of 7 to
                9 pt then; `save` writes it as PDF with embedded fonts.

        Returns:
            The figure (matplotlib's own is its `figure`), or the axes where these were given.

        Raises:
            BarnError: There is no such figure or nothing to show in it, or it has another number of panels.
        """
        panels = plot(what, entries_of([self._source]), ax, width_mm)
        return Plot(figure_of(panels), CHARTS[what].about) if ax is None else panels

    def replay(self, trial: str, out: str | Path | None = None) -> Page:
        """Write the replay of a trial.

        Without a bag of the trial it is driven once more to make one; it is said so, and also if that drive ends
        otherwise than the first, as no trial in direct mode should.

        Args:
            trial: Its name, such as "dwa_w0120_r00".
            out: File of it, as of `barn.replay`. Default: OUT/replays/TRIAL.html.

        Returns:
            The page or picture, which a notebook shows.

        Raises:
            BarnError: There is no such trial, or it cannot be driven again.
        """
        result = self._result(trial)
        folder = self.folder / REPLAYS
        page = Path(out or folder / f"{trial}.html")
        by_ending([page])
        bag = self._source.bag(trial)
        if not bag.is_dir():
            bag = folder / BAGS / trial
        if not bag.is_dir():
            say = partial(Console(stderr=True).print, highlight=False)
            say(f"no bag of {trial} was kept: it is driven once more")
            again = self._drive(result, folder, "all")
            if again.repeatable() != result.repeatable():
                say(
                    f"{trial} went otherwise this time: {again.outcome.value}, not {result.outcome.value} as in its"
                    " row, or by another way; its planner does not repeat itself"
                )
        return replay(bag, page)

    def overlay(
        self,
        world: int,
        by: str = "planner",
        *,
        planners: Sequence[str] = (),
        outcome: str = "",
    ) -> Plot:
        """Return the trials in a world, drawn over it; as `barn.results.overlay`."""
        return overlay(self, world, by, planners=planners, outcome=outcome)

    def report(self, out: str | Path = "report.html", *, title: str = "") -> Page:
        """Write the report of the results as a page that needs nothing but itself; as `barn.report`."""
        return report(self, out, title=title)

    def rerun(self, trial: str | int) -> str:
        """Run a trial once more and compare.

        Args:
            trial: Its name or its place among the rows.

        Returns:
            The first thing in which it differs from its row, an empty text where it is reproduced.

        Raises:
            BarnError: There is no such trial, or its planner is not at hand.
        """
        result = self._result(trial)
        with TemporaryDirectory() as folder:
            return describe_difference(
                result, self._drive(result, Path(folder), "none")
            )

    def _drive(self, result: TrialResult, folder: Path, bags: str) -> TrialResult:
        """Drive a trial once more, alone, its bag in a folder, and return its new result."""
        experiment, name = (
            replace(RunFile.read(self.folder).run_config(), bags=bags),
            result.planner,
        )
        (choice,) = (one for one in experiment.planners if one.name == name)
        if choice.source and name not in self._live:
            raise ConfigError(
                f"planner {name!r} was a Python object: barn.load(folder, planners=...) takes it"
            )
        if choice.source and fingerprint(self._live[name].given) != choice.source:
            raise ConfigError(
                f"planner {name!r} is not the one of these results: its source differs"
            )
        (spec,) = (
            one
            for one in experiment.trials([result.world])
            if one.trial_id == result.trial_id
        )
        if result.delays:
            spec = replace(spec, recorded_ns=unpack_delays(result.delays))
        kept: list[object] = []  # what mode ros reports on the way
        work = work_of(
            experiment,
            ExecutionConfig(workers=1),
            BagStore(folder.absolute(), bags),
            self._live,
        )
        done = work.run(Job(result.trial_id, (spec,)), kept.append)
        return next(one for one in (done, *kept) if isinstance(one, TrialRecord)).result

    def _result(self, trial: str | int) -> TrialResult:
        found = {result.trial_id: result for result in self.trials}
        if isinstance(trial, int) and 0 <= trial < len(found):
            return self.trials[trial]
        if trial not in found:
            raise ConfigError(
                f"{self.folder}: has no trial {trial!r}{suggest(str(trial), found)}"
            )
        return found[str(trial)]

    def __len__(self) -> int:
        """Return the number of trials that have a result."""
        return len(self.trials)

    def __repr__(self) -> str:
        """Return in one line what there is."""
        planned = self._source.planned
        of = f" of {planned}" if planned and planned > len(self) else ""
        return f"Results({str(self.folder)!r}: {len(self)}{of} trials, {', '.join(self.planners)})"

    def _repr_html_(self) -> str:
        """Return what a notebook shows: a table of planners and a figure."""
        groups = group_by_planner(self.trials)
        summaries = [summarize(one) for one in groups.values()]
        table = headline_table(
            [spelling(name) for name in groups], summaries, ranking_measure(self.trials)
        )
        picture = self.plot().picture()
        return render(
            "notebook.html",
            about=repr(self),
            verdict=self.verdict(),
            table=table,
            picture=picture,
        )
