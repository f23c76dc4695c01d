"""The parameter files are what the code says, and ROS reads them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from rclpy.node import Node  # noqa: E402

from barn_worlds.config import Checked, quantity  # noqa: E402
from barn_worlds.ros.map_server import MapServerConfig  # noqa: E402
from barn_worlds.ros.parameter_files import files, parameter_file  # noqa: E402
from barn_worlds.ros.parameters import declare  # noqa: E402

CONFIG = Path(__file__).parents[1] / "config"


def test_the_files_are_those_of_the_code():
    kept = {path.name: path.read_text("utf-8") for path in CONFIG.glob("*.yaml")}
    assert kept == files(), "run python -m barn_worlds.ros.parameter_files config"


@pytest.mark.parametrize("namespace", ["", "/robot1"])
def test_a_node_takes_its_values_from_its_section_in_any_namespace(tmp_path, namespace):
    """A file in which each value differs from the default gives a configuration of just these values."""
    changed = MapServerConfig(dataset="other", world=7, resolution_m=0.5, historical_map=True, frame_id="world")
    path = tmp_path / "changed.yaml"
    path.write_text(parameter_file("/**/map_server", "Changed.", [changed]))
    context = rclpy.Context()
    rclpy.init(context=context)
    arguments = ["--ros-args", "--params-file", str(path)]
    for name, expected in (("map_server", changed), ("another", MapServerConfig())):
        node = Node(name, namespace=namespace, context=context, cli_args=arguments, enable_rosout=False)
        assert declare(node, MapServerConfig()) == expected
        node.destroy_node()
    rclpy.shutdown(context=context)


def test_values_of_every_kind_are_written_as_yaml_reads_them():
    @dataclass(frozen=True)
    class Kinds(Checked):
        text: str = quantity("yes", "a text that looks like something else", choices=("yes", "no"))
        empty: tuple[str, ...] = quantity((), "nothing")
        several: tuple[str, ...] = quantity(("a", "0"), "two texts")
        small: float = quantity(1e-9, "little", "m", minimum=0.0)

    text = parameter_file("/**", "Kinds.", [Kinds()], {"first": True}, leave_out=["several"])
    read = yaml.safe_load(text)["/**"]["ros__parameters"]
    assert read == {"first": True, "text": "yes", "empty": [], "small": 1e-9}
    assert "# a text that looks like something else (one of yes, no)" in text
    assert "# little [m] (at least 0 m)" in text
