"""The data set of maneuvers: drawn by its tool, and in the size of each robot."""

import pytest

from barn_eval.running.request import read_request
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.robots.files import find_robot_files


def test_the_file_is_what_its_tool_draws():
    tool = pytest.importorskip(
        "maneuvers", reason="the repository's qa folder is not beside this package"
    )
    dataset = open_dataset("maneuvers")
    worlds = tool.draw_maneuvers()
    assert dataset.world_numbers == tuple(worlds)
    for number, world in worlds.items():
        copy = dataset.load(number)
        assert (copy.name, copy.checksum) == (world.name, world.checksum)


@pytest.mark.parametrize("robot", sorted(find_robot_files()))
def test_every_robot_meets_them_in_its_size(robot, tmp_path):
    options = {"dataset": "maneuvers", "robot": robot, "planners": "gap"}
    trials = read_request(None, options | {"out": tmp_path / "out"}).trials()
    assert len(trials) == 21
    for spec in trials:
        # In cells, all robots are of one size.
        assert spec.world.footprint_cells == 11
        assert spec.metric == "efficiency"
        assert spec.least_time_s < spec.scaled_protocol.limit_s
        assert spec.world.path_length_m > 3.0 * spec.scaled_protocol.goal_distance_m
