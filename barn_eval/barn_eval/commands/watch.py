"""`barn watch`: serve a page on a run's progress, and a live view of its trials."""

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import click

from barn_eval.commands.options import flag_option, folder_argument, print_notes
from barn_eval.pages import LIVE_PORT, LOOPBACK, PAGE_PORT
from barn_eval.pages.live.foxglove import FoxgloveStream, require_sdk
from barn_eval.pages.live.server import PageServer
from barn_eval.results.run_file import RUN_FILE
from barn_worlds.base.errors import ConfigError

_PORTS = click.IntRange(0, 65535)
# Between two looks for a folder that a run is about to make.
_LOOK_PERIOD_S = 0.5


@click.command("watch")
@folder_argument
@click.option(
    "--port",
    default=PAGE_PORT,
    type=_PORTS,
    help="Port of the page; 0 selects a free port.",
)
@click.option(
    "--host",
    default=LOOPBACK,
    help="Address to serve the page on. With any address except loopback, other machines can see the page.",
)
@click.option(
    "--live",
    is_flag=False,
    flag_value=LIVE_PORT,
    type=_PORTS,
    metavar="[PORT]",
    help=f"Also stream the current trial to Foxglove [default port: {LIVE_PORT}].",
)
@flag_option("--wait", help="Wait until FOLDER exists.")
def command(folder: Path, port: int, host: str, live: int | None, wait: bool) -> None:
    """Serve a page that shows the state of the run in FOLDER. Stop with Ctrl-C.

    The page shows progress, the current ranking, failures, and, on request, a replay of
    each bag. The command only reads files, so the run may be finished or may run on
    another machine that shares the folder. The live view needs bags and foxglove-sdk.
    """
    # Never set: waiting for it lets Ctrl-C end this thread.
    forever = threading.Event()
    with ExitStack() as servers:
        if live is not None:
            stream = FoxgloveStream(folder, host=host, port=live)
            servers.enter_context(closing(stream))
            print_notes(
                f"live view: open {stream.url} in Foxglove and import share/barn_eval/config/barn_foxglove.json"
            )
        while wait and not (folder / RUN_FILE).is_file():
            forever.wait(_LOOK_PERIOD_S)
        page = servers.enter_context(PageServer(folder, host=host, port=port))
        print_notes(f"{page.url} shows {folder}; press Ctrl-C to end")
        forever.wait()


@contextmanager
def serve_view(folder: Path, bags: str) -> Iterator[None]:
    """Serve page and live view from a child process in a context; ConfigError if no bags.

    Args:
        folder: Folder of the run, which need not exist yet.
        bags: Which trials of the run are recorded; the view reads their bags.

    Raises:
        ConfigError: If no trial is recorded, or Foxglove's SDK is not installed.
    """
    if bags == "none":
        raise ConfigError(
            "--view reads bags and needs --bags all or --bags failed, got none"
        )
    # Checked here, because a failure of the process would not stop the run.
    require_sdk()
    module = "barn_eval.commands.watch"
    words = [sys.executable, "-m", module, str(folder), "--live", "--wait"]
    # A session of its own keeps Ctrl-C from the view, which ends after the trials.
    with subprocess.Popen(  # noqa: S603
        words, stdin=subprocess.PIPE, start_new_session=True
    ) as process:
        try:
            yield
        finally:
            process.terminate()


def _end_with_parent() -> None:
    """Wait until standard input closes, then end this process with exit code 0."""
    # The pipe closes when the parent process ends, even if it is killed.
    sys.stdin.read()
    os._exit(0)


if __name__ == "__main__":  # as `serve_view` starts it
    threading.Thread(target=_end_with_parent, daemon=True).start()
    command()
