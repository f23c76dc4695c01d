"""The rules on what may import what, held over the source of all packages."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ALLOWED = {
    "barn_worlds": set(),
    "barn_sim": {"barn_worlds"},
    "barn_planners": {"barn_worlds"},
    "barn_metrics": {"barn_worlds"},
    "barn_eval": {"barn_worlds", "barn_sim", "barn_planners", "barn_metrics"},
}
MESSAGES = ("_msgs", "_interfaces", "_srvs")
ROS = {"rclpy", "tf2_ros", "rosbag2_py", "launch", "launch_ros", "ament_index_python"}
WALL_CLOCKS = {"time", "perf_counter", "monotonic", "time_ns", "perf_counter_ns", "monotonic_ns", "now", "today"}
# What runs trials measures how long they take; what only judges or computes reads no clock.
MEASURING = {"barn_eval/direct.py", "barn_eval/commands", "barn_eval/campaign", "barn_eval/rosrun", "barn_eval/ros"}


def sources(package: str) -> list[Path]:
    """Return the package's own source files, tests and setup left out."""
    return sorted((ROOT / package / package).rglob("*.py")) + sorted((ROOT / package / "launch").glob("*.py"))


ALL = [(package, path) for package in ALLOWED for path in sources(package)]
FILES = pytest.mark.parametrize(("package", "path"), ALL, ids=[str(path.relative_to(ROOT)) for _, path in ALL])


def imports(path: Path) -> Iterator[str]:
    """Yield the dotted name of everything that a file imports, wherever in it."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: relative import"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] in ("import_module", "__import__"):
            yield from (argument.value for argument in node.args[:1] if isinstance(argument, ast.Constant))


def is_ros_code(package: str, path: Path) -> bool:
    parts = path.relative_to(ROOT / package).parts
    return parts[0] == "launch" or "ros" in parts


def test_there_is_something_to_look_at():
    assert {package for package, _ in ALL} == set(ALLOWED)
    assert len(ALL) > 80
    everything = {(package, name.split(".")[0]) for package, path in ALL for name in imports(path)}
    assert {("barn_sim", "pybullet"), ("barn_sim", "rclpy"), ("barn_eval", "barn_metrics")} <= everything


@FILES
def test_packages_import_only_what_is_below_them(package, path):
    suite = {name.split(".")[0] for name in imports(path)} & set(ALLOWED)
    assert suite - {package} <= ALLOWED[package]


@FILES
def test_only_nodes_and_launch_files_know_ros(package, path):
    tops = {name.split(".")[0] for name in imports(path)}
    ros = {top for top in tops if top in ROS or top.endswith(MESSAGES)}
    if not is_ros_code(package, path):
        assert not ros


@FILES
def test_cores_do_not_import_nodes(package, path):
    nodes = {name for name in imports(path) if "ros" in name.split(".")[1:2] and name.split(".")[0] in ALLOWED}
    if not is_ros_code(package, path):
        assert not nodes


@FILES
def test_heavy_libraries_stay_in_their_place(package, path):
    tops = {name.split(".")[0] for name in imports(path)}
    assert package == "barn_sim" or "pybullet" not in tops
    assert (package == "barn_metrics" and "model" in str(path.relative_to(ROOT))) or "torch" not in tops


@FILES
def test_there_is_no_global_random_state(package, path):
    """Only generators made from a seed: nothing but the constructors is taken from numpy.random."""
    text = path.read_text("utf-8")
    used = {
        node.attr
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) in ("np.random", "numpy.random")
    }
    assert used <= {"Generator", "SeedSequence", "default_rng", "PCG64", "BitGenerator"}
    assert "random" not in {name.split(".")[0] for name in imports(path)}


@FILES
def test_cores_read_no_clock(package, path):
    """Time is passed in, except where trials are run and their duration is measured."""
    where = str(path.relative_to(ROOT / package))
    if is_ros_code(package, path) or any(where.startswith(prefix) for prefix in MEASURING):
        return
    read = {
        ast.unparse(node.func)
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr in WALL_CLOCKS
        and ast.unparse(node.func.value) in ("time", "datetime", "datetime.datetime", "date")
    }
    assert not read


@FILES
def test_user_strings_meet_no_shell_and_no_unsafe_loader(package, path):
    forbidden = []
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if not isinstance(node, ast.Call):
            continue
        name = ast.unparse(node.func)
        given = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
        if name in ("os.system", "eval", "exec", "yaml.unsafe_load", "yaml.full_load", "pickle.load", "np.loadtxt"):
            forbidden.append(f"line {node.lineno}: {name}")
        if given.get("shell") == "True" or given.get("allow_pickle") == "True":
            forbidden.append(f"line {node.lineno}: {name}")
        if name == "np.load" and given.get("allow_pickle") != "False":
            forbidden.append(f"line {node.lineno}: np.load without allow_pickle=False")
    assert not forbidden
