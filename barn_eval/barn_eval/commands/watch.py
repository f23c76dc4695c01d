"""`barn watch`: the page of a campaign that updates itself, and the live view of its trials."""

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import click

from barn_eval.commands.options import PATH, say
from barn_eval.experiments.run_file import RUN_FILE
from barn_eval.pages import LIVE_PORT, LOOPBACK, PAGE_PORT
from barn_worlds.base.errors import ConfigError

_PORTS = click.IntRange(0, 65535)
_LOOK_S = 0.5


@click.command()
@click.argument("folder", type=PATH)
@click.option("--port", default=PAGE_PORT, show_default=True, type=_PORTS, help="Of the page; 0 takes a free one.")
@click.option("--host", default=LOOPBACK, show_default=True, help="Address to serve on; others than loopback see it.")
@click.option("--live", is_flag=True, help="Serve the trial that is being recorded to Foxglove as well.")
@click.option("--live-port", default=LIVE_PORT, show_default=True, type=_PORTS, help="Of the live view.")
@click.option("--wait", is_flag=True, help="Wait for the folder to be there.")
@click.option("--with-parent", is_flag=True, hidden=True, help="End when standard input does.")
def watch(folder: Path, port: int, host: str, live: bool, live_port: int, wait: bool, with_parent: bool) -> None:
    """Serve a page that shows how the run or campaign in FOLDER stands, until Ctrl-C.

    Progress, who leads, failures as they come, and a replay of each bag, drawn when it is asked for. Everything comes
    from the files, so that a campaign may run, have stopped, or run on another machine that shares the folder. The live
    view needs bags, and foxglove-sdk.
    """
    from barn_eval.pages.live.foxglove import LiveView  # noqa: PLC0415 (message types)
    from barn_eval.pages.live.server import Watch  # noqa: PLC0415 (scipy and message types)

    if with_parent:
        threading.Thread(target=_end_with_parent, daemon=True).start()
    with ExitStack() as served:
        if live:
            view = served.enter_context(LiveView(folder, host=host, port=live_port))
            say(f"live view: open {view.url} in Foxglove with share/barn_eval/config/barn_foxglove.json")
        while wait and not (folder / RUN_FILE).is_file():
            threading.Event().wait(_LOOK_S)
        page = served.enter_context(Watch(folder, host=host, port=port))
        say(f"{page.url} shows {folder}; Ctrl-C ends it")
        threading.Event().wait()


@contextmanager
def viewed(folder: Path, bags: str) -> Iterator[None]:
    """Serve page and live view of a folder from a process of its own for as long as the context lasts.

    ConfigError where no bags are recorded, which the view reads, or where the SDK is not installed.
    """
    from barn_eval.pages.live.foxglove import require_sdk  # noqa: PLC0415

    if bags == "none":
        raise ConfigError("--view needs bags, which it reads: --bags all or --bags failed, got none")
    require_sdk()
    command = [sys.executable, "-m", "barn_eval", "watch", str(folder), "--live", "--wait", "--with-parent"]
    # Ctrl-C is for the trials; the view ends with them.
    with subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True) as process:  # noqa: S603
        try:
            yield
        finally:
            process.terminate()


def _end_with_parent() -> None:
    sys.stdin.read()
    os._exit(0)
