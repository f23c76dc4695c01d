"""Planner packages do what their pages say, installed as users install them.

The template in C++ is whole.
"""

import json
import re
import shlex
import shutil
import sys

import pytest
from defusedxml import ElementTree
from repository import EXAMPLES
from waiting import run_python, with_search_path

PYTHON = EXAMPLES / "template_planner_py"
CPP = EXAMPLES / "template_planner_cpp"
PREDICTIVE = EXAMPLES / "predictive_planners"
TRAINING = EXAMPLES / "policy_training"


@pytest.fixture(scope="module")
def installed_packages(tmp_path_factory):
    """Return the environment in which the packages are installed in their own folder.

    Entry points are installed, too.
    """
    folder = tmp_path_factory.mktemp("installed")
    sources = [folder / package.name for package in (PYTHON, PREDICTIVE)]
    for source in sources:
        shutil.copytree(
            EXAMPLES / source.name, source, ignore=shutil.ignore_patterns("__pycache__")
        )
    target = folder / "target"
    options = "--quiet --no-deps --no-build-isolation --no-index --target"
    install = ("-m", "pip", "install", *options.split())
    run_python(*install, target, *sources, timeout=600)
    environment = with_search_path(target, EXAMPLES)
    return environment | {"PYTHONDONTWRITEBYTECODE": "1"}


def python(environment, folder, line):
    """Run a module in a folder and return how it ended."""
    options = {"env": environment, "cwd": folder, "timeout": 600}
    return run_python("-m", *shlex.split(line), check=False, **options)


def barn(environment, folder, options):
    """Run the barn command and return the rows of its results."""
    trial = "run --protocol challenge --worlds 0 --json --out run"
    done = python(environment, folder, f"barn_eval {trial} {options}")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)["results"]


@pytest.mark.parametrize(
    "folder", [PYTHON, PREDICTIVE, TRAINING], ids=lambda folder: folder.name
)
def test_its_own_tests_pass(installed_packages, tmp_path, folder):
    if folder is TRAINING:
        pytest.importorskip("stable_baselines3")
    line = f"pytest -q -p no:cacheprovider {folder}/test"
    done = python(installed_packages, tmp_path, line)
    assert done.returncode == 0, done.stdout


def test_registered_it_refuses_a_wrong_configuration(installed_packages, tmp_path):
    line = "barn_eval run --planner template --set max_speed_mps=3.0"
    done = python(installed_packages, tmp_path, line)
    assert done.returncode == 2
    assert "max_speed_mps must be from 0 to 2 m/s, got 3.0" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_as_a_node_of_its_own_it_completes_a_world_in_lockstep(
    installed_packages, tmp_path
):
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    node = f"{sys.executable} -m template_planner.node"
    options = f"--mode ros --planner mine --planner-command '{node}'"
    (result,) = barn(installed_packages, tmp_path, options)
    assert result["outcome"] == "success", result["detail"]


def test_registered_it_completes_a_world_directly_as_over_ros(
    installed_packages, tmp_path
):
    rows = []
    for mode in ("direct", "ros"):
        if mode == "ros":
            pytest.importorskip("rclpy", reason="ROS 2 is not installed")
        (tmp_path / mode).mkdir()
        options = f"--planner template --set max_speed_mps=0.6 --mode {mode}"
        (row,) = barn(installed_packages, tmp_path / mode, options)
        assert row["outcome"] == "success"
        rows.append({key: row[key] for key in ("planner", "scores", "measures")})
    assert rows[0] == rows[1]


@pytest.mark.parametrize(
    "folder", [PYTHON, PREDICTIVE, CPP], ids=lambda folder: folder.name
)
def test_package_and_build_agree(folder):
    package = ElementTree.parse(folder / "package.xml").getroot()
    name = package.findtext("name")
    build = (folder / ("CMakeLists.txt" if folder is CPP else "setup.py")).read_text()
    assert f'NAME = "{name}"' in build or f"project({name})" in build
    kinds = ("depend", "exec_depend", "buildtool_depend")
    needed = {element.text for element in package if element.tag in kinds}
    if folder is CPP:
        assert set(re.findall(r"find_package\((\w+)", build)) == needed
        for file in re.findall(r"(\S+\.cpp)", build):
            used = re.findall(r'#include "(\w+)/', (folder / file).read_text())
            assert set(used) == needed - {"ament_cmake"}
    else:
        assert (folder / "resource" / name).is_file()
    if folder is not PREDICTIVE:
        launch_file = folder / "launch" / "template_planner.launch.py"
        assert f'package="{name}"' in launch_file.read_text()


def test_the_build_of_the_suite_leaves_them_out():
    assert (EXAMPLES / "COLCON_IGNORE").is_file()
