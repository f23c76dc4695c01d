"""Functions on one or several results folders: compare, rank, report, replay, watch."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal, Protocol, TypeAlias

import pandas as pd

from barn_eval.analysis.compare import Comparison, compare_folders
from barn_eval.analysis.leaderboard import board_rows
from barn_eval.analysis.leaderboard import make_boards as rank_folders
from barn_eval.analysis.pandas_tables import pandas_table
from barn_eval.pages import LOOPBACK, Progress
from barn_eval.pages.figures import Page, Plot, style
from barn_eval.pages.live.server import PageServer
from barn_eval.pages.replay.files import write_replay
from barn_eval.pages.report.leaderboard import write_boards
from barn_eval.pages.report.maps import overlay as draw_overlay
from barn_eval.pages.report.page import (
    build_report,
    replay_links,
    require_width,
    write_assets,
    write_report,
)
from barn_eval.verification.check import FolderCheck, check_folder
from barn_worlds.base.errors import ConfigError, format_value


class HasFolder(Protocol):
    """Results, which have a folder."""

    folder: Path


Folder: TypeAlias = HasFolder | str | Path
Folders: TypeAlias = Folder | Sequence[Folder]


def check(folder: str | Path, sample: int | None = None) -> FolderCheck:
    """Check a folder: recompute its rows, drive its commands again, list what differs.

    `Results.rerun` runs a trial again with its planner and compares.

    Args:
        folder: Folder of a run, finished or not.
        sample: Number of trials whose commands are driven again. Default: all.

    Returns:
        What was checked and, in `problems`, a line for each thing that is wrong.

    Raises:
        BarnError: If the folder has no run.
    """
    return check_folder(Path(folder), sample=sample)


def compare(a: Folder, b: Folder) -> pd.DataFrame:
    """Compare planners of two results folders on worlds and seeds that both have.

    Args:
        a: `Results`, a folder, or "FOLDER:PLANNER".
        b: The results that `a` is compared with, likewise.

    Returns:
        A row per pair and measure: a, b, measure (a column of `table`), unit, mean_a,
        mean_b, difference (a - b) with the limits difference_low and difference_high of
        its 95% interval over worlds, p (of the test that both are alike), p_holm (the
        same, adjusted by Holm for all pairs), p_a_better (probability that a trial of a
        is better than one of b in the same world), worlds, trials.

    Raises:
        BarnError: If the results differ in task, or have no world in common.
    """
    return comparisons_frame(compare_folders(*folder_paths([a, b])))


def comparisons_frame(comparisons: Iterable[Comparison]) -> pd.DataFrame:
    """Return the DataFrame of `compare`: a row per comparison and measure."""
    return pandas_table(
        row for comparison in comparisons for row in comparison.columns()
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
    """Rank the planners of folders in a DataFrame; write the boards to `out` if given.

    Each protocol, speed class, compute mode and set of worlds has its own board.

    Planners whose difference is not significant share a rank. `Results.verdict` states
    the ranking in words.

    Args:
        folders: `Results` or folders.
        by: Measure to rank by. Default: that of the protocol.
        out: File for the boards, .md or .html. By default, none is written.
        worlds: World numbers, such as "0-49".

    Returns:
        A row per place: board, rank, tied (whether others share it), planner,
        better_than (planners that it is clearly better than), and the columns of
        `Results.summary`.

    Raises:
        BarnError: If there are no results, or the measure is not known.
    """
    boards = rank_folders(folder_paths(folders), by, worlds)
    # Unlike the DataFrame, the file has notes and titles.
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
    """Write a report page of folders (its data beside it if large); return the page.

    With more than 2000 trials, their data go to a folder OUT_data beside the page.

    Args:
        folders: `Results` or folders, finished or not.
        out: The page.
        title: Title of the page.
        assets: Folder for its figures (SVG, PDF) and tables (CSV, LaTeX).
        hardest: Number of worlds in the figure of the hardest, in `assets`.
        replays: Folder for a page on each bag, which the report links to.
        columns: Measures in its tables: columns of `Results.table`. Default: success,
            times and scores.
        width_mm: Width of the figures in `assets` [mm]; their type is then 7 to 9 pt.
        progress: Called with the share done, 0 to 1.

    Returns:
        The page, which a notebook shows.

    Raises:
        BarnError: If there are no results, or a file cannot be written.
    """
    require_width(width_mm)
    content = build_report(
        folder_paths(folders),
        # The page has all worlds as maps that its script draws.
        0 if assets is None else hardest,
        columns=columns,
        progress=progress,
    )
    page = Path(out)
    links = replay_links(content, page, Path(replays) if replays else None)
    # Names of folders distinguish reports in a list of browser tabs.
    heading = title or f"Navigation benchmark: {', '.join(content.names)}"
    write_report(content, page, heading, links)
    if assets is not None:
        write_assets(content, Path(assets), width_mm)
    return Page(page)


def replay(
    bag: str | Path | Sequence[str | Path],
    out: str | Path | None = None,
    *,
    frames_per_s: float = 10.0,
    speed: float = 2.0,
    camera: Literal["chase", "top", "side"] = "top",
) -> Page:
    """Write the replay of one or several bags as .html, .png, .gif or .mp4; return it.

    Args:
        bag: Folder of a bag or its .mcap file, or several.
        out: A page (.html), a picture of the end (.png), an animation (.gif) or a film
            (.mp4). Default: a page named after the bag.
        frames_per_s: Frame rate of animation and film [1/s].
        speed: Playback speed of animation and film, as a multiple of real time.
        camera: View of picture, animation and film.

    Returns:
        The page or picture, which a notebook shows.

    Raises:
        BarnError: If a bag cannot be read, or the file cannot be written.
    """
    # A text is a sequence, too, but of characters.
    bags = [bag] if isinstance(bag, str | Path) else bag
    paths = write_replay(
        [Path(path) for path in bags],
        [] if out is None else [out],
        frames_per_s=frames_per_s,
        speed=speed,
        camera=camera,
    )
    return Page(*paths)


def watch(folder: str | Path, *, host: str = LOOPBACK, port: int = 0) -> PageServer:
    """Start a server of a page on a run's state in a new thread, and return it.

    It serves until `close` is called or its `with` block ends.

    Args:
        folder: Folder of the run.
        host: Address to serve on; any but loopback lets other machines see the page.
        port: Port; 0 selects a free one.

    Returns:
        The server, with its `url`.

    Raises:
        BarnError: If the folder has no run, or the address cannot be served on.
    """
    return PageServer(folder, host=host, port=port)


def overlay(
    folders: Folders,
    world: int,
    by: str = "planner",
    *,
    planners: Sequence[str] = (),
    outcome: str = "",
) -> Plot:
    """Return a plot of the trajectories in a world, from folders, over the world's map.

    Args:
        folders: `Results` or folders.
        world: Number in the data set.
        by: What the color shows, "planner" or "speed".
        planners: Only trials of these planners.
        outcome: Only trials with this outcome, such as "collision".

    Returns:
        The figure.

    Raises:
        BarnError: If there is no such trial, or the folders have different worlds of
            that number.
    """
    # Fonts and colors of reports, whatever the notebook has set for matplotlib.
    with style():
        figure = draw_overlay(
            folder_paths(folders), world, by=by, planners=planners, outcome=outcome
        )
    return Plot(figure, f"trajectories of the trials in world {world}, colored by {by}")


def folder_paths(folders: Folders) -> list[Path]:
    """Return paths of `Results` or folders, maybe missing; ConfigError for other items.

    Raises:
        ConfigError: If an item is neither.
    """
    if isinstance(folders, str) or not isinstance(folders, Sequence):
        folders = [folders]
    paths = []
    for item in folders:
        # `Results` are not imported here: their module imports this one.
        path = getattr(item, "folder", item)
        if not isinstance(path, str | Path):
            raise ConfigError(
                f"results must be Results or a folder, got {format_value(item)}"
            )
        paths.append(Path(path))
    return paths
