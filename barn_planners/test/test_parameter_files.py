"""The parameter files are what the code says, and ROS reads them."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from barn_planners.registry import planner_config
from barn_planners.ros.parameter_files import files
from barn_worlds.config import fields_of

CONFIG = Path(__file__).parents[1] / "config"


def test_the_files_are_those_of_the_code():
    kept = {path.name: path.read_text("utf-8") for path in CONFIG.glob("*.yaml")}
    assert kept == files(), "run python -m barn_planners.ros.parameter_files config"


@pytest.mark.parametrize("preset", ["paper", "challenge"])
def test_a_file_holds_the_whole_preset(preset):
    values = yaml.safe_load(files()[f"dwa_{preset}.yaml"])["/**"]["ros__parameters"]
    assert (values["planner"], values["preset"], values["use_sim_time"]) == ("dwa", preset, True)
    assert values["use_map"] is (preset == "paper")
    for name, _, value in fields_of(planner_config("dwa", preset)):
        assert values[name] == value
