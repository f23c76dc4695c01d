"""Launch files load in the system's Python, and have their arguments.

`ros2` runs in the system's Python, which lacks the libraries of the suite.
"""

import shutil
import sys

import pytest
from launch_files import (
    FILES,
    NODES,
    ROOT,
    constant,
    load_launch_file,
    run_launch_file,
    system_prefix,
)
from topics_used import CATALOGUE, topics_of
from waiting import run_python

from barn_eval.trials.protocol import PROTOCOLS, Protocol, load_protocol
from barn_eval.trials.ros_config import EvaluatorConfig
from barn_sim.config import RunConfig, SimulatorNodeConfig
from barn_worlds.base.config import fields_of

USUAL = {"params_file", "namespace", "log_level"}
ARGUMENTS = {
    "map_server": "dataset world use_sim_time",
    "simulator": "dataset world seed lockstep real_time_factor cmd_vel_topic base_frame",
    "planner": "planner preset use_map use_sim_time cmd_vel_topic odom_frame",
    "evaluator": "dataset worlds planner protocol out command_type goal_by lifecycle_nodes"
    " patience.gate_s patience.command_s",
    "trial": "dataset worlds planner protocol preset use_map out lockstep start_planner rviz use_sim_time"
    " patience.gate_s patience.command_s",
}
ARGUMENTS = {name: {*names.split(), *USUAL} for name, names in ARGUMENTS.items()}
ARGUMENTS["rviz"] = {"layout", "use_sim_time", "namespace", "log_level"}


def node_configs(name):
    """Return the configurations that a node declares its parameters from."""
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    from barn_planners.ros.planner import NodeConfig  # noqa: PLC0415
    from barn_worlds.ros.map_server import MapServerConfig  # noqa: PLC0415

    configs = {"planner": [NodeConfig()], "map_server": [MapServerConfig()]}
    configs |= {
        "simulator": [RunConfig(), SimulatorNodeConfig()],
        "evaluator": [EvaluatorConfig()],
    }
    return configs[name]


@pytest.mark.parametrize("name", ARGUMENTS)
def test_it_loads_with_the_standard_library_and_launch_only(name):
    assert set(FILES) == set(ARGUMENTS)
    loaded = load_launch_file(FILES[name])
    assert set(loaded["arguments"]) >= ARGUMENTS[name]
    assert all(loaded["arguments"].values()), "an argument without a meaning"
    others = {
        module
        for module in loaded["modules"]
        if module not in sys.stdlib_module_names and not module.startswith("_")
    }
    allowed = {"launch", "launch_ros", "launch_file", "ament_index_python"}
    assert others <= allowed | {"barn_worlds", "yaml", "cython_runtime"}


@pytest.mark.parametrize("name", NODES.values())
def test_parameters_without_a_dot_are_arguments_and_no_others(name):
    names = set(load_launch_file(FILES[name])["arguments"])
    parameters = {
        field for config in node_configs(name) for field, _, _ in fields_of(config)
    }
    topics = {
        topic.replace("/", "_") + "_topic" for topic in constant(FILES[name], "TOPICS")
    }
    assert names - USUAL - topics - {"use_sim_time", "planner"} <= parameters
    only_supervised = {"supervisor_fd", "simulator_fd", "evaluator_fd", "assignment"}
    undotted = {field for field in parameters if "." not in field}
    assert undotted - only_supervised <= names
    patience = {field for field in parameters if field.startswith("patience.")}
    assert {name for name in names if "." in name} == patience


@pytest.mark.parametrize("name", NODES.values())
def test_arguments_have_the_type_of_the_parameter(name):
    values = {
        field: value
        for config in node_configs(name)
        for field, _, value in fields_of(config)
        if not field.endswith("_fd") and field != "assignment"
    }
    shown = {
        field: value
        for field, value in values.items()
        if "." not in field or field.startswith("patience.")
    }
    loaded = load_launch_file(FILES[name], *(f"{field}:=x" for field in shown))
    (node,) = loaded["nodes"]
    for field, value in shown.items():
        kind = list[str] if isinstance(value, tuple) else type(value)
        assert node["parameters"][field] == str(kind)


def test_a_parameter_that_is_not_set_is_left_to_the_node():
    (node,) = load_launch_file(FILES["simulator"], "world:=7")["nodes"]
    assert set(node["parameters"]) == {"world"}


@pytest.mark.parametrize(
    "shebang", ["#!/nowhere/venv/bin/python", f"#!{sys.executable} -I -S"]
)
def test_a_node_without_the_libraries_is_refused_in_one_line(shebang, tmp_path):
    prefix = shutil.copytree(system_prefix(), tmp_path / "prefix", symlinks=True)
    (prefix / "lib/barn_sim/simulator").write_text(f"{shebang}\n")
    done = run_launch_file(FILES["simulator"], prefix=prefix)
    last = done.stderr.splitlines()[-1]
    assert done.returncode == 1
    assert "the Python of simulator" in last and "build the workspace again" in last


@pytest.mark.parametrize("package", NODES)
def test_a_build_without_the_libraries_is_refused_in_one_line(package):
    script = "import sys; sys.modules['cattrs'] = None; exec(open('setup.py').read())"
    words = ("-c", script, "install")
    done = run_python(*words, check=False, cwd=ROOT / package, env={})
    (line,) = done.stderr.splitlines()
    assert done.returncode == 1 and "activate their environment" in line


@pytest.mark.parametrize("name", [*NODES.values(), "rviz"])
def test_it_renames_only_topics_that_there_are(name):
    used = (
        CATALOGUE.values()
        if name == "rviz"
        else topics_of(FILES[name].parent.parent.name)
    )
    topics = set(constant(FILES[name], "TOPICS"))
    assert topics and topics <= {topic.name for topic in used}


def planner_arguments(*arguments):
    """Return preset and use_map that a trial's launch file gives the planner."""
    values = load_launch_file(FILES["trial"], *arguments)["values"]
    return values["preset"], values["use_map"].lower() == "true"


@pytest.mark.parametrize("name", PROTOCOLS)
def test_a_planner_is_started_as_the_protocol_says(name):
    protocol = PROTOCOLS[name]
    expected = (protocol.planner_preset, protocol.map_given)
    assert planner_arguments(f"protocol:={name}") == expected


def test_what_is_set_overrides_the_protocol():
    arguments = ("protocol:=paper2020", "preset:=challenge", "use_map:=false")
    assert planner_arguments(*arguments) == ("challenge", False)


@pytest.mark.parametrize("text", ["base: known_map", "goal: {x_m: 1.0}\nstart: {}"])
def test_a_protocol_of_ones_own_is_read(text, tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(f"schema_version: 1\nname: mine\n{text}\n")
    protocol = load_protocol(str(path))
    expected = (protocol.planner_preset, protocol.map_given)
    assert planner_arguments(f"protocol:={path}") == expected


@pytest.mark.parametrize("text", ["", "- 1", "a: [1", "base: [a]"])
def test_a_broken_protocol_is_left_to_the_evaluator(text, tmp_path):
    path = tmp_path / "broken.yaml"
    path.write_text(text)
    assert planner_arguments(f"protocol:={path}") == ("paper2020", True)


def test_defaults_are_those_of_a_protocol():
    defaults = vars(Protocol())
    for key, value in constant(FILES["trial"], "PROTOCOL_KEYS").values():
        assert defaults[key] == value


def test_every_launch_file_is_installed():
    for path in FILES.values():
        text = (ROOT / path.relative_to(ROOT).parts[0] / "setup.cfg").read_text()
        assert "= launch/*.py" in text
