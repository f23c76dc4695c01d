"""Results of runs: `load`, `Results`, and the functions on folders of results.

`barn.results` is this module.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import overload

import pandas as pd
from matplotlib.axes import Axes

from barn_eval.analysis.entries import entries_of
from barn_eval.analysis.measures import ranking_measure
from barn_eval.analysis.pandas_tables import pandas_of_arrow, pandas_table
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.precision import estimate_precision
from barn_eval.analysis.sources import (
    Source,
    group_by_planner,
    read_source,
    select_planners,
)
from barn_eval.analysis.summary import summarize, summarize_run
from barn_eval.analysis.tables import headline_table
from barn_eval.analysis.verdict import conclude_results, list_cautions
from barn_eval.api.folders import (
    Folder,
    check,
    compare,
    comparisons_frame,
    leaderboard,
    overlay,
    replay,
    report,
    watch,
)
from barn_eval.api.trial import Trial
from barn_eval.pages.figures import Page, Plot, figure_of
from barn_eval.pages.latex import paper_table
from barn_eval.pages.replay.files import sort_by_ending
from barn_eval.pages.report.charts import CHARTS
from barn_eval.pages.report.page import plot
from barn_eval.pages.template import render
from barn_eval.results.bags import BAGS
from barn_eval.results.folder import REPLAYS
from barn_eval.results.rows import results_table, timing_table
from barn_eval.results.run_file import RunFile
from barn_eval.results.store import BagStore, TrialRecord
from barn_eval.ros.work import work_of
from barn_eval.running.planner_objects import (
    PlannerObject,
    Planners,
    fingerprint,
    split_planner_objects,
)
from barn_eval.running.pool import Job
from barn_eval.running.request import RunRequest
from barn_eval.trials.result import RowsByPlanner, TrialResult, unpack_delays
from barn_eval.trials.run_config import ExecutionConfig
from barn_eval.verification.plausibility import find_difference
from barn_eval.verification.submission import submit, verify
from barn_worlds.base.errors import ConfigError, suggest

__all__ = [
    "Results",
    "Trial",
    "check",
    "compare",
    "leaderboard",
    "load",
    "overlay",
    "replay",
    "report",
    "submit",
    "verify",
    "watch",
]

logger = logging.getLogger(__name__)


def load(folder: str | Path, planners: Planners | None = None) -> "Results":
    """Read the results folder of a run and return it as `Results`.

    Args:
        folder: Folder of `run` or `barn run`, finished or not.
        planners: The planners that were Python objects; only needed to drive their
            trials again.

    Raises:
        BarnError: If the folder has no results.
    """
    _, planner_objects = split_planner_objects(planners or [])
    return Results(Path(folder), planner_objects)


class Results:
    """The results of a run, finished or not, read from its folder.

    Tables are DataFrames whose columns always have the same types. A notebook shows
    results as a conclusion, a table and a figure.
    """

    def __init__(
        self, folder: Path, planner_objects: Mapping[str, PlannerObject] | None = None
    ):
        """Read a folder; BarnError if it has no results.

        Args:
            folder: Folder of the run.
            planner_objects: Planners that were Python objects, by name.
        """
        self.folder = Path(folder)
        self._planner_objects = dict(planner_objects or {})
        self._source: Source = read_source(self.folder)

    @cached_property
    def trials(self) -> tuple[TrialResult, ...]:
        """Scored rows of the trials, in the order of the schedule."""
        return tuple(self._source.results)

    @property
    def planners(self) -> list[str]:
        """Names of the planners that have results, without presets."""
        return list(group_by_planner(self.trials))

    @cached_property
    def table(self) -> pd.DataFrame:
        """DataFrame with a row per trial, without wall-clock figures.

        docs/campaigns.md describes the columns.
        """
        return pandas_of_arrow(results_table(self.trials))

    @cached_property
    def timing(self) -> pd.DataFrame:
        """DataFrame with a row per trial: its name and wall-clock figures.

        Among them are the planner's times per cycle, compute_*_ms.
        """
        return pandas_of_arrow(timing_table(self.trials))

    @cached_property
    def summary(self) -> pd.DataFrame:
        """DataFrame with a row per planner: means and limits of 95% intervals.

        Columns: planner, trials, worlds, and for each of success (share),
        traversal_time_s (of successes), scored_time_s, normalised_time_s_per_m,
        challenge, challenge_2022 and efficiency the mean, NAME_low and NAME_high.
        """
        return pandas_table(
            {"planner": name} | summarize(rows).columns()
            for name, rows in group_by_planner(self._source.comparable_results).items()
        )

    def trial(self, trial: str | int) -> Trial:
        """Return a trial by its name or its index in `trials`; ConfigError if unknown.

        Args:
            trial: Its name, such as "dwa_w0120_r00", or its index in `trials`, from 0.

        Raises:
            BarnError: If there is no such trial.
        """
        result = self._result(trial)
        return Trial(result, self._source.tracks.get(result.trial_id))

    def compare(self, other: Folder | None = None) -> pd.DataFrame:
        """Compare with other results or by pairs of planners; ConfigError for just one.

        Args:
            other: `Results`, a folder, or "FOLDER:PLANNER". By default, the planners of
                these results are compared with each other.

        Returns:
            The table of `barn.compare`.

        Raises:
            BarnError: If there is nothing to compare with, or the tasks differ.
        """
        if other is not None:
            return compare(self, other)
        comparisons = summarize_run(self._source.comparable_results).comparisons
        if not comparisons:
            raise ConfigError(
                f"{self.folder}: has only one planner; give other results to compare"
                " it with"
            )
        return comparisons_frame(comparisons)

    def verdict(self) -> str:
        """Return sentences on which planner is better, how sure that is, and cautions.

        They say by how much and how sure that is or, if the difference is not
        significant, about how many worlds would decide, and add cautions.
        """
        world_count = len({row.world for row in self.trials})
        notes = list_cautions(world_count, entries_of([self._source]))
        return " ".join((str(conclude_results(self._rows_by_spelling())), *notes))

    def precision(
        self,
        half_width: float | None = None,
        difference: float | None = None,
        *,
        planners: Sequence[str] = (),
        measure: str = "",
        repetitions: int | None = None,
    ) -> pd.DataFrame:
        """Estimate from these trials how many worlds an interval or difference needs.

        Args:
            half_width: Half the 95% interval of a mean, in the unit of the measure.
                Default: 5% of the mean.
            difference: Difference between two planners to detect in 8 of 10 runs, in the
                unit of the measure. Default: 5% of the first one's mean.
            planners: Names of one or two planners. Default: all.
            measure: A column of `table`. Default: the ranking measure.
            repetitions: Trials per world. Default: 1, 2, 3, 5 and 10.

        Returns:
            A row per question and number of repetitions: of (a planner, or two), kind
            (half_width or difference), wanted, repetitions, and worlds (missing if over
            a million).

        Raises:
            BarnError: If planners or measure are unknown, or there are too few trials.
        """
        # The estimate takes one planner or two.
        rows_by_planner = select_planners(
            self.folder, group_by_planner(self._source.comparable_results), planners
        )
        estimate = estimate_precision(
            rows_by_planner,
            half_width,
            difference,
            measure_key=measure,
            repetitions=repetitions,
        )
        return pandas_table((asdict(need) for need in estimate.needs), worlds="Int64")

    def latex(
        self,
        columns: Sequence[str] = (),
        *,
        caption: str = "",
        label: str = "tab:planners",
    ) -> str:
        """Return the LaTeX source of a table of the planners (booktabs).

        By each measure, the best planner is bold, and so are planners that are not
        clearly worse by the tests that `verdict` uses.

        Args:
            columns: Measures: columns of `table`. Default: the ranking measure, success,
                time and clearance.
            caption: Its caption. Default: what the figures are, and the number of worlds.
            label: Label that the text of a paper refers to.

        Raises:
            BarnError: If a measure is not known, or the label is not one of LaTeX.
        """
        return paper_table(
            self._rows_by_spelling(), columns, caption=caption, label=label
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
        """Draw a figure of the report; return it or, if drawn onto `ax`, the axes.

        Args:
            what: worlds (time per meter in each), outcomes (of each trial),
                distributions, compute, trade, bands, paired or hardest (maps of worlds
                with the trajectories of their trials).
            ax: Axes of matplotlib to draw onto, one per panel of the figure; worlds has
                one.
            width_mm: Width of the figure in a paper [mm], such as 88 for a column and
                180 for two. Its type is then 7 to 9 pt; `save` writes it as PDF with
                embedded fonts.

        Returns:
            The figure, whose `figure` is matplotlib's; with `ax`, the axes.

        Raises:
            BarnError: If there is no such figure, it would be empty, or it has a
                different number of panels than `ax`.
        """
        panels = plot(what, entries_of([self._source]), ax, width_mm)
        # The axes are part of a figure of the user, who saves and shows it.
        if ax is not None:
            return panels
        return Plot(figure_of(panels), CHARTS[what].about)

    def replay(self, trial: str, out: str | Path | None = None) -> Page:
        """Write the replay of a trial, driven again if it has no bag; return the page.

        A warning is logged if the trial is driven again, and another one if the new
        drive differs from the first, which does not happen in mode direct.

        Args:
            trial: Its name, such as "dwa_w0120_r00".
            out: File, as for `barn.replay`. Default: OUT/replays/TRIAL.html.

        Returns:
            The page or picture, which a notebook shows.

        Raises:
            BarnError: If there is no such trial, or it cannot be driven again.
        """
        result = self._result(trial)
        folder = self.folder / REPLAYS
        page = Path(out or folder / f"{trial}.html")
        sort_by_ending(
            [page]
        )  # raises for an unknown format before the trial is driven
        bag = self._source.bag(trial)
        if not bag.is_dir():
            # An earlier replay may have driven the trial again.
            bag = folder / BAGS / trial
        if not bag.is_dir():
            logger.warning("%s has no bag: running the trial again", trial)
            # Into a folder of its own, because the run was to keep no bag.
            new_result = self._drive(result, folder, "all")
            if new_result.repeatable() != result.repeatable():
                logger.warning(
                    "%s differs from its row: the outcome is %s (in the row: %s), or"
                    " the path differs; the planner is not deterministic",
                    trial,
                    new_result.outcome.value,
                    result.outcome.value,
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
        """Return a plot of the trajectories in a world, as `barn.results.overlay` does.

        Args:
            world: Number in the data set.
            by: What the color shows, "planner" or "speed".
            planners: Only trials of these planners.
            outcome: Only trials with this outcome, such as "collision".
        """
        return overlay(self, world, by, planners=planners, outcome=outcome)

    def report(self, out: str | Path = "report.html", *, title: str = "") -> Page:
        """Write the report of these results as one HTML page, as `barn.report` does.

        Args:
            out: The page.
            title: Title of the page.
        """
        return report(self, out, title=title)

    def rerun(self, trial: str | int) -> str:
        """Drive a trial again; return the first difference from its row, "" if none.

        Args:
            trial: Its name or its index in `trials`, from 0.

        Returns:
            The first difference from its row; empty if the trial is reproduced.

        Raises:
            BarnError: If there is no such trial, or its planner is not available.
        """
        result = self._result(trial)
        # Mode ros writes logs, even without a bag.
        with TemporaryDirectory() as folder:
            new_result = self._drive(result, Path(folder), "none")
        # An earlier version with another schema may have written the row.
        new_result = replace(new_result, schema_version=result.schema_version)
        return next(find_difference(result, new_result.repeatable(), "now"), "")

    def _drive(self, result: TrialResult, out: Path, bags: str) -> TrialResult:
        """Drive a trial again, return its row; ConfigError if its object is missing.

        Args:
            result: Its row.
            out: Folder for its bag.
            bags: Whether to record a bag, "all" or "none".

        Raises:
            ConfigError: If its planner was a Python object that is missing or changed.
        """
        # From run.json, which describes the run that made the row.
        config = replace(RunFile.read(self.folder).run_config(), bags=bags)
        name = result.planner
        choice = config.planner(name)
        # The folder has only a hash of a Python object's code.
        if choice.source:
            if name not in self._planner_objects:
                raise ConfigError(
                    f"planner {name!r} was a Python object: pass it to barn.load(folder,"
                    " planners=...)"
                )
            if fingerprint(self._planner_objects[name].source) != choice.source:
                raise ConfigError(
                    f"planner {name!r}: its source differs from the source that gave these results"
                )

        spec = next(
            spec
            for spec in config.trials([result.world])
            if spec.trial_id == result.trial_id
        )
        # Measured computing times never repeat, so the recorded delays are charged.
        if result.delays:
            spec = replace(spec, recorded_ns=unpack_delays(result.delays))
        request = RunRequest(
            config,
            ExecutionConfig(workers=1),
            out,
            planner_objects=self._planner_objects,
        )
        work = work_of(request, BagStore(out.absolute(), bags))

        # Mode direct returns the record; mode ros emits it among its notices.
        messages: list[object] = []
        messages.append(work.run(Job(result.trial_id, (spec,)), messages.append))
        record = next(item for item in messages if isinstance(item, TrialRecord))
        return record.result

    def _result(self, trial: str | int) -> TrialResult:
        """Return the row of a trial by name or index; ConfigError if there is none."""
        # A negative index fails below, as an unknown name.
        if isinstance(trial, int) and 0 <= trial < len(self.trials):
            return self.trials[trial]
        results = {row.trial_id: row for row in self.trials}
        name = str(trial)
        if name not in results:
            raise ConfigError(
                f"{self.folder}: no trial {trial!r}{suggest(name, results)}"
            )
        return results[name]

    def _rows_by_spelling(self) -> RowsByPlanner:
        """Return comparable rows by the planners' display names, such as "DWA"."""
        return {
            spelling(name): rows
            for name, rows in group_by_planner(self._source.comparable_results).items()
        }

    def __len__(self) -> int:
        """Return the number of trials that have a result."""
        return len(self.trials)

    def __repr__(self) -> str:
        """Return folder, number of trials and planners in one line."""
        planned = self._source.planned
        # Notebooks show this line, so it says if trials are missing.
        count = str(len(self))
        if planned and planned > len(self):
            count += f" of {planned}"
        return (
            f"Results({str(self.folder)!r}: {count} trials, {', '.join(self.planners)})"
        )

    def _repr_html_(self) -> str:
        """Return the HTML that a notebook shows: conclusion, table and figure."""
        groups = group_by_planner(self._source.comparable_results).values()
        summaries = [summarize(rows) for rows in groups]
        table = headline_table(summaries, ranking_measure(self.trials))
        return render(
            "notebook.html",
            about=repr(self),
            verdict=self.verdict(),
            table=table,
            picture=self.plot().picture(),
        )
