"""READMEs and parameter files are what the code says, and ROS reads them."""

import re
from dataclasses import dataclass

import pytest
import reference as tool
import yaml
from repository import ROOT

from barn_eval.trials.result import Outcome
from barn_eval.trials.ros_config import EvaluatorConfig
from barn_planners.registry import planner_config
from barn_sim.config import PRESETS, RunConfig, SimulatorConfig
from barn_worlds.base.config import Checked, fields_of, quantity, replace_dotted


def readme(package):
    return (ROOT / package / "README.md").read_text("utf-8")


def values_of(reference, file, section="/**"):
    return yaml.safe_load(reference.files[file])[section]["ros__parameters"]


@pytest.mark.parametrize("package", tool.REFERENCES)
def test_readme_and_parameter_files_are_those_of_the_code(package):
    if package in ("barn_worlds", "barn_planners"):
        pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    assert tool.REFERENCES[package]().outdated(ROOT / package) == [], (
        "run make generated"
    )


def test_files_that_differ_are_named_and_written_anew(tmp_path):
    (tmp_path / "config").mkdir()
    (tmp_path / "README.md").write_text(
        "before\n<!-- a b: begin -->\nold\n<!-- a b: end -->\nafter\n"
    )
    reference = tool.Reference({"a b": "new"}, {"one.yaml": "1\n"})
    (tmp_path / "config" / "stale.yaml").write_text("")
    assert reference.outdated(tmp_path) == ["README.md", "one.yaml", "stale.yaml"]
    reference.write(tmp_path)
    assert reference.outdated(tmp_path) == ["stale.yaml"]
    assert (tmp_path / "README.md").read_text() == (
        "before\n<!-- a b: begin -->\n\nnew\n\n<!-- a b: end -->\nafter\n"
    )
    assert (tmp_path / "config" / "one.yaml").read_text() == "1\n"
    (tmp_path / "README.md").write_text("nothing here")
    with pytest.raises(ValueError, match=r"README\.md: lacks <!-- a: begin -->"):
        tool.Reference({"a": "new"}, {}).outdated(tmp_path)


@pytest.mark.parametrize("namespace", ["", "/robot1"])
def test_a_node_reads_its_section_in_any_namespace(tmp_path, namespace):
    """A file whose values all differ from the defaults gives just these values."""
    rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    from rclpy.node import Node  # noqa: PLC0415

    from barn_worlds.ros.map_server import MapServerConfig  # noqa: PLC0415
    from barn_worlds.ros.parameters import declare_parameters  # noqa: PLC0415

    changed = MapServerConfig(
        dataset="other",
        world=7,
        resolution_m=0.5,
        historical_map=True,
        frame_id="world",
    )
    path = tmp_path / "changed.yaml"
    path.write_text(tool.parameter_file("/**/map_server", "Changed.", [changed]))
    context = rclpy.Context()
    rclpy.init(context=context)
    arguments = ["--ros-args", "--params-file", str(path)]
    options = {"context": context, "cli_args": arguments, "enable_rosout": False}
    for name, expected in (("map_server", changed), ("another", MapServerConfig())):
        node = Node(name, namespace=namespace, **options)
        assert declare_parameters(node, MapServerConfig()) == expected
        node.destroy_node()
    rclpy.shutdown(context=context)


def test_values_of_every_kind_are_written_as_yaml_reads_them():
    @dataclass(frozen=True)
    class Kinds(Checked):
        text: str = quantity(
            "yes", "a text that looks like something else", choices=("yes", "no")
        )
        empty: tuple[str, ...] = quantity((), "nothing")
        pair: tuple[str, ...] = quantity(("a", "0"), "two | texts")
        small: float = quantity(1e-9, "little", "m", minimum=0.0)

    text = tool.parameter_file(
        "/**", "Kinds.", [Kinds()], {"first": True}, leave_out=["pair"]
    )
    assert tool.parameter_table(
        {"one": Kinds(), "two": Kinds(pair=("b",), small=2.0)}, leave_out=["empty"]
    ) == (
        "| parameter | one | two | unit | meaning |\n"
        "| --- | --- | --- | --- | --- |\n"
        "| `text` | yes | yes |  | a text that looks like something else (one of yes, no) |\n"
        "| `pair` | a, 0 | b |  | two \\| texts |\n"
        "| `small` | 1e-09 | 2 | m | little (at least 0 m) |"
    )
    read = yaml.safe_load(text)["/**"]["ros__parameters"]
    assert read == {"first": True, "text": "yes", "empty": [], "small": 1e-9}
    assert "# a text that looks like something else (one of yes, no)" in text
    assert "# little [m] (at least 0 m)" in text


def test_every_outcome_is_explained():
    text = readme("barn_eval")
    for outcome in Outcome:
        assert f"| `{outcome.value}` |" in text


def test_the_example_of_the_library_runs():
    """The indented block under 'As a library', with fewer worlds."""
    section = readme("barn_eval").split("## As a library")[1].split("##")[0]
    lines = re.findall(r"(?m)^    (.*)$", section)
    code = "\n".join(lines).replace("0-9", "0")
    printed = []
    names = {"print": lambda *what: printed.append(what)}
    exec(compile(code, "README.md", "exec"), names)
    ((outcome, *_),) = printed
    assert outcome is Outcome.SUCCESS


def test_the_evaluators_file_holds_defaults_a_supervisor_leaves():
    values = values_of(tool.evaluator(), "evaluator.yaml", "/**/evaluator")
    assert not {"supervisor_fd", "simulator_fd"} & set(values)
    assert values["patience.start_s"] == 180.0
    assert replace_dotted(EvaluatorConfig(), values, "file") == EvaluatorConfig()


def test_preset_files_hold_their_changes_and_the_full_file_all():
    assert PRESETS["default"] == SimulatorConfig()
    for name in PRESETS.keys() - {"default"}:
        changes = values_of(tool.simulator(), f"{name}.yaml", tool.SIMULATOR)
        assert replace_dotted(SimulatorConfig(), changes, name) == PRESETS[name]
    values = values_of(tool.simulator(), "simulator.yaml", tool.SIMULATOR)
    fixed = {
        "lockstep",
        "planner_rate_hz",
        "start_paused",
        "command_type",
        "scan_reliability",
    }
    fixed |= {"ground_truth", "map_frame", "odom_frame", "base_frame", "lidar_frame"}
    changed = {name: value for name, value in values.items() if name not in fixed}
    assert fixed < set(values)
    assert replace_dotted(RunConfig(), changed, "file") == RunConfig()


@pytest.mark.parametrize("preset", ["challenge", "paper2020"])
def test_a_file_holds_the_whole_preset(preset):
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    values = values_of(tool.planners(), f"dwa_{preset}.yaml")
    assert (values["planner"], values["preset"]) == ("dwa", preset)
    assert values["use_sim_time"] is True
    assert values["use_map"] is (preset != "challenge")
    for name, _, value in fields_of(planner_config("dwa", preset)):
        assert values[name] == value
