"""`barn replay`: a trial drawn from its bag alone."""

from pathlib import Path

import click

from barn_eval.commands.options import FILE, PATH, say


@click.command()
@click.argument("bag", type=PATH)
@click.option("--html", type=FILE, help="A page with play, pause, scrub and speed [default: NAME.html].")
@click.option("--png", type=FILE, help="A picture of the end of the trial.")
@click.option("--gif", type=FILE, help="An animation.")
@click.option("--mp4", type=FILE, help="A film; needs ffmpeg.")
@click.option("--fps", default=10.0, show_default=True, type=click.FloatRange(1.0, 60.0), help="Frames per second.")
@click.option("--speed", default=2.0, show_default=True, type=click.FloatRange(0.1, 100.0), help="Of GIF and film.")
def replay(
    bag: Path, html: Path | None, png: Path | None, gif: Path | None, mp4: Path | None, fps: float, speed: float
) -> None:
    """Draw the trial of a BAG: a rosbag2 folder (MCAP or SQLite) or an .mcap file.

    Nothing but the bag is needed. One that is cut off is shown as far as it goes.
    """
    from barn_eval.pages.replay_page import write_replay  # noqa: PLC0415 (scipy and message types)

    for path in write_replay(bag, html=html, png=png, gif=gif, mp4=mp4, frames_per_s=fps, speed=speed, note=say):
        say(path)
