"""Fixtures: message packages of ROS of which the wheels have none, built once."""

import importlib.util
import os
import shutil
from pathlib import Path

import pytest
from waiting import run_python


@pytest.fixture(scope="session")
def extra_message_types(tmp_path_factory):
    """A folder with message packages of which the wheels have none.

    None where they are installed.
    """
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    # A second copy of an installed package would not find the libraries of the first.
    names = [
        name
        for name in ("nav2_msgs", "simulation_interfaces", "tf2_msgs")
        if importlib.util.find_spec(name) is None
    ]
    if not names:
        return None
    if not (
        importlib.util.find_spec("rosidl_generator_py")
        and shutil.which("cc")
        and shutil.which("c++")
    ):
        pytest.skip("neither nav2_msgs nor what builds it is installed")
    folder = tmp_path_factory.mktemp("messages")
    script = Path(__file__).with_name("message_packages.py")
    built = run_python(script, folder, *names, check=False)
    if built.returncode and "Python.h" in built.stderr:
        pytest.skip("the headers of Python are not installed")
    assert not built.returncode, built.stderr
    return folder


@pytest.fixture
def with_extra_messages(extra_message_types, monkeypatch):
    if extra_message_types is not None:
        for name in ("PYTHONPATH", "LD_LIBRARY_PATH"):
            monkeypatch.setenv(
                name,
                f"{extra_message_types}{os.pathsep}{os.environ.get(name, '')}".rstrip(
                    os.pathsep
                ),
            )
