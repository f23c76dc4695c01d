"""A trial in IR-SIM is judged live; skipped where ir-sim is not installed."""

import os
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("irsim", reason="ir-sim is not installed: pip install ir-sim")
pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from barn_eval.results.rows import RowFile
from barn_eval.trials.result import Outcome
from barn_worlds.ros.domain import reserve_domain

EXAMPLE = Path(__file__).parents[1]


def test_a_planner_drives_through_a_world_in_ir_sim(tmp_path):
    line = (
        f"run --system {EXAMPLE}/ir_sim.yaml --worlds 0 --planner gap"
        f" --out {tmp_path}/out"
    )
    with reserve_domain(os.environ) as domain:
        environment = os.environ | {"ROS_DOMAIN_ID": str(domain), "MPLBACKEND": "Agg"}
        bridge = subprocess.Popen(
            [sys.executable, EXAMPLE / "bridge.py", "--ros-args", "-p", "pace:=4.0"],
            env=environment,
        )
        try:
            command = [sys.executable, "-m", "barn_eval", *shlex.split(line)]
            ended = subprocess.run(
                command, env=environment, capture_output=True, text=True, check=False
            )
        finally:
            bridge.send_signal(signal.SIGINT)
            code = bridge.wait()
    assert code == 0
    (row,) = RowFile(tmp_path / "out").read()
    assert row.outcome is Outcome.SUCCESS, ended.stdout + ended.stderr
    assert row.observed.system == "ir-sim"
    assert row.observed.clearance_by == "world"
    assert row.measures.contacts == 0
    # The robot cannot have been faster than it may drive.
    assert row.scores.traversal_time_s > 9.0 / 2.0
