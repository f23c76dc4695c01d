"""Our planners beside recordings of the original ROS 1 planners, where the recordings are."""

import os
from pathlib import Path

import pytest
import replay_originals as tool

from barn_worlds.base.errors import ConfigError

FOLDER = Path(os.environ.get("BARN_ORIGINALS", Path(__file__).resolve().parents[2] / "shared" / "originals"))
PATHS = sorted(FOLDER.glob("*.npz"))
SHARES = {"dwa": 0.90, "eband": 0.10}  # of driving cycles, with the original's plan and costmaps

pytestmark = pytest.mark.skipif(not PATHS, reason=f"no recordings of the originals in {FOLDER}")


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_with_plan_and_costmaps_given_commands_are_the_originals(path):
    recording = tool.Recording(path)
    cycles = list(tool.Replay(recording, "controller", {}).compare())
    assert len(cycles) > 50 and tool.share(cycles, tool.TIGHT) >= SHARES[recording.planner]


def test_a_depth_that_there_is_not_is_refused():
    with pytest.raises(ConfigError, match="depth must be one of controller, plan, observations, got 'bottom'"):
        tool.Replay(tool.Recording(PATHS[0]), "bottom", {})
