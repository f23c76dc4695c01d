"""The launch files: whole where launch is not installed, and with the arguments they promise where it is."""

from __future__ import annotations

import ast
import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted(ROOT.glob("barn_*/launch/*.launch.py"))
ARGUMENTS = {
    "simulator": {"dataset", "world", "seed", "lockstep", "real_time_factor", "params_file", "namespace", "log_level"},
    "planner": {
        "planner",
        "preset",
        "use_map",
        "use_sim_time",
        "cmd_vel_topic",
        "params_file",
        "namespace",
        "log_level",
    },
    "evaluator": {"dataset", "worlds", "planner", "protocol", "out", "repetitions", "command_type", "params_file"},
    "trial": {"dataset", "worlds", "planner", "protocol", "out", "lockstep", "start_planner", "log_level"},
}


def node_parameters(package):
    """Return the names of the parameters that the package's node declares, read off the code."""
    from barn_eval.evaluator_config import EvaluatorConfig  # noqa: PLC0415
    from barn_worlds.config import fields_of  # noqa: PLC0415

    if package == "barn_eval":
        return {name for name, _, _ in fields_of(EvaluatorConfig())}
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    if package == "barn_sim":
        from barn_sim.ros.node_config import NodeConfig, RunConfig  # noqa: PLC0415

        return {name for config in (NodeConfig(), RunConfig()) for name, _, _ in fields_of(config)}
    from barn_planners.ros.planner import NodeConfig as PlannerNodeConfig  # noqa: PLC0415

    return {name for name, _, _ in fields_of(PlannerNodeConfig())} | {"planner", "use_sim_time"}


def test_every_launch_file_is_there():
    assert {path.name for path in FILES} >= {f"{name}.launch.py" for name in ARGUMENTS}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_it_is_python_that_makes_a_description(path):
    functions = [node.name for node in ast.parse(path.read_text()).body if isinstance(node, ast.FunctionDef)]
    assert "generate_launch_description" in functions


@pytest.mark.parametrize("name", ["simulator", "planner", "evaluator"])
def test_it_sets_no_parameter_that_the_node_does_not_have(name):
    (path,) = (path for path in FILES if path.name == f"{name}.launch.py")
    tree = ast.parse(path.read_text())
    (table,) = (
        node.value
        for node in tree.body
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and node.targets[0].id == "PARAMETERS"
    )
    given = {key.value for key in table.keys}
    assert given
    assert given <= node_parameters(path.parent.parent.name)


@pytest.mark.parametrize("name", ARGUMENTS)
def test_it_declares_the_usual_arguments(name):
    reason = "launch and launch_ros come with a full ROS 2 installation"
    pytest.importorskip("launch", reason=reason)
    pytest.importorskip("launch_ros", reason=reason)
    from launch.actions import DeclareLaunchArgument  # noqa: PLC0415

    (path,) = (path for path in FILES if path.name == f"{name}.launch.py")
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    entities = module.generate_launch_description().entities
    assert {entity.name for entity in entities if isinstance(entity, DeclareLaunchArgument)} >= ARGUMENTS[name]
