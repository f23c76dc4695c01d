"""`barn check`, `compare`, `precision`, `leaderboard`, `report`, `replay`: what results and bags of trials say."""

from pathlib import Path

import click

from barn_eval.commands.options import FILE, PATH, console, json_option, notes, print_json, progress, say
from barn_eval.commands.tables import rich_table
from barn_eval.pages import DIFFICULTIES
from barn_worlds.base.config import as_dict

RANKINGS = ("challenge", "challenge_2022", "success", "time")  # of barn_eval.analysis.leaderboard, which takes long
CAMERAS = ("chase", "top", "side")  # of barn_sim.sensors.camera, which loads PyBullet
_ABOVE_ZERO = click.FloatRange(0.0, min_open=True)


@click.command()
@click.argument("folder", type=PATH)
@click.option("--rerun", metavar="TRIAL", help="Run a trial again, by its name or number from 1, and compare.")
@json_option
def check(folder: Path, rerun: str | None, as_json: bool) -> int:
    """Check that rows, tracks, bags, tables, worlds and configuration in FOLDER belong together.

    FOLDER is of a run or campaign, finished or not. Exit code 1 if anything is wrong, with a line for each.
    """
    from barn_eval.experiments.check import check_folder  # noqa: PLC0415 (message types)
    from barn_eval.results import Results  # noqa: PLC0415

    found = check_folder(folder)
    reproduced = None
    if rerun is not None and not found.problems:
        results = Results(folder)
        places = {str(number): number - 1 for number in range(1, len(results) + 1)}
        other = results.rerun(places.get(rerun, rerun))
        reproduced = not other
        found.problems += [f"{folder}: {rerun} is not reproduced: {other}"] if other else []
    if as_json:
        print_json(as_dict(found) | {"reproduced": reproduced})
    else:
        of = f"{found.rows} of {found.trials} rows, {found.tracks} tracks, {found.bags} bags"
        unchecked = f"; {found.unchecked} lines without a checksum, of an earlier version" if found.unchecked else ""
        console.print(of + unchecked, highlight=False)
        if reproduced:
            console.print(f"{rerun} is reproduced", highlight=False)
        for line in found.problems:
            click.echo(line, err=True)
    return int(bool(found.problems))


@click.command()
@click.argument("a", type=PATH)
@click.argument("b", type=PATH, required=False)
@json_option
def compare(a: Path, b: Path | None, as_json: bool) -> None:
    """Compare A with B: folders of runs or campaigns, finished or not. Without B, the planners of A with each other.

    FOLDER:PLANNER chooses one of several planners, FOLDER:PLANNER,PLANNER some. Where both folders hold several and
    none is chosen, planners of the same name are compared.
    """
    from barn_eval.analysis.compare import compare_folders  # noqa: PLC0415 (scipy)
    from barn_eval.analysis.tables import comparison_table  # noqa: PLC0415
    from barn_eval.analysis.verdict import pair_verdict  # noqa: PLC0415
    from barn_eval.trials.identity import task_line  # noqa: PLC0415

    with progress("comparing") as (_, share):
        found = compare_folders(a, b, share=share)
    if as_json:
        print_json([as_dict(one) | {"verdict": pair_verdict(one)} for one in found])
        return
    console.print(task_line(found[0].protocol, found[0].task, found[0].robot), highlight=False)
    for one in found:
        console.print(pair_verdict(one), markup=False, highlight=False)
        console.print(rich_table(comparison_table(one)))


@click.command()
@click.argument("folder", type=PATH)
@click.option("--half-width", type=_ABOVE_ZERO, help="Half the 95 % interval wanted of a mean [default: 5 % of it].")
@click.option(
    "--difference",
    type=_ABOVE_ZERO,
    help="Difference of two planners to be found 8 times in 10 [default: 5 % of the first one's mean].",
)
@click.option("--measure", default="", help="A column of the results [default: the metric of the protocol].")
@click.option("--repetitions", type=click.IntRange(1), help="Trials per world [default: 1, 2, 3, 5 and 10].")
@json_option
def precision(
    folder: Path,
    half_width: float | None,
    difference: float | None,
    measure: str,
    repetitions: int | None,
    as_json: bool,
) -> None:
    """Say how many worlds a wanted precision needs, from the results in FOLDER.

    FOLDER:PLANNER, or FOLDER:PLANNER,PLANNER, chooses one or two of several planners. Wanted values are in the unit of
    the measure, of success as a share such as 0.05.
    """
    from barn_eval.analysis.compare import chosen_results  # noqa: PLC0415 (scipy)
    from barn_eval.analysis.precision import figures_table, needs_table  # noqa: PLC0415
    from barn_eval.analysis.precision import precision as estimate  # noqa: PLC0415
    from barn_eval.trials.identity import task_line  # noqa: PLC0415

    results = chosen_results(folder).planners
    found = estimate(results, half_width, difference, measure=measure, repetitions=repetitions)
    if as_json:
        print_json(as_dict(found))
        return
    first = next(iter(results.values()))[0]
    console.print(task_line(first.protocol, first.task), highlight=False)
    console.print(rich_table(figures_table(found)), rich_table(needs_table(found)))


@click.command()
@click.argument("folders", nargs=-1, required=True, type=PATH)
@click.option("--by", type=click.Choice(RANKINGS), help="What is ranked by [default: the metric of the protocol].")
@click.option("--out", type=PATH, help="File ending in .md or .html [default: tables, printed].")
@click.option("--html", type=FILE, help="Write it as HTML as well.")
@click.option("--worlds", default="all", show_default=True, help="Only these, such as 0-49.")
@json_option
def leaderboard(
    folders: tuple[Path, ...], by: str | None, out: Path | None, html: Path | None, worlds: str, as_json: bool
) -> None:
    """Rank the planners of FOLDERS of runs or campaigns.

    Planners that cannot be told apart share a rank. Each protocol and set of worlds has a board of its own.
    """
    from barn_eval.analysis.leaderboard import board_rows  # noqa: PLC0415 (scipy)
    from barn_eval.analysis.leaderboard import leaderboard as rank  # noqa: PLC0415
    from barn_eval.analysis.verdict import verdict  # noqa: PLC0415
    from barn_eval.pages.report.leaderboard import board_table, page, write_boards  # noqa: PLC0415
    from barn_eval.pages.template import write_page  # noqa: PLC0415

    if out is not None and out.suffix not in (".md", ".html"):
        raise click.UsageError(f"--out {out}: must end in .md or .html")
    with notes.status("ranking"):
        boards = rank(folders, by or "", worlds)
    if as_json:
        verdicts = [verdict(board.ranking, board.measure) for board in boards]
        print_json({"verdicts": verdicts, "places": board_rows(boards)})
    elif out is None:
        for board in boards:
            for line in (verdict(board.ranking, board.measure), *board.notes):
                console.print(line, markup=False, highlight=False)
            console.print(rich_table(board_table(board)))
    if out is not None:
        write_boards(boards, out)
    if html is not None:
        write_page(html, page(boards))
    for path in filter(None, (out, html)):
        say(path)


@click.command()
@click.argument("folders", nargs=-1, required=True, type=PATH)
@click.option("--out", default="report.html", show_default=True, type=PATH, help="The page.")
@click.option("--assets", type=PATH, help="Folder of figures and tables [default: OUT_assets].")
@click.option("--no-assets", is_flag=True, help="Write the page only.")
@click.option("--title", help="Title of the page.")
@click.option("--hardest", default=8, show_default=True, type=click.IntRange(0, 40), help="Worlds drawn as maps.")
@click.option(
    "--difficulty",
    type=click.Choice(DIFFICULTIES),
    default=DIFFICULTIES[0],
    show_default=True,
    help="What worlds are ordered by: the trials themselves, or the model's prediction.",
)
@click.option("--replays", is_flag=True, help="Draw the replay of each bag into OUT_replays and link to it.")
def report(
    folders: tuple[Path, ...],
    out: Path,
    assets: Path | None,
    no_assets: bool,
    title: str | None,
    hardest: int,
    difficulty: str,
    replays: bool,
) -> None:
    """Write the report of FOLDERS of runs or campaigns, finished or not.

    Figures go beside the page as SVG and PDF, tables as CSV and LaTeX.
    """
    from barn_eval.pages.report.page import write_report  # noqa: PLC0415 (matplotlib)

    if out.is_dir():
        raise click.UsageError(f"--out {out}: is a folder, name a file")
    beside = None if no_assets else assets or out.with_name(f"{out.stem}_assets")
    with progress("reading results") as (note, share):
        write_report(
            folders,
            out,
            assets=beside,
            title=title or "",
            hardest=hardest,
            difficulty=difficulty,
            replays=out.with_name(f"{out.stem}_replays") if replays else None,
            note=note,
            share=share,
        )
    say(out)
    if beside is not None:
        say(f"figures and tables in {beside}")


@click.command()
@click.argument("bags", type=PATH, nargs=-1, required=True)
@click.option("--html", type=FILE, help="A page with play, zoom, ruler and jumps to events [default: NAME.html].")
@click.option("--png", type=FILE, help="A picture of the end of the trial.")
@click.option("--gif", type=FILE, help="An animation.")
@click.option("--mp4", type=FILE, help="A film; needs ffmpeg.")
@click.option("--camera", type=click.Choice(CAMERAS), help="Picture, GIF and film in three dimensions, seen so.")
@click.option("--fps", default=10.0, show_default=True, type=click.FloatRange(1.0, 60.0), help="Frames per second.")
@click.option("--speed", default=2.0, show_default=True, type=click.FloatRange(0.1, 100.0), help="Of GIF and film.")
def replay(
    bags: tuple[Path, ...],
    html: Path | None,
    png: Path | None,
    gif: Path | None,
    mp4: Path | None,
    camera: str | None,
    fps: float,
    speed: float,
) -> None:
    """Draw the trial of a bag: a rosbag2 folder (MCAP or SQLite) or an .mcap file.

    Several BAGS are drawn beside each other on one clock; their page also overlays them and aligns them in progress
    along the path. Nothing but the bags is needed. One that is cut off is shown as far as it goes.
    """
    from barn_eval.pages.replay.page import write_replay  # noqa: PLC0415 (scipy and message types)

    files = {"html": html, "png": png, "gif": gif, "mp4": mp4}
    with progress("drawing" if gif or mp4 or camera else "reading") as (_, share):
        written = write_replay(bags, **files, frames_per_s=fps, speed=speed, camera=camera or "", note=say, share=share)
    for path in written:
        say(path)
