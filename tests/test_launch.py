"""Launch files are whole without launch, and have their arguments with it."""

import ast
import importlib.util
from pathlib import Path

import pytest
from launch_files import constant
from topics_used import CATALOGUE, topics_of

from barn_eval.trials.ros_config import EvaluatorConfig
from barn_sim.config import RunConfig, SimulatorNodeConfig
from barn_worlds.base.config import fields_of

ROOT = Path(__file__).resolve().parents[1]
FILES = {
    path.name.partition(".")[0]: path
    for path in sorted(ROOT.glob("barn_*/launch/*.launch.py"))
}
NODES = ("map_server", "simulator", "planner", "evaluator")
USUAL = {"params_file", "namespace", "log_level"}
ARGUMENTS = {
    "map_server": "dataset world use_sim_time",
    "simulator": "dataset world seed lockstep real_time_factor cmd_vel_topic base_frame",
    "planner": "planner preset use_map use_sim_time cmd_vel_topic odom_frame",
    "evaluator": "dataset worlds planner protocol out command_type goal_by lifecycle_nodes",
    "trial": "dataset worlds planner protocol preset use_map out lockstep start_planner rviz use_sim_time",
}
ARGUMENTS = {name: {*names.split(), *USUAL} for name, names in ARGUMENTS.items()}
ARGUMENTS["rviz"] = {"layout", "use_sim_time", "namespace", "log_level"}
REASON = "launch and launch_ros come with a full ROS 2 installation"


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


def module_of(name):
    """Return a launch file as a module."""
    for package in ("launch", "launch_ros"):
        pytest.importorskip(package, reason=REASON)
    spec = importlib.util.spec_from_file_location(name, FILES[name])
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def declared_arguments(name):
    """Return the arguments that a launch file declares."""
    declare = pytest.importorskip("launch.actions", reason=REASON).DeclareLaunchArgument
    entities = module_of(name).generate_launch_description().entities
    return {entity.name for entity in entities if isinstance(entity, declare)}


def test_every_launch_file_is_there_and_makes_a_description():
    assert set(FILES) == set(ARGUMENTS)
    for path in FILES.values():
        functions = [
            node.name
            for node in ast.parse(path.read_text()).body
            if isinstance(node, ast.FunctionDef)
        ]
        assert "generate_launch_description" in functions


@pytest.mark.parametrize("name", NODES)
def test_parameters_without_a_dot_are_arguments_and_no_others(name):
    names = declared_arguments(name)
    parameters = {
        field for config in node_configs(name) for field, _, _ in fields_of(config)
    }
    topics = {
        topic.replace("/", "_") + "_topic" for topic in constant(FILES[name], "TOPICS")
    }
    assert names - USUAL - topics - {"use_sim_time", "planner"} <= parameters
    handles = {"supervisor_fd", "simulator_fd", "evaluator_fd"}
    assert {field for field in parameters if "." not in field} - handles <= names


@pytest.mark.parametrize("name", [*NODES, "rviz"])
def test_it_renames_only_topics_that_there_are(name):
    used = (
        CATALOGUE.values()
        if name == "rviz"
        else topics_of(FILES[name].parent.parent.name)
    )
    topics = set(constant(FILES[name], "TOPICS"))
    assert topics and topics <= {topic.name for topic in used}


@pytest.mark.parametrize("name", ARGUMENTS)
def test_it_declares_the_usual_arguments(name):
    assert declared_arguments(name) >= ARGUMENTS[name]


@pytest.mark.parametrize(
    ("arguments", "preset", "use_map"),
    [
        ({"protocol": "challenge"}, "challenge", "false"),
        ({"protocol": "known_map"}, "challenge", "true"),
        ({"protocol": "paper2020"}, "paper2020", "true"),
        (
            {"protocol": "paper2020", "preset": "challenge", "use_map": "false"},
            "challenge",
            "false",
        ),
    ],
)
def test_a_planner_is_started_as_the_protocol_says(arguments, preset, use_map):
    trial = module_of("trial")
    context = trial.LaunchContext()
    context.launch_configurations.update({"preset": "", "use_map": ""} | arguments)
    for action in trial._by_protocol(context):
        action.execute(context)
    configurations = context.launch_configurations
    assert (configurations["preset"], configurations["use_map"]) == (preset, use_map)
