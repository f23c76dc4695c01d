"""The parameter files are what the code says, and ROS reads them."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from barn_eval.ros.evaluator_config import EvaluatorConfig
from barn_eval.ros.parameter_files import files
from barn_worlds.config import replace_dotted

CONFIG = Path(__file__).parents[1] / "config"


def test_the_files_are_those_of_the_code():
    kept = {path.name: path.read_text("utf-8") for path in CONFIG.glob("*.yaml")}
    assert kept == files(), "run python -m barn_eval.ros.parameter_files config"


def test_the_file_holds_the_defaults_but_for_what_a_supervisor_sets():
    values = yaml.safe_load(files()["evaluator.yaml"])["/**/evaluator"]["ros__parameters"]
    assert "supervisor_fd" not in values
    assert values["patience.start_s"] == 180.0
    assert replace_dotted(EvaluatorConfig(), values, "file") == EvaluatorConfig()
