from __future__ import annotations

from pathlib import Path

import pytest

from barn_sim.config import LIDARS, PRESETS, SimulatorConfig
from barn_sim.ros.documentation import main, updated
from barn_sim.ros.node_config import NodeConfig, RunConfig
from barn_worlds.config import fields_of

PACKAGE = Path(__file__).parents[1]
REMEDY = "run python -m barn_sim.ros.documentation PACKAGE_FOLDER"


def test_the_tables_in_the_readme_are_those_of_the_code(tmp_path: Path) -> None:
    text = (PACKAGE / "README.md").read_text(encoding="utf-8")
    assert updated(text) == text, REMEDY
    (tmp_path / "README.md").write_text(text.replace("| 720 |", "| 721 |"), encoding="utf-8")
    assert main([str(tmp_path)]) == 0
    assert (tmp_path / "README.md").read_text(encoding="utf-8") == text


def test_every_parameter_has_a_row() -> None:
    text = (PACKAGE / "README.md").read_text(encoding="utf-8")
    for config in (NodeConfig(), RunConfig()):
        for name, about, _ in fields_of(config):
            row = next(line for line in text.splitlines() if line.startswith(f"| `{name}` |"))
            assert about.description in row
            assert f"| {about.unit} |" in row


def test_the_default_preset_is_the_default() -> None:
    assert PRESETS["default"] == SimulatorConfig()
    assert LIDARS["ust10lx"] == SimulatorConfig().lidar


def test_a_text_without_markers_is_refused() -> None:
    with pytest.raises(ValueError, match="no <!-- parameters: begin -->"):
        updated("nothing here")
