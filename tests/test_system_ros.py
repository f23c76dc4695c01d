"""The workspace on a full ROS 2, whose `ros2` runs in the system's Python.

BARN_SYSTEM_ROS is the setup file of that installation, such as /opt/ros/jazzy/setup.bash.
Its Python has ROS, NumPy, PyYAML and colcon, but not the libraries of the suite, which go
into an environment as the README says. A stand-in does as well: an interpreter of its own
with the ROS wheels, launch, launch_ros and ros2cli, and a file that puts its programs and
libraries on the paths. Without LD_LIBRARY_PATH, tests of nodes are skipped.
"""

import json
import os
import subprocess
from pathlib import Path

import pytest
from launch_files import FILES, NODES, ROOT

SETUP = os.environ.get("BARN_SYSTEM_ROS", "")
pytestmark = pytest.mark.skipif(
    not SETUP, reason="BARN_SYSTEM_ROS names no setup file of a full ROS 2"
)
# A value that each node refuses as soon as it has read its parameters.
REFUSED = {
    "map_server": "world:=-1",
    "simulator": "world:=-1",
    "planner": "command_type:=x",
    "evaluator": "worlds:=x",
}


def in_terminal(command, folder, timeout=900):
    """Run a command in a fresh shell that has sourced the installation."""
    kept = ("HOME", "PATH", "LANG", "PIP_CERT", "PIP_FIND_LINKS", "NUMBA_CACHE_DIR")
    environment = {name: os.environ[name] for name in kept if name in os.environ}
    environment["ROS_DOMAIN_ID"] = "83"
    return subprocess.run(
        ["bash", "-c", f". {SETUP}; {command}"],
        cwd=folder,
        env=environment,
        check=False,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=timeout,
    )


@pytest.fixture(scope="module", params=["", "--symlink-install"])
def workspace(request, tmp_path_factory):
    """Return a workspace that was built by the README's lines."""
    folder = tmp_path_factory.mktemp("ws")
    (folder / "src").mkdir()
    for package in (*NODES, "barn_metrics"):
        (folder / "src" / package).symlink_to(ROOT / package)
    lock = ROOT / "requirements/python.lock"
    steps = (
        "python3 -m venv --system-site-packages venv && touch venv/COLCON_IGNORE",
        f". venv/bin/activate && pip install --quiet -r {lock}",
        f". venv/bin/activate && colcon build {request.param}",
    )
    for step in steps:
        done = in_terminal(step, folder)
        assert done.returncode == 0, done.stdout
    return folder


def launch(workspace, words, **options):
    """Run a command in a terminal where only the workspace is sourced."""
    command = f". install/local_setup.bash; {words}"
    return in_terminal(command, workspace, **options)


def test_the_systems_python_has_none_of_the_libraries(tmp_path):
    done = in_terminal("python3 -c 'import launch, yaml; import cattrs'", tmp_path)
    assert "No module named 'cattrs'" in done.stdout


@pytest.mark.parametrize("package, node", NODES.items())
def test_nodes_run_in_the_environment(package, node, workspace):
    script = workspace / f"install/{package}/lib/{package}/{node}"
    assert script.open().readline() == f"#!{workspace}/venv/bin/python\n"
    words = f"ros2 run {package} {node} --ros-args -p {REFUSED[node]}"
    done = launch(workspace, words)
    assert done.returncode == 2
    name = REFUSED[node].partition(":=")[0]
    assert name in done.stdout and "Traceback" not in done.stdout


@pytest.mark.parametrize("name", FILES)
def test_launch_files_show_their_arguments(name, workspace):
    package = FILES[name].parents[1].name
    done = launch(workspace, f"ros2 launch {package} {name}.launch.py --show-args")
    assert done.returncode == 0, done.stdout
    assert "'namespace':" in done.stdout


@pytest.mark.parametrize("package, node", NODES.items())
def test_launched_nodes_have_arguments_and_namespace(package, node, workspace):
    arguments = f"{REFUSED[node]} namespace:=r1"
    done = launch(workspace, f"ros2 launch {package} {node}.launch.py {arguments}")
    name = REFUSED[node].partition(":=")[0]
    assert "-r __ns:=/r1" in done.stdout and name in done.stdout, done.stdout
    # The evaluator's exit code is that of the launch; other nodes end nothing.
    assert done.returncode == (1 if node == "evaluator" else 0)


def test_a_trial_ends_with_its_outcome(workspace):
    words = "worlds:=0 planner:=gap namespace:=r1 patience.start_s:=900 out:=out"
    done = launch(workspace, f"ros2 launch barn_eval trial.launch.py {words}")
    assert done.returncode == 0, done.stdout
    (row,) = (workspace / "out/results.jsonl").read_text().splitlines()
    assert json.loads(row)["outcome"] == "success"
    done = launch(workspace, "barn report out --out page.html")
    assert done.returncode == 0 and (workspace / "page.html").stat().st_size > 10000


def test_messages_are_built_by_the_systems_generators(workspace):
    script = ROOT / "ros_stand_ins/build_messages.py"
    done = launch(workspace, f"venv/bin/python {script} wheels simulation_interfaces")
    assert done.returncode == 0, done.stdout
    assert len(list(workspace.glob("wheels/*.whl"))) == 1


def test_packages_are_tested_in_the_environment_only(workspace):
    test = "colcon test --packages-select barn_metrics"
    activated = ". venv/bin/activate; . install/setup.bash"
    done = in_terminal(f"{activated}; {test}", workspace)
    assert "lacks the suite's libraries" in done.stdout
    assert "Traceback" not in done.stdout

    tools = "pip install --quiet pytest pytest-timeout pytest-xdist hypothesis"
    words = f"{activated}; {tools}; python -m {test} && colcon test-result"
    done = in_terminal(words, workspace, timeout=3600)
    assert done.returncode == 0, done.stdout
    assert ", 0 errors, 0 failures" in done.stdout


def test_without_the_environment_a_launch_fails_in_one_line(workspace):
    venv = Path(workspace, "venv")
    away = venv.rename(workspace / "away")
    try:
        done = launch(workspace, "ros2 launch barn_worlds map_server.launch.py")
    finally:
        away.rename(venv)
    assert done.returncode == 1
    assert "build the workspace again" in done.stdout.splitlines()[-1]
