"""The parameter files are what the code says, and ROS reads them."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from barn_sim.config import PRESETS, SimulatorConfig
from barn_sim.ros.node_config import RunConfig
from barn_sim.ros.parameter_files import NODE, files
from barn_worlds.config import replace_dotted

CONFIG = Path(__file__).parents[1] / "config"


def test_the_files_are_those_of_the_code():
    kept = {path.name: path.read_text("utf-8") for path in CONFIG.glob("*.yaml")}
    assert kept == files(), "run python -m barn_sim.ros.parameter_files config"


@pytest.mark.parametrize("name", sorted(PRESETS.keys() - {"default"}))
def test_the_presets_are_what_their_files_change(name):
    changes = yaml.safe_load(files()[f"{name}.yaml"])[NODE]["ros__parameters"]
    assert replace_dotted(SimulatorConfig(), changes, name) == PRESETS[name]


def test_the_file_of_everything_holds_the_defaults():
    values = yaml.safe_load(files()["simulator.yaml"])[NODE]["ros__parameters"]
    fixed = {"lockstep", "start_paused", "command_type", "scan_reliability"}
    fixed |= {"map_frame", "odom_frame", "base_frame", "lidar_frame"}
    changed = {name: value for name, value in values.items() if name not in fixed}
    assert fixed < set(values)
    assert replace_dotted(RunConfig(), changed, "file") == RunConfig()
