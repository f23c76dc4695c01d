"""`barn watch`: the page of a campaign that updates itself."""

import threading
from pathlib import Path

import click

from barn_eval.commands.options import PATH, say

PORT, LOOPBACK = 8350, "127.0.0.1"  # of barn_eval.pages.watch, which takes long


@click.command()
@click.argument("folder", type=PATH)
@click.option("--port", default=PORT, show_default=True, type=click.IntRange(0, 65535), help="0 takes a free one.")
@click.option("--host", default=LOOPBACK, show_default=True, help="Address to serve on; others than loopback see it.")
def watch(folder: Path, port: int, host: str) -> None:
    """Serve a page that shows how the run or campaign in FOLDER stands, until Ctrl-C.

    Progress, who leads, failures as they come, and a replay of each bag, drawn when it is asked for. Everything comes
    from the files, so that a campaign may run, have stopped, or run on another machine that shares the folder.
    """
    from barn_eval.pages.watch import Watch  # noqa: PLC0415 (scipy and message types)

    with Watch(folder, host=host, port=port) as page:
        say(f"{page.url} shows {folder}; Ctrl-C ends it")
        threading.Event().wait()
