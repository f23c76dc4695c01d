"""Our planners beside recordings of the original ROS 1 planners, where these are."""

import os
from pathlib import Path

import pytest
import replay_originals as tool
from refusals import refused

FOLDER = Path(
    os.environ.get(
        "BARN_ORIGINALS", Path(__file__).resolve().parents[2] / "shared" / "originals"
    )
)
PATHS = sorted(FOLDER.glob("*.npz"))
# Share of driving cycles whose commands are equal: with plan and costmaps given, and
# from observations alone.
GIVEN = 0.99
SEEN = 0.95
SETTINGS = {
    "dwa": {"local_costmap.soft_costs": True},
    "eband": {},
}  # as the original has them

pytestmark = pytest.mark.skipif(
    not PATHS, reason=f"no recordings of the originals in {FOLDER}"
)


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_commands_are_the_originals(path):
    recording = tool.Recording(path)
    from_plan, plan, from_readings = (
        list(tool.Replay(recording, depth, SETTINGS[recording.planner]).compare())
        for depth in tool.DEPTHS
    )
    assert len(from_plan) == len(plan) == len(from_readings) > 50
    assert tool.share(from_plan, tool.TIGHT) >= GIVEN
    assert tool.share(from_readings, tool.LOOSE) >= SEEN
    assert all(cycle.plan for cycle in plan), (
        "navfn's plans are equal on its own costmap"
    )
    assert tool.share(plan, tool.TIGHT) >= GIVEN


def test_a_depth_that_there_is_not_is_refused():
    with refused("depth must be one of controller, plan, observations, got 'bottom'"):
        tool.Replay(tool.Recording(PATHS[0]), "bottom", {})
