"""What folders of results say together, and pages and pictures of them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, Protocol

import pandas as pd

from barn_eval.analysis.compare import compare_folders
from barn_eval.analysis.leaderboard import board_rows
from barn_eval.analysis.leaderboard import make_boards as rank
from barn_eval.analysis.pandas_tables import pandas_table
from barn_eval.pages import LOOPBACK, Progress
from barn_eval.pages.figures import Page, Plot, style
from barn_eval.pages.live.server import Watch
from barn_eval.pages.replay.files import write_replay
from barn_eval.pages.report.leaderboard import write_boards
from barn_eval.pages.report.maps import overlay as drawn
from barn_eval.pages.report.page import (
    build_report,
    checked_width,
    replay_links,
    report_page,
    write_assets,
)
from barn_eval.pages.template import write_page
from barn_eval.verification.check import FolderCheck, check_folder
from barn_worlds.base.errors import ConfigError, format_value


class HasFolder(Protocol):
    """Results, which know their folder."""

    folder: Path


Folder = HasFolder | str | Path
Folders = Folder | Sequence[Folder]


def check(folder: str | Path, sample: int | None = None) -> FolderCheck:
    """Compute the results in a folder again, from its tracks and bags, and drive recorded commands again.

    `Results.rerun` runs a trial again with its planner, and compares.

    Args:
        folder: Of an experiment, finished or not.
        sample: Of so many trials commands are driven again. Default: of all.

    Returns:
        What was looked at and, in `problems`, a line for each thing that is wrong.

    Raises:
        BarnError: There is no experiment at all.
    """
    return check_folder(Path(folder), sample=sample)


def compare(a: Folder, b: Folder) -> pd.DataFrame:
    """Compare results on the same worlds and seeds.

    Args:
        a: `Results`, a folder, or "FOLDER:PLANNER".
        b: Likewise.

    Returns:
        A row per pair and measure: a, b, measure (a column of `table`), unit, mean_a, mean_b, difference (a - b) with
        the limits difference_low and difference_high of its 95 % interval over worlds, p (of the test that the two are
        alike), p_holm (the same after Holm for all pairs), p_a_better (the probability that a trial of a is better than
        one of b in the same world), worlds, trials.

    Raises:
        BarnError: They are not the same task, or have no world in common.
    """
    return pandas_table(
        row for one in compare_folders(*paths_of([a, b])) for row in one.columns()
    )


def leaderboard(
    folders: Folders,
    by: Literal[
        "", "challenge", "challenge_2022", "efficiency", "success", "time"
    ] = "",
    out: str | Path | None = None,
    *,
    worlds: str = "all",
) -> pd.DataFrame:
    """Rank the planners of several folders of results, each protocol and set of worlds on a board of its own.

    Planners that cannot be told apart share a rank. `Results.verdict` says it in words.

    Args:
        folders: `Results` or folders.
        by: What is ranked by; without it the metric of the protocol.
        out: File to write the boards to, ending in .md or .html.
        worlds: Only these, such as "0-49".

    Returns:
        A row per place: board, rank, tied (whether others share it), planner, better_than (those below that it is
        clearly better than), and the columns of `Results.summary`.

    Raises:
        BarnError: There are no results, or the ranking is not known.
    """
    boards = rank(paths_of(folders), by, worlds)
    if out is not None:
        write_boards(boards, Path(out))
    return pandas_table(board_rows(boards), tied="bool", better_than="object")


def report(
    folders: Folders,
    out: str | Path = "report.html",
    *,
    title: str = "",
    assets: str | Path | None = None,
    hardest: int = 8,
    replays: str | Path | None = None,
    columns: Sequence[str] = (),
    width_mm: float | None = None,
    progress: Progress = lambda _: None,
) -> Page:
    """Write the report of one or several folders of results as a page that needs nothing but itself.

    Args:
        folders: `Results` or folders, finished or not.
        out: The page.
        title: Its title.
        assets: Folder for its figures (SVG, PDF) and tables (CSV, LaTeX).
        hardest: Number of worlds drawn as maps.
        replays: Folder for a page of each bag, which the report links to.
        columns: Measures of its tables, columns of `Results.table`. Default: success, times and scores.
        width_mm: Width of the figures in `assets` [mm]; their type is of 7 to 9 pt then.
        progress: Gets the share that is done.

    Returns:
        The page, which a notebook shows.

    Raises:
        BarnError: There are no results, or a file cannot be written.
    """
    page = Path(out)
    pdf = assets is not None and checked_width(width_mm) is None
    made = build_report(
        paths_of(folders), hardest, columns=columns, progress=progress, pdf=pdf
    )
    links = replay_links(made, page, Path(replays) if replays else None)
    write_page(
        page,
        report_page(
            made, title or f"Navigation benchmark: {', '.join(made.names)}", links
        ),
    )
    if assets is not None:
        write_assets(made, Path(assets), width_mm)
    return Page(page)


def replay(
    bag: str | Path | Sequence[str | Path],
    out: str | Path | None = None,
    *,
    frames_per_s: float = 10.0,
    speed: float = 2.0,
    camera: Literal["chase", "top", "side"] = "top",
) -> Page:
    """Write the replay of a bag, or of several on one clock.

    Args:
        bag: Folder of a bag, or its .mcap file.
        out: A page (.html), a picture of the end (.png), an animation (.gif) or a film (.mp4). Default: a page named
            after the bag.
        frames_per_s: Of animation and film [1/s].
        speed: Of animation and film, in multiples of the trial's own.
        camera: How picture, animation and film are seen.

    Returns:
        The page or picture, which a notebook shows.

    Raises:
        BarnError: A bag cannot be read, or the file not be written.
    """
    bags = [Path(one) for one in ([bag] if isinstance(bag, str | Path) else bag)]
    outs = [] if out is None else [out]
    return Page(
        *write_replay(bags, outs, frames_per_s=frames_per_s, speed=speed, camera=camera)
    )


def watch(folder: str | Path, *, host: str = LOOPBACK, port: int = 0) -> Watch:
    """Serve a page that shows how an experiment stands, as it runs or afterwards.

    It is served from a thread until `close` is called or a `with` block is left.

    Args:
        folder: Of the experiment.
        host: Address to serve on; others than loopback see it.
        port: 0 takes any that is free.

    Returns:
        What serves it, with its `url`.

    Raises:
        BarnError: There is no experiment, or the address cannot be served on.
    """
    return Watch(folder, host=host, port=port)


def overlay(
    folders: Folders,
    world: int,
    by: str = "planner",
    *,
    planners: Sequence[str] = (),
    outcome: str = "",
) -> Plot:
    """Return the trajectories of one or several folders of results in a world, drawn over it.

    Args:
        folders: `Results` or folders.
        world: Number of the world.
        by: What they are coloured by, "planner" or "speed".
        planners: Only these.
        outcome: Only trials that ended so, such as "collision".

    Returns:
        The figure.

    Raises:
        BarnError: There is no such trial, or the folders do not have the same world.
    """
    with style():
        figure = drawn(
            paths_of(folders), world, by=by, planners=planners, outcome=outcome
        )
    return Plot(
        figure, f"trajectories of the trials in world {world}, coloured by {by}"
    )


def paths_of(given: Folders) -> list[Path]:
    """Return the folders of what is given; ConfigError for what has none."""
    several = (
        given if isinstance(given, Sequence) and not isinstance(given, str) else [given]
    )
    for one in several:
        if not isinstance(getattr(one, "folder", one), str | Path):
            raise ConfigError(
                f"results must be Results or a folder, got {format_value(one)}"
            )
    return [Path(one if isinstance(one, str | Path) else one.folder) for one in several]
