"""README and parameter files are what the code says, and ROS reads them."""

from dataclasses import dataclass
from pathlib import Path

import pytest
import reference as tool
import yaml

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")
from rclpy.node import Node  # noqa: E402

from barn_worlds.base.config import Checked, quantity  # noqa: E402
from barn_worlds.ros.map_server import MapServerConfig  # noqa: E402
from barn_worlds.ros.parameters import declare  # noqa: E402

PACKAGE = Path(__file__).resolve().parents[1] / "barn_worlds"


def test_readme_and_parameter_files_are_those_of_the_code():
    assert tool.worlds().outdated(PACKAGE) == [], "run make generated"


def test_files_that_differ_are_named_and_written_anew(tmp_path):
    (tmp_path / "config").mkdir()
    (tmp_path / "README.md").write_text("before\n<!-- a b: begin -->\nold\n<!-- a b: end -->\nafter\n")
    made = tool.Reference({"a b": "new"}, {"one.yaml": "1\n"})
    (tmp_path / "config" / "stale.yaml").write_text("")
    assert made.outdated(tmp_path) == ["README.md", "one.yaml", "stale.yaml"]
    made.write(tmp_path)
    assert made.outdated(tmp_path) == ["stale.yaml"]
    assert (tmp_path / "README.md").read_text() == ("before\n<!-- a b: begin -->\n\nnew\n\n<!-- a b: end -->\nafter\n")
    assert (tmp_path / "config" / "one.yaml").read_text() == "1\n"


def test_a_readme_without_markers_is_refused(tmp_path):
    (tmp_path / "README.md").write_text("nothing here")
    with pytest.raises(ValueError, match=r"README\.md: lacks <!-- a: begin -->"):
        tool.Reference({"a": "new"}, {}).outdated(tmp_path)


@pytest.mark.parametrize("namespace", ["", "/robot1"])
def test_a_node_takes_its_values_from_its_section_in_any_namespace(tmp_path, namespace):
    """A file in which each value differs from the default gives a configuration of just these values."""
    changed = MapServerConfig(dataset="other", world=7, resolution_m=0.5, historical_map=True, frame_id="world")
    path = tmp_path / "changed.yaml"
    path.write_text(tool.parameter_file("/**/map_server", "Changed.", [changed]))
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
        several: tuple[str, ...] = quantity(("a", "0"), "two | texts")
        small: float = quantity(1e-9, "little", "m", minimum=0.0)

    text = tool.parameter_file("/**", "Kinds.", [Kinds()], {"first": True}, leave_out=["several"])
    assert tool.parameter_table({"one": Kinds(), "two": Kinds(several=("b",), small=2.0)}, leave_out=["empty"]) == (
        "| parameter | one | two | unit | meaning |\n"
        "| --- | --- | --- | --- | --- |\n"
        "| `text` | yes | yes |  | a text that looks like something else (one of yes, no) |\n"
        "| `several` | a, 0 | b |  | two \\| texts |\n"
        "| `small` | 1e-09 | 2 | m | little (at least 0 m) |"
    )
    read = yaml.safe_load(text)["/**"]["ros__parameters"]
    assert read == {"first": True, "text": "yes", "empty": [], "small": 1e-9}
    assert "# a text that looks like something else (one of yes, no)" in text
    assert "# little [m] (at least 0 m)" in text
