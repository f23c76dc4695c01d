"""`barn watch`: the page of an experiment that updates itself, and the live view of its trials."""

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import click

from barn_eval.commands.options import PATH, say
from barn_eval.pages import LIVE_PORT, LOOPBACK, PAGE_PORT
from barn_eval.pages.live.foxglove import FoxgloveStream, require_sdk
from barn_eval.pages.live.server import PageServer
from barn_eval.results.run_file import RUN_FILE
from barn_worlds.base.errors import ConfigError

_PORTS = click.IntRange(0, 65535)
_LOOK_S = 0.5


@click.command("watch")
@click.argument("folder", type=PATH)
@click.option(
    "--port", default=PAGE_PORT, type=_PORTS, help="Of the page; 0 takes a free one."
)
@click.option(
    "--host", default=LOOPBACK, help="Address to serve on; others than loopback see it."
)
@click.option(
    "--live",
    is_flag=False,
    flag_value=LIVE_PORT,
    type=_PORTS,
    metavar="[PORT]",
    help=f"Serve the trial that is being recorded to Foxglove as well [default port: {LIVE_PORT}].",
)
@click.option("--wait", is_flag=True, help="Wait for the folder to be there.")
def command(folder: Path, port: int, host: str, live: int | None, wait: bool) -> None:
    """Serve a page that shows how the experiment in FOLDER stands, until Ctrl-C.

    Progress, who leads, failures as they come, and a replay of each bag, drawn when it is asked for. Everything comes
    from the files, so that trials may run, have stopped, or run on another machine that shares the folder. The live
    view needs bags, and foxglove-sdk.
    """
    with ExitStack() as served:
        if live is not None:
            view = served.enter_context(FoxgloveStream(folder, host=host, port=live))
            say(
                f"live view: open {view.url} in Foxglove with share/barn_eval/config/barn_foxglove.json"
            )
        while wait and not (folder / RUN_FILE).is_file():
            threading.Event().wait(_LOOK_S)
        page = served.enter_context(PageServer(folder, host=host, port=port))
        say(f"{page.url} shows {folder}; Ctrl-C ends it")
        threading.Event().wait()


@contextmanager
def viewed(folder: Path, bags: str) -> Iterator[None]:
    """Serve page and live view of a folder from a process of its own for as long as the context lasts.

    ConfigError where no bags are recorded, which the view reads, or where the SDK is not installed.
    """
    if bags == "none":
        raise ConfigError(
            "--view needs bags, which it reads: --bags all or --bags failed, got none"
        )
    require_sdk()
    command = [
        sys.executable,
        "-m",
        "barn_eval.commands.watch",
        str(folder),
        "--live",
        "--wait",
    ]
    # Ctrl-C is for the trials; the view ends with them.
    with subprocess.Popen(  # noqa: S603
        command, stdin=subprocess.PIPE, start_new_session=True
    ) as process:
        try:
            yield
        finally:
            process.terminate()


def _end_with_parent() -> None:
    sys.stdin.read()
    os._exit(0)


if __name__ == "__main__":  # as `viewed` starts it
    threading.Thread(target=_end_with_parent, daemon=True).start()
    command()
