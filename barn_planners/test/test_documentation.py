"""The README says what the code does."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from barn_planners.documentation import main, parameter_section, parameter_table, updated
from barn_planners.dwa_config import dwa_presets
from barn_planners.sync import SyncConfig
from barn_worlds.config import fields_of

README = Path(__file__).parents[1] / "README.md"


def test_the_tables_in_the_readme_are_those_of_the_code(tmp_path):
    text = README.read_text(encoding="utf-8")
    assert updated(text) == text, "run python -m barn_planners.documentation README.md"
    copy = tmp_path / "README.md"
    copy.write_text(text.replace("0.75", "0.76"), encoding="utf-8")
    assert main([str(copy)]) == 0 and copy.read_text(encoding="utf-8") == text


def test_every_parameter_has_a_row_with_the_values_of_all_presets():
    table = parameter_table("dwa")
    for name, about, _ in fields_of(dwa_presets()["paper"]):
        assert f"| `{name}` |" in table and about.description in table
    assert "| `goal_republish_period_s` | 0.1 | 0 | 0 | s |" in table
    assert parameter_section().count("\n### `") >= 2


def test_the_parameters_of_the_node_are_all_named():
    node = pytest.importorskip("barn_planners.ros.planner", reason="ROS 2 is not installed")
    text = README.read_text(encoding="utf-8")
    for config in (node.NodeConfig, SyncConfig):
        for field in dataclasses.fields(config):
            assert f"`{field.name}`" in text, field.name


def test_a_text_without_markers_is_refused():
    with pytest.raises(ValueError, match="no <!-- parameters: begin -->"):
        updated("nothing here")
