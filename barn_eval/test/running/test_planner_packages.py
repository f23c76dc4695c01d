"""Planners from the source of packages that nobody built."""

import json
import shutil
import subprocess

import pytest
from refusals import refused
from waiting import run_python

from barn_eval.running import start_nodes
from barn_eval.running.planner_packages import find_executable, find_packaged
from barn_eval.running.planner_sources import explain_end, read_source

SETUP = """
from setuptools import setup
raise SystemExit("it was executed")
package_name = "follow"
setup(
    name=package_name,
    entry_points={"console_scripts": [
        # "old = follow.old:main",
        "follower = follow.node:main",
        f"{package_name}_viewer = {package_name}.viewer:run",
    ]},
)
"""
CFG = """
[options.entry_points]
console_scripts =
    wanderer = wander.node:main
"""
CMAKE = """
install(PROGRAMS
  scripts/drive.py scripts/run.sh
  DESTINATION lib/${PROJECT_NAME})
"""


def write_package(folder, name, files):
    for path, text in {
        "package.xml": f"<package><name>{name}</name></package>",
        **files,
    }.items():
        file = folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)


@pytest.fixture
def workspace(tmp_path):
    """Three packages as somebody cloned them, with the copies of a build."""
    node = (
        "import sys\nfrom helper.words import WORD\ndef main(): print(WORD, sys.argv)\n"
    )
    follow = {"setup.py": SETUP, "follow/__init__.py": "", "follow/node.py": node}
    write_package(tmp_path / "src" / "follow", "follow", follow)
    helper = {
        "setup.py": "",
        "helper/__init__.py": "",
        "helper/words.py": "WORD = 'hello'\n",
    }
    write_package(tmp_path / "src" / "helper", "helper", helper)
    write_package(tmp_path / "build" / "follow", "follow", follow)
    return tmp_path


def test_an_executable_of_a_workspace_starts_as_it_would_be_installed(
    workspace, tmp_path
):
    executable = find_executable(f"{workspace}:follower")
    variables = executable.make_prefix(tmp_path / "prefix", {"PYTHONPATH": "/last"})
    assert variables["PYTHONPATH"].endswith(":/last")
    process = subprocess.run(
        [*executable.command, "--ros-args"],
        env=variables,
        cwd=workspace / "build",
        capture_output=True,
        text=True,
        check=True,
    )
    assert process.stdout == "hello ['follower', '--ros-args']\n"
    share = tmp_path / "prefix" / "share" / "helper"
    assert (share / "package.xml").is_file()


@pytest.mark.parametrize(
    "name, files, entries",
    [
        ("a", {"setup.cfg": CFG}, [("wanderer", "wander.node:main")]),
        ("b", {"CMakeLists.txt": CMAKE}, [("drive.py", "scripts/drive.py")]),
    ],
)
def test_executables_of_other_kinds_of_packages(tmp_path, name, files, entries):
    write_package(tmp_path / name, name, files)
    executable = find_executable(str(tmp_path / name))
    assert [(executable.name, executable.entry)] == entries


LAUNCH = """
import os
from launch_ros.actions import Node
def generate_launch_description():
    share = get_package_share_directory("follow")
    clock = LaunchConfiguration("clock", default="true")
    ghost = Node(package="follow", executable="nothing")
    follower = Node(
        package="follow",
        executable="follower",
        name="leader",
        parameters=[os.path.join(share, "a.yaml"), {"use_sim_time": clock, "x": -5.0}],
        remappings=[("scan", LaunchConfiguration("scan"))],
        arguments=["--fast"],
    )
    world = PythonLaunchDescriptionSource(os.path.join(
        get_package_share_directory("gazebo"), "launch", "world.launch.py"))
    near = PythonLaunchDescriptionSource([share + "/launch/near.launch.py"])
    return LaunchDescription([
        DeclareLaunchArgument("scan", default_value="/front/scan"),
        DeclareLaunchArgument("rviz", default_value="false"),
        Node(package="rviz2", executable="rviz2", arguments=[Command(["x"])]),
        Node(package="helper", executable="helper", condition=IfCondition(
            LaunchConfiguration("rviz"))),
        IncludeLaunchDescription(world), IncludeLaunchDescription(near), follower,
    ])
"""
NEAR = """
def generate_launch_description():
    return LaunchDescription([Node(package="follow", executable="follower")])
"""
ARGUMENTS = (
    "--fast --ros-args -r __node:=leader -r scan:=/front/scan --params-file {}/a.yaml"
    " -p use_sim_time:=true -p x:=-5.0 --"
)


def test_a_launch_file_starts_its_nodes_that_are_in_the_workspace(workspace, tmp_path):
    folder = workspace / "src" / "follow"
    for name, text in (("far", LAUNCH), ("near", NEAR)):
        path = folder / "launch" / f"{name}.launch.py"
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)

    executable = find_executable(f"{workspace}:far.launch.py")
    assert executable == find_executable(str(folder / "launch" / "far.launch.py"))
    arguments = [" ".join(arguments) for _, arguments in executable.launched]
    assert sorted(arguments) == [ARGUMENTS.format(folder), "--ros-args --"]
    bringup = workspace / "src" / "bringup" / "launch"
    shutil.copytree(folder / "launch", bringup)
    assert find_executable(f"{bringup}/near.launch.py").launched
    with refused(r"bringup/launch/far.*, .*follow/launch/far"):
        find_executable(f"{workspace}:far.launch.py")
    shutil.rmtree(bringup)

    with refused(r"are not supported, got 'rviz:=false'; .* -p"):
        find_packaged([f"package:{workspace}:far.launch.py", "rviz:=false"])

    variables = executable.make_prefix(tmp_path / "prefix", {})
    output = subprocess.check_output([*executable.command, "-x"], env=variables)
    assert output.count(b"hello ['follower', '--") == 2
    assert output.count(b"'--', '-x']") == 2


@pytest.mark.parametrize(
    "node, problem",
    [
        ("executable=f(1)", r"line 2: cannot read f\(1\) without executing it"),
        ("executable='other'", "has no Python executable 'other'"),
        ("executable=e", "cannot read e without"),
        ("parameters=p, executable='follower')\np = [p]\nstr(", "recursion"),
    ],
)
def test_a_launch_file_that_only_its_execution_tells_is_refused(
    workspace, node, problem
):
    path = workspace / "src" / "follow" / "a.launch.py"
    path.write_text(
        f"def generate_launch_description():\n return Node(package='follow', {node})\n"
    )
    with refused(problem):
        find_executable(f"{workspace}:a.launch.py")


def test_the_nodes_of_a_launch_file_end_with_the_first_that_fails():
    loud = "trap 'echo ends; exit' TERM; echo begins; while true; do sleep 0.1; done"
    commands = [["sh", "-c", loud], ["sh", "-c", "sleep 1; echo reason; exit 7"]]
    words = (start_nodes.__file__, json.dumps(commands))
    done = run_python(*words, check=False)
    assert (done.returncode, done.stdout) == (7, "begins\nreason\n")


def test_an_entry_and_a_file_can_be_named(workspace):
    assert (
        find_executable(f"{workspace}/src/follow:follow.node:run").entry
        == "follow.node:run"
    )
    file = workspace / "src/follow/follow/node.py"
    executable = find_executable(str(file))
    assert (executable.entry, executable.sources()) == ("node:main", [file])
    file.write_text(file.read_text() + 'if __name__ == "__main__":\n    main()\n')
    executable = find_executable(str(file))
    assert (executable.entry, executable.sources()) == ("node.py", [file])
    # What ROS 1 leaves at the top of a workspace.
    (workspace / "src" / "CMakeLists.txt").symlink_to("/nowhere")
    assert find_executable(f"{workspace}:follower").folder == file.parents[1]


@pytest.mark.skipif(shutil.which("c++") is None, reason="there is no compiler")
def test_message_types_of_a_workspace_are_built_if_the_planner_imports_them(
    workspace, tmp_path
):
    pytest.importorskip("barn_ros_stand_ins.build_types", reason="no generators")
    # A folder may have another name than its package.
    folder = workspace / "src" / "types"
    write_package(folder, "own_msgs", {"msg/Info.msg": "geometry_msgs/Point p\n"})
    executable = find_executable(f"{workspace}/src:follower")
    executable.make_prefix(tmp_path / "other", {})
    assert not (tmp_path / "other" / "types").exists()

    (workspace / "src/follow/follow/node.py").write_text(
        "from own_msgs.msg import Info\nfrom rclpy.serialization import serialize_message\n"
        "def main(): print(len(serialize_message(Info())))\n"
    )
    variables = executable.make_prefix(tmp_path / "prefix", {})
    process = subprocess.run(
        executable.command, env=variables, capture_output=True, text=True, check=True
    )
    assert process.stdout == "28\n"

    (folder / "msg" / "Bad.msg").write_text("nowhere/Point p\n")
    executable.make_prefix(tmp_path / "second", {})
    assert "nowhere" in (tmp_path / "second" / "types.log").read_text()


COMPUTED = "console_scripts = []\nd = {'console_scripts': [f'{name()} = a:b']}\n"
COMPILED = "add_executable(planner_node src/planner.cpp)\n"


@pytest.mark.parametrize(
    "files, name, problem",
    [
        (
            {"setup.py": SETUP},
            "",
            "name one of its executables or launch files, as DIR:NAME: follower, follow_viewer$",
        ),
        (
            {"setup.py": SETUP},
            ":folower",
            "no executable 'folower'; did you mean 'follower'?",
        ),
        (
            {"setup.py": COMPUTED},
            "",
            r"p/setup.py, line 2: cannot read name\(\) without",
        ),
        ({"setup.py": "def ("}, "", "p/setup.py: .*invalid syntax|was never closed"),
        ({"setup.py": ""}, "", "name the function to start: DIR:MODULE:FUNCTION"),
        (
            {"setup.py": SETUP, "scripts/node.py": ""},
            ":follower",
            r"p/follow/node.py is missing; instead start .*/p/scripts/node.py$",
        ),
        (
            {"CMakeLists.txt": COMPILED},
            "",
            'planner_node of .* is compiled; .* --planner-command "ros2 run p planner_node"',
        ),
        (
            {
                "CMakeLists.txt": "project(turns)\n# add_executable(old a.cpp)\n"
                'set(KIND "node")\nadd_executable(${PROJECT_NAME}_${KIND} b.cpp)\n',
                "package.xml": "",
            },
            "",
            'turns_node of .* is compiled; .* "ros2 run turns turns_node"',
        ),
        (
            {
                "CMakeLists.txt": "# add_executable(old a.cpp)\n",
                "package.xml": "<buildtool_depend>catkin</buildtool_depend>",
            },
            "",
            "the package is for ROS 1",
        ),
    ],
)
def test_what_cannot_be_started_is_refused_with_what_to_type(
    tmp_path, files, name, problem
):
    write_package(tmp_path / "p", "p", files)
    with refused(f"(?s){problem}"):
        find_executable(f"{tmp_path}/p{name}")


def test_the_files_that_send_commands_are_named_where_there_is_no_package(tmp_path):
    (tmp_path / "drive.py").write_text("self.create_publisher(Twist, '/cmd_vel', 1)")
    (tmp_path / "view.py").touch()
    with refused(r"FILE.py:FUNCTION: \S*/drive.py$"):
        find_executable(str(tmp_path))


def test_modules_are_looked_for_through_a_packages_own_files(workspace):
    node = workspace / "src/follow/follow/node.py"
    node.write_text(
        "import nowhere_a.part\nfrom . import near, SPEED\nfrom helper import words\n"
        "from . import *\nimport own_interfaces.srv\n"
        "try:\n    import nowhere_b\nexcept ImportError:\n    pass\n"
        "self.declare_parameter('goal_x', 1.0)\n"
    )
    (workspace / "src/follow/follow/near.py").write_text(
        "from tf2 import x\nimport json\n"
    )
    source = read_source(f"package:{workspace}:follower")
    missing = source.missing_modules({})
    assert list(missing) == ["nowhere_a", "own_interfaces", "tf2"]
    assert missing["own_interfaces"].startswith(
        "its types are neither installed nor built here"
    )
    assert "PyPI is another package" in missing["tf2"]
    assert source.goal_arguments() == " --ros-args -p goal_x:={goal_x}"


def test_an_end_without_a_word_is_explained(tmp_path):
    script = tmp_path / "silent.py"
    script.write_text("import sys\n\ndef main():\n    print(1)\n")
    command = f"python {script}"
    assert f"--planner-package {script}:main" in explain_end(command, "")
    assert "input" in explain_end(command, "EOFError: EOF when reading a line")
    missing = "ModuleNotFoundError: No module named 'cv2.aruco'"
    assert explain_end(command, missing).endswith("opencv-python-headless")
    missing = "ModuleNotFoundError: No module named 'follow.old'"
    assert explain_end(command, missing).endswith("follow does not contain it")
    script.write_text(script.read_text() + "\nmain()\n")
    assert explain_end(command, "") == ""
