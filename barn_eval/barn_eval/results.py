"""Results of an experiment in Python and notebooks: tables, figures, replays and reports of what is in its folder."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, TypeAlias

from rich.console import Console

from barn_eval.analysis.sources import Source, by_planner, read_entries, read_source
from barn_eval.bags import BAGS
from barn_eval.experiments.live import LivePlanner
from barn_eval.experiments.tables import results_table, timing_table
from barn_eval.pages import LOOPBACK
from barn_eval.pages.notebook import Page
from barn_eval.trials.result import TrialResult
from barn_worlds.base.errors import ConfigError, suggest

if TYPE_CHECKING:
    import pyarrow as pa

    from barn_eval.experiments.check import FolderCheck
    from barn_eval.pages.figures import Plot
    from barn_eval.pages.live.server import Watch

    Folders: TypeAlias = "Results | str | Path | Sequence[Results | str | Path]"

_FIGURES = {
    "overview": "metric and success of each planner, and its time per metre in each world",
    "worlds": "counted time per metre of each world, worlds from easy to difficult",
    "outcomes": "outcome of every trial, worlds from easy to difficult",
    "distributions": "share of trials up to each value of time per metre, clearance, speed and jerk",
}
_REPLAYS = (".html", ".png", ".gif", ".mp4")


class Results:
    """The results of an experiment, finished or not, read from its folder.

    Tables are a pandas DataFrame where pandas is installed, else a pyarrow Table. Shown in a notebook, results draw
    themselves. live: planners that were given as Python objects, by name.
    """

    def __init__(self, folder: Path, live: Mapping[str, LivePlanner] | None = None) -> None:
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
        return list(by_planner(self.trials))

    @cached_property
    def table(self) -> Any:
        """A row per trial, without wall-clock figures; docs/campaigns.md describes the columns."""
        return frame(results_table(self.trials))

    @cached_property
    def timing(self) -> Any:
        """A row per trial with its wall-clock figures, among them the planner's time per cycle (compute_*_ms)."""
        return frame(timing_table(self.trials))

    @cached_property
    def summary(self) -> Any:
        """A row per planner: trials, worlds, and means of what is scored with the limits of their 95 % intervals.

        Columns: planner, trials, worlds, and for each of success (share), traversal_time_s (of successes),
        scored_time_s, normalised_time_s_per_m, challenge and challenge_2022 the mean, NAME_low and NAME_high.
        """
        from barn_eval.analysis.summary import summarise  # noqa: PLC0415 (scipy)

        return frame_of({"planner": name} | summarise(one).columns() for name, one in by_planner(self.trials).items())

    def compare(self, other: Results | str | Path | None = None) -> Any:
        """Compare each pair of planners on the same worlds and seeds, or these results with others' (a folder).

        Returns what `barn.compare` does.
        """
        if other is not None:
            return compare(self, other)
        from barn_eval.analysis.summary import summarise_campaign  # noqa: PLC0415 (scipy)

        found = summarise_campaign(self.trials).comparisons
        if not found:
            raise ConfigError(f"{self.folder}: has one planner only; give other results to compare with")
        return frame_of(row for one in found for row in one.columns())

    def verdict(self) -> str:
        """Return in a sentence or two which planner is better by the protocol's metric, by how much and how sure.

        Or that they cannot be told apart, and how many worlds it would take. BarnError as `compare`.
        """
        from barn_eval.analysis.planners import spelling  # noqa: PLC0415
        from barn_eval.analysis.verdict import cautions, results_verdict  # noqa: PLC0415 (scipy)

        groups = {spelling(name): group for name, group in by_planner(self.trials).items()}
        notes = cautions(len({one.world for one in self.trials}), [self._source])
        return " ".join((results_verdict(groups), *notes))

    def precision(
        self,
        half_width: float | None = None,
        difference: float | None = None,
        *,
        planners: Sequence[str] = (),
        measure: str = "",
        repetitions: int | None = None,
    ) -> Any:
        """Return how many worlds a wanted precision needs, told from these results.

        half_width: wanted, of the 95 % interval of a mean; difference: of two planners, to be found 8 times in 10; both
        in the unit of the measure, and 5 % of the mean unless given. planners: one or two of those there are. measure:
        a column of `table`, without one the protocol's metric.

        Returns a row per question and number of repetitions: of (a planner, or a difference of two), kind (half_width
        or difference), wanted, repetitions, and worlds needed (none: over a million).
        """
        from barn_eval.analysis.precision import precision  # noqa: PLC0415 (scipy)

        groups = by_planner(self.trials)
        for name in planners:
            if name not in groups:
                raise ConfigError(f"{self.folder}: has no planner {name!r}{suggest(name, groups)}")
        chosen = {name: groups[name] for name in planners or groups}
        found = precision(chosen, half_width, difference, measure=measure, repetitions=repetitions)
        return frame_of(asdict(one) for one in found.needs)

    def plot(self, what: str = "worlds") -> Plot:
        """Return a figure: worlds (time per metre in each), outcomes (of each trial), distributions or an overview."""
        from barn_eval.pages.figures import Plot  # noqa: PLC0415
        from barn_eval.pages.report import catalogue  # noqa: PLC0415

        if what not in _FIGURES:
            raise ConfigError(f"unknown figure {what!r}{suggest(what, _FIGURES)}")
        axes = catalogue.plot(what, read_entries([self.folder]))
        return Plot(catalogue.figure_of(axes), _FIGURES[what])

    def replay(self, trial: str, out: str | Path | None = None) -> Page:
        """Write the replay of a trial, such as "dwa_w0120_r00", and return it; a notebook shows it.

        out: file of it, as of `barn.replay` [OUT/replays/TRIAL.html]. Without a bag of the trial it is driven once more
        to make one; it is said so, and also if that drive ends otherwise than the first, as no trial in direct mode
        should.
        """
        result = self._trial(trial)
        folder = self.folder / "replays"
        page = _replay_file(out or folder / f"{trial}.html")
        bag = next((path for path in (self._source.bag(trial), folder / BAGS / trial) if path.is_dir()), None)
        return replay(bag or self._driven_again(result, folder), page)

    def overlay(self, world: int, by: str = "planner", *, planners: Sequence[str] = (), outcome: str = "") -> Plot:
        """Return the trials in a world, drawn over it; as `barn.overlay`."""
        return overlay(self, world, by, planners=planners, outcome=outcome)

    def report(self, out: str | Path = "report.html", *, title: str = "") -> Page:
        """Write the report of the results as a page that needs nothing but itself, and return it."""
        return report(self, out, title=title)

    def rerun(self, trial: str | int) -> str:
        """Run a trial once more, given by its name or its place among the rows, and compare.

        Returns the first thing in which it differs from its row, an empty text where it is reproduced.
        """
        from barn_eval.experiments.check import difference  # noqa: PLC0415

        result = self._trial(trial)
        with TemporaryDirectory() as folder:
            return difference(result, self._driven(result, Path(folder), bags="none"))

    def _trial(self, trial: str | int) -> TrialResult:
        found = {result.trial_id: result for result in self.trials}
        if isinstance(trial, int) and 0 <= trial < len(found):
            return self.trials[trial]
        if trial not in found:
            raise ConfigError(f"{self.folder}: has no trial {trial!r}{suggest(trial, found)}")
        return found[str(trial)]

    def _driven_again(self, result: TrialResult, folder: Path) -> Path:
        console = Console(stderr=True)
        console.print(f"no bag of {result.trial_id} was kept: it is driven once more", highlight=False)
        again = self._driven(result, folder, bags="all")
        if again.repeatable() != result.repeatable():
            console.print(
                f"{result.trial_id} went otherwise this time: {again.outcome.value}, not {result.outcome.value} as in"
                " its row, or by another way; its planner does not repeat itself",
                highlight=False,
            )
        return folder / BAGS / result.trial_id

    def _driven(self, result: TrialResult, folder: Path, bags: str) -> TrialResult:
        """Drive a trial once more, alone, its bag in a folder, and return its new result."""
        from barn_eval.api import work_of  # noqa: PLC0415 (which is wrapped around results)
        from barn_eval.experiments.engine import Job  # noqa: PLC0415
        from barn_eval.experiments.experiment import Execution  # noqa: PLC0415
        from barn_eval.experiments.run_file import RunFile  # noqa: PLC0415
        from barn_eval.experiments.store import Record, Store  # noqa: PLC0415

        experiment = replace(RunFile.read(self.folder).configuration(), bags=bags)
        self._require_same_planner(experiment.planners, result.planner)
        (spec,) = (one for one in experiment.trials([result.world]) if one.trial_id == result.trial_id)
        kept: list[Any] = []  # what mode ros reports on the way
        work = work_of(experiment, Execution(workers=1), Store(folder.absolute(), bags), self._live)
        done = work.run(Job(result.trial_id, (spec,)), kept.append)
        return next(one for one in (done, *kept) if isinstance(one, Record)).result

    def _require_same_planner(self, choices: Sequence[Any], name: str) -> None:
        (choice,) = (one for one in choices if one.name == name)
        if not choice.source:
            return
        if name not in self._live:
            raise ConfigError(f"planner {name!r} was a Python object: barn.load(folder, planners=...) takes it")
        if self._live[name].choice().source != choice.source:
            raise ConfigError(f"planner {name!r} is not the one of these results: its source differs")

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
        from barn_eval.analysis.measures import metric_of  # noqa: PLC0415
        from barn_eval.analysis.planners import spelling  # noqa: PLC0415
        from barn_eval.analysis.summary import summarise  # noqa: PLC0415 (scipy)
        from barn_eval.analysis.tables import headline_table  # noqa: PLC0415

        groups = by_planner(self.trials)
        summaries = [summarise(one) for one in groups.values()]
        found = headline_table([spelling(name) for name in groups], summaries, metric_of(self.trials))
        rows = [f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in row)}</tr>" for row in found.rows]
        head = "".join(f"<th>{html.escape(name)}</th>" for name in found.columns)
        return (
            f"<p>{html.escape(repr(self))}</p><p>{html.escape(self.verdict())}</p>"
            f"<table><caption>{html.escape(found.title)}</caption>"
            f"<thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>{self.plot().picture()}"
        )


def check(folder: str | Path) -> FolderCheck:
    """Check whether rows, tracks, bags, tables, worlds and configuration in a folder of results belong together.

    Returns what was looked at and, in `problems`, a line for each thing that is wrong. BarnError where there is no
    experiment at all. `Results.rerun` runs a trial again and compares.
    """
    from barn_eval.experiments.check import check_folder  # noqa: PLC0415 (message types)

    return check_folder(Path(folder))


def compare(a: Results | str | Path, b: Results | str | Path) -> Any:
    """Compare results on the same worlds and seeds: each `Results`, a folder, or "FOLDER:PLANNER".

    Returns a row per pair and measure: a, b, measure (a column of `table`), unit, mean_a, mean_b, difference (a - b)
    with the limits difference_low and difference_high of its 95 % interval over worlds, p (of the test that the two are
    alike), p_holm (the same after Holm for all pairs), p_a_better (the probability that a trial of a is better than one
    of b in the same world), worlds, trials. BarnError where they are not the same task.
    """
    from barn_eval.analysis.compare import compare_folders  # noqa: PLC0415 (scipy)

    return frame_of(row for one in compare_folders(*_folders([a, b])) for row in one.columns())


def leaderboard(folders: Folders, by: str = "", out: str | Path | None = None, *, worlds: str = "all") -> Any:
    """Rank the planners of several folders of results, each protocol and set of worlds on a board of its own.

    by: "challenge", "challenge_2022", "success" or "time", without it the metric of the protocol. out: file to write
    the boards to, ending in .md or .html. worlds: only these, such as "0-49".
    Returns a row per place: board, rank, tied (whether others share it), planner, better_than (those below that it is
    clearly better than), and the columns of `Results.summary`.
    Planners that cannot be told apart share a rank. `Results.verdict` says it in words.
    """
    from barn_eval.analysis.leaderboard import board_rows  # noqa: PLC0415 (scipy)
    from barn_eval.analysis.leaderboard import leaderboard as rank  # noqa: PLC0415
    from barn_eval.pages.report.leaderboard import write_boards  # noqa: PLC0415

    boards = rank(_folders(folders), by, worlds)
    if out is not None:
        write_boards(boards, Path(out))
    return frame_of(board_rows(boards))


def report(
    folders: Folders,
    out: str | Path = "report.html",
    *,
    title: str = "",
    assets: str | Path | None = None,
    hardest: int = 8,
    difficulty: str = "trials",
    replays: str | Path | None = None,
) -> Page:
    """Write the report of one or several folders of results as a page that needs nothing but itself, and return it.

    assets: folder for its figures (SVG, PDF) and tables (CSV, LaTeX). hardest: number of worlds drawn as maps.
    difficulty: what worlds are ordered by, "trials" or the prediction of the "model". replays: folder for a page of
    each bag, which the report links to.
    """
    from barn_eval.pages.report.page import write_report  # noqa: PLC0415 (matplotlib)

    write_report(
        _folders(folders),
        Path(out),
        assets=Path(assets) if assets else None,
        title=title,
        hardest=hardest,
        difficulty=difficulty,
        replays=Path(replays) if replays else None,
    )
    return Page(Path(out))


def replay(
    bag: str | Path | Sequence[str | Path],
    out: str | Path | None = None,
    *,
    frames_per_s: float = 10.0,
    speed: float = 2.0,
    camera: str = "",
) -> Page:
    """Write the replay of a bag, or of several on one clock, and return it; a notebook shows it.

    out: a page (.html) [named after the bag], a picture of the end (.png), an animation (.gif) or a film (.mp4).
    frames_per_s, speed: of the last two, the latter in multiples of the trial's own. camera: "chase", "top" or "side"
    draws picture, animation and film in three dimensions.
    """
    from barn_eval.pages.replay.files import write_replay  # noqa: PLC0415 (message types)

    bags = [Path(one) for one in ([bag] if isinstance(bag, (str, Path)) else bag)]
    page = _replay_file(out or f"{'_and_'.join(one.name.removesuffix('.mcap') for one in bags[:2])}.html")
    files: dict[str, Any] = {page.suffix[1:]: page}
    write_replay(bags, **files, frames_per_s=frames_per_s, speed=speed, camera=camera)
    return Page(page)


def watch(folder: str | Path, *, host: str = LOOPBACK, port: int = 0) -> Watch:
    """Serve a page that shows how an experiment stands, as it runs or afterwards; return it with its `url`.

    It is served from a thread until `close` is called or a `with` block is left. port: 0 takes any that is free.
    """
    from barn_eval.pages.live.server import Watch  # noqa: PLC0415 (message types)

    return Watch(folder, host=host, port=port)


def overlay(
    folders: Folders, world: int, by: str = "planner", *, planners: Sequence[str] = (), outcome: str = ""
) -> Plot:
    """Return the trajectories of one or several folders of results in a world, drawn over it.

    by: what they are coloured by, "planner" or "speed". planners: only these. outcome: only trials that ended so, such
    as "collision". BarnError if there is none, or if the folders do not have the same world.
    """
    from barn_eval.pages import figures as drawing  # noqa: PLC0415
    from barn_eval.pages.report.overlay import overlay as drawn  # noqa: PLC0415

    with drawing.style():
        figure = drawn(_folders(folders), world, by=by, planners=planners, outcome=outcome)
    return drawing.Plot(figure, f"trajectories of the trials in world {world}, coloured by {by}")


def frame_of(rows: Iterable[Mapping[str, Any]]) -> Any:
    """Return rows as a pandas DataFrame, or as a pyarrow Table where pandas is not installed."""
    import pyarrow as pa  # noqa: PLC0415

    return frame(pa.Table.from_pylist(list(rows)))


def frame(table: pa.Table) -> Any:
    """Return a table as a pandas DataFrame, or as it is where pandas is not installed."""
    return table.to_pandas() if find_spec("pandas") is not None else table


def replay_files(outs: Iterable[str | Path]) -> dict[str, Path]:
    """Return files of replays by what they are, as their endings say; ConfigError for another, or for two of a kind."""
    found: dict[str, Path] = {}
    for out in outs:
        path = _replay_file(out)
        if found.setdefault(path.suffix[1:], path) != path:
            raise ConfigError(f"out {str(out)!r}: one file of each kind is written")
    return found


def _replay_file(out: str | Path) -> Path:
    if Path(out).suffix not in _REPLAYS:
        raise ConfigError(f"out {str(out)!r}: must end in {', '.join(_REPLAYS)}")
    return Path(out)


def _folders(given: Folders) -> list[Path]:
    several = [given] if isinstance(given, Results | str | Path) else given
    return [one.folder if isinstance(one, Results) else Path(one) for one in several]
