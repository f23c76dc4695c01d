"""Fixtures of the package's tests."""

import json
import shlex
import shutil
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser import Opened, launch
from extra_messages import extra_message_types, with_extra_messages
from planners import Straight, open_field, run_inline
from report_work import campaign, drive
from shared_fixtures import longest_first, original_folder
from waiting import ROOT

from barn_eval.commands.main import main
from barn_eval.pages.report.page import build_report
from barn_eval.trials.protocol import CHALLENGE, PAPER_2020
from barn_worlds.base.errors import ExitCode
from barn_worlds.moving.motion import Motion, MovingObstacle

__all__ = ["extra_message_types", "original_folder", "with_extra_messages"]
LONGEST = [
    "ros/test_trials.py",
    "ros/test_neighbors.py",
    "running/test_cluster.py",
    "ros/test_work.py",
    "report/test_page.py",
    "running/test_run.py",
    "ros/test_interference.py",
    "running/test_pool.py",
    "pages/test_pages.py",
    "replay/test_movers.py",
    "api/test_front_door.py",
    "studies/test_tune.py",
    "running/test_compute.py",
    "commands/test_main.py",
    "studies/test_ab.py",
    "api/test_difficulty.py",
]


def pytest_collection_modifyitems(config, items):
    """Put the longest files of tests first.

    Take a picture again where the browser of a busy machine could not.
    """
    longest_first(items, LONGEST)
    # The plugin comes with colcon; an environment with pytest alone lacks it.
    if not config.pluginmanager.hasplugin("rerunfailures"):
        return
    again = pytest.mark.flaky(reruns=2, only_rerun="Unable to capture screenshot")
    for item in items:
        if "screenshots" in getattr(item, "fixturenames", ()):
            item.add_marker(again)


@pytest.fixture(scope="session", autouse=True)
def _interruptible():
    """Let Ctrl-C reach what tests start.

    What a shell starts in the background ignores it, and passes that on.
    """
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def command(capfd, tmp_path, monkeypatch):
    """Runs `barn` in an empty folder and returns exit code, output and error output.

    It is given a line as in a shell, without `barn`, and further arguments as they are.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")

    def run(line, *arguments):
        with pytest.raises(SystemExit) as ended:
            main([*shlex.split(line), *map(str, arguments)])
        captured = capfd.readouterr()
        return ended.value.code, captured.out, captured.err

    return run


@pytest.fixture
def succeed(command):
    """Runs a command that must succeed and returns its output."""

    def run(line, *arguments):
        code, out, err = command(line, *arguments)
        assert code == 0, err
        return out

    return run


@pytest.fixture
def printed(succeed):
    """Runs a command that must succeed and returns what it prints as JSON."""

    def run(line, *arguments):
        return json.loads(succeed(line, *arguments, "--json"))

    return run


@pytest.fixture
def rejected(command, tmp_path):
    """Runs a command that must fail and returns its one line.

    The command must leave nothing behind.
    """

    def run(line, *arguments, ends=ExitCode.REFUSED):
        before = sorted(tmp_path.rglob("*"))
        code, out, err = command(line, *arguments)
        assert (code, out) == (ends, "")
        assert err.startswith("error: ") and err.count("\n") == 1 and len(err) < 600
        assert sorted(tmp_path.rglob("*")) == before
        return err

    return run


@pytest.fixture(scope="session")
def run(tmp_path_factory):
    """The folder of one trial that was driven, for campaigns made of it.

    Nobody changes it.
    """
    return drive(tmp_path_factory.mktemp("driven") / "run")


@pytest.fixture(scope="session")
def two_trials(tmp_path_factory):
    """The folder of two short trials without bags; nobody changes it."""
    return run_inline("0,120", out=tmp_path_factory.mktemp("two") / "out").folder


@pytest.fixture(scope="session")
def collided(tmp_path_factory):
    """The folder of a robot that drives blindly at its goal and hits a post."""
    out = tmp_path_factory.mktemp("collided") / "out"
    planners = {"straight": Straight}
    results = run_inline("120", planners, CHALLENGE, out=out, bags="all")
    assert [trial.outcome for trial in results.trials] == ["collision"]
    return results.folder


@pytest.fixture
def collided_copy(collided, tmp_path):
    """A copy of that folder, to be changed."""
    return Path(shutil.copytree(collided, tmp_path / "out"))


@pytest.fixture
def trials_copy(two_trials, tmp_path):
    """A copy of the folder of two trials, to be changed."""
    return Path(shutil.copytree(two_trials, tmp_path / "out"))


@pytest.fixture(scope="session")
def folder(run, tmp_path_factory):
    """The folder of a campaign of gap and DWA, made of the trial that was driven."""
    return campaign(tmp_path_factory.mktemp("campaigns") / "campaign", run)


@pytest.fixture(scope="session")
def report(folder):
    """Its report."""
    return build_report([folder])


@pytest.fixture(scope="session")
def bag(tmp_path_factory):
    """The bag of a trial in which what the follower of gaps takes for the goal is off
    by a cell, like the map.
    """
    protocol = replace(
        PAPER_2020, name="by_truth", goal_source="truth", goal_distance_m=0.5
    )
    run = drive(tmp_path_factory.mktemp("replay") / "run", protocol)
    return run / "bags" / "gap_w0000_r00"


@pytest.fixture(scope="session")
def open_world():
    return open_field()


@pytest.fixture(scope="session")
def moving_world(open_world):
    """The same with a post that goes to and fro across the path, and a box beside it
    that jumps back.
    """
    post = Motion("linear", 6.0, ((0.0, -3.5, 3.0), (3.0, -1.0, 3.0), (6.0, -3.5, 3.0)))
    cart = Motion("gazebo", 3.0, ((0.0, -4.2, 0.5), (1.0, -4.1, 1.5), (2.5, -4.2, 4.0)))
    moving = (
        MovingObstacle("post", radius_m=0.2, motion=post),
        MovingObstacle(
            "cart", "box", size_x_m=0.2, size_y_m=0.4, yaw_rad=0.3, motion=cart
        ),
    )
    return replace(open_world, name="moving", moving=moving)


@pytest.fixture
def open_dataset_file(open_world, tmp_path):
    """The file of a data set whose only world is the open one."""
    path = tmp_path / "world_0.npy"
    np.save(path, open_world.grid)
    return str(path)


@pytest.fixture(params=["open_world", "moving_world"])
def either_world(request):
    return request.getfixturevalue(request.param)


@pytest.fixture(scope="session")
def walled_world(open_world):
    """The same with a wall across, whose gap of one cell lets the path through but no
    robot.
    """
    grid = open_world.grid.copy()
    grid[:, 10] = np.arange(30) != 15
    return replace(open_world, name="walled", grid=grid)


@pytest.fixture(scope="module")
def chromium():
    api = pytest.importorskip(
        "playwright.sync_api", reason="playwright, an optional extra, is not installed"
    )
    with api.sync_playwright() as playwright:
        browser = launch(playwright)
        yield browser
        browser.close()


@pytest.fixture
def open_page(chromium):
    """Opens pages in Chromium.

    None may write to the console or ask for a remote file.
    """
    opened = Opened(chromium)
    yield opened
    opened.close()
    opened.check()


@pytest.fixture(scope="session")
def screenshots():
    """The folder that keeps pictures of pages, beside the results of the tests."""
    folder = ROOT / "build" / "barn_eval" / "screenshots"
    folder.mkdir(parents=True, exist_ok=True)
    return folder
