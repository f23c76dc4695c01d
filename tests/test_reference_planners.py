"""README and parameter files are what the code says."""

from pathlib import Path

import pytest
import yaml

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

import reference as tool

from barn_planners.dwa.config import dwa_presets
from barn_planners.registry import planner_config
from barn_worlds.base.config import fields_of

PACKAGE = Path(__file__).resolve().parents[1] / "barn_planners"


def test_readme_and_parameter_files_are_those_of_the_code():
    assert tool.planners().outdated(PACKAGE) == [], "run make generated"


def test_every_parameter_has_a_row_with_the_values_of_all_presets():
    tables = tool.planners().sections["planner parameters"]
    for name, about, _ in fields_of(dwa_presets()["paper"]):
        assert f"| `{name}` |" in tables and about.description in tables
    assert "| `goal_republish_period_s` | 0.1 | 0 | 0 | 0.1 | s |" in tables
    assert tables.count("\n### `") >= 2


@pytest.mark.parametrize("preset", ["paper", "challenge", "paper2020"])
def test_a_file_holds_the_whole_preset(preset):
    values = yaml.safe_load(tool.planners().files[f"dwa_{preset}.yaml"])["/**"]["ros__parameters"]
    assert (values["planner"], values["preset"], values["use_sim_time"]) == ("dwa", preset, True)
    assert values["use_map"] is (preset != "challenge")
    for name, _, value in fields_of(planner_config("dwa", preset)):
        assert values[name] == value
