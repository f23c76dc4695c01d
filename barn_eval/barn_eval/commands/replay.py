"""`barn replay`: draw trials from their bags as a page, picture, animation or film."""

from pathlib import Path

import click

from barn_eval.commands.options import (
    field_option,
    file_option,
    path_argument,
    print_notes,
    progress_bar,
)
from barn_eval.pages.replay.files import write_replay
from barn_eval.results.bags.sources import Sources
from barn_eval.running.judge import JudgeOptions
from barn_sim.drawing.camera import CAMERAS

_OPTIONS = JudgeOptions()


@click.command("replay")
@path_argument("bags", nargs=-1, required=True)
@file_option(
    "--out",
    multiple=True,
    help="File to write: a page (.html), a picture of the trial's end (.png), an animation"
    " (.gif) or a video (.mp4, needs ffmpeg); repeatable [default: NAME.html].",
)
@click.option(
    "--camera",
    type=click.Choice(CAMERAS),
    default="top",
    help="Camera view in pictures, GIFs and videos.",
)
@click.option(
    "--fps", default=10.0, type=click.FloatRange(1.0, 60.0), help="Frames per second."
)
@click.option(
    "--speed",
    default=2.0,
    type=click.FloatRange(0.1, 100.0),
    help="Playback speed of GIFs and videos, as a multiple of real time.",
)
@field_option(_OPTIONS, "pose")
@field_option(_OPTIONS, "goal")
@field_option(_OPTIONS, "contact")
@field_option(_OPTIONS, "namespace")
def command(
    bags: tuple[Path, ...],
    out: tuple[Path, ...],
    camera: str,
    fps: float,
    speed: float,
    **names: str | None,
) -> None:
    """Draw trials from BAGS: rosbag2 folders or files (MCAP or SQLite), or ROS 1 bags.

    Several bags are drawn side by side with one shared clock. The page can also overlay
    them and align them by progress along the path. A damaged bag is shown up to the
    damage.
    """
    # For a page or a picture, reading the bags takes most of the time.
    has_frames = any(path.suffix in (".gif", ".mp4") for path in out)
    with progress_bar("drawing" if has_frames else "reading") as progress:
        paths = write_replay(
            bags,
            out,
            frames_per_s=fps,
            speed=speed,
            camera=camera,
            sources=Sources(**{key: name or "" for key, name in names.items()}),
            note=print_notes,
            progress=progress,
        )
    print_notes(*paths)
