"""The whole of Nav2 in real time, as examples/nav2 shows it, where Nav2 is installed.

It is looked for in AMENT_PREFIX_PATH; NAV2_LAUNCH may name a command that does what
`ros2 launch` does, in an environment of its own. The suite publishes transforms where
its Python has tf2_msgs.
"""

import importlib.util
import os
import signal
import threading
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from repository import EXAMPLES
from ros_runs import drive, make_plan, marked, nothing_left  # noqa: F401 (a fixture)
from waiting import until

from barn_eval.trials.protocol import CHALLENGE
from barn_eval.trials.result import Outcome
from barn_eval.trials.ros_config import RosConfig, WaitLimits

LAUNCH_FILE = EXAMPLES / "nav2/nav2.launch.py"
PREFIXES = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
INSTALLED = any(Path(prefix, "share/nav2_bt_navigator").is_dir() for prefix in PREFIXES)
LAUNCH = os.environ.get("NAV2_LAUNCH") or ("ros2 launch" if INSTALLED else "")

if not LAUNCH or not importlib.util.find_spec("tf2_msgs"):
    pytest.skip("Nav2 or tf2_msgs is not installed", allow_module_level=True)


def test_a_killed_server_ends_one_trial_and_the_next_ones_drive(tmp_path, nothing_left):  # noqa: F811
    ros = RosConfig(
        lockstep=False,
        planner_node="nav2_trial",
        patience=WaitLimits(gate_s=60.0, command_s=120.0),
        goal_by="action",
    )
    short = replace(CHALLENGE, name="short", limit_s=20.0, timeout_time_s=20.0)
    command = f"{LAUNCH} {LAUNCH_FILE} controller:=rpp map:=false"
    plan = make_plan(short, ros, "nav2_rpp", command, worlds="0-2")
    trials = drive(tmp_path, plan)
    killer = threading.Thread(
        target=kill_once_it_controls,
        args=(nothing_left, tmp_path / "logs" / "planner.log"),
    )
    killer.start()
    first, *later_results = trials
    killer.join()
    assert first.outcome is Outcome.PLANNER_DIED
    for result in later_results:
        assert result.outcome in (
            Outcome.SUCCESS,
            Outcome.TIMEOUT,
            Outcome.COLLISION,
        ), result.detail
        assert result.measures.driven_m > 1.0


def kill_once_it_controls(mark, log):
    until(
        lambda: (
            log.exists()
            and "begin computing control effort" in log.read_text(errors="replace")
        )
    )
    (server,) = marked(mark, "lib/nav2_controller/controller_server")
    os.kill(server, signal.SIGKILL)
