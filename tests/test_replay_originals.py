"""Our planners beside recordings of the original ROS 1 planners, where the recordings are."""

import os
from pathlib import Path

import pytest
import replay_originals as tool

from barn_worlds.base.errors import ConfigError

FOLDER = Path(os.environ.get("BARN_ORIGINALS", Path(__file__).resolve().parents[2] / "shared" / "originals"))
PATHS = sorted(FOLDER.glob("*.npz"))
# Share of driving cycles whose commands are equal: with plan and costmaps given, and from observations alone.
GIVEN, SEEN = {"dwa": 0.90, "eband": 0.99}, {"dwa": 0.40, "eband": 0.95}

pytestmark = pytest.mark.skipif(not PATHS, reason=f"no recordings of the originals in {FOLDER}")


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_commands_are_the_originals(path):
    recording = tool.Recording(path)
    given, plan, seen = (list(tool.Replay(recording, depth, {}).compare()) for depth in tool.DEPTHS)
    assert len(given) == len(plan) == len(seen) > 50
    assert tool.share(given, tool.TIGHT) >= GIVEN[recording.planner]
    assert tool.share(seen, tool.LOOSE) >= SEEN[recording.planner]
    if recording.planner == "eband":
        assert all(cycle.plan for cycle in plan), "navfn's plans are equal on its own costmap"
        assert tool.share(plan, tool.TIGHT) >= GIVEN["eband"]


def test_a_depth_that_there_is_not_is_refused():
    with pytest.raises(ConfigError, match="depth must be one of controller, plan, observations, got 'bottom'"):
        tool.Replay(tool.Recording(PATHS[0]), "bottom", {})
