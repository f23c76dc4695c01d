"""README and parameter files are what the code says."""

from pathlib import Path

import pytest
import reference as tool
import yaml

from barn_sim.config import LIDARS, PRESETS, RunConfig, SimulatorConfig, SimulatorNodeConfig
from barn_worlds.base.config import fields_of, replace_dotted

PACKAGE = Path(__file__).resolve().parents[1] / "barn_sim"


def test_readme_and_parameter_files_are_those_of_the_code():
    assert tool.simulator().outdated(PACKAGE) == [], "run make generated"


def test_every_parameter_has_a_row() -> None:
    text = (PACKAGE / "README.md").read_text(encoding="utf-8")
    for config in (SimulatorNodeConfig(), RunConfig()):
        for name, about, _ in fields_of(config):
            row = next(line for line in text.splitlines() if line.startswith(f"| `{name}` |"))
            assert about.description in row
            assert f"| {about.unit} |" in row


def test_the_default_preset_is_the_default() -> None:
    assert PRESETS["default"] == SimulatorConfig()
    assert LIDARS["ust10lx"] == SimulatorConfig().lidar


@pytest.mark.parametrize("name", sorted(PRESETS.keys() - {"default"}))
def test_the_presets_are_what_their_files_change(name):
    changes = yaml.safe_load(tool.simulator().files[f"{name}.yaml"])[tool.SIMULATOR]["ros__parameters"]
    assert replace_dotted(SimulatorConfig(), changes, name) == PRESETS[name]


def test_the_file_of_everything_holds_the_defaults():
    values = yaml.safe_load(tool.simulator().files["simulator.yaml"])[tool.SIMULATOR]["ros__parameters"]
    fixed = {"lockstep", "start_paused", "command_type", "scan_reliability"}
    fixed |= {"ground_truth", "map_frame", "odom_frame", "base_frame", "lidar_frame"}
    changed = {name: value for name, value in values.items() if name not in fixed}
    assert fixed < set(values)
    assert replace_dotted(RunConfig(), changed, "file") == RunConfig()
