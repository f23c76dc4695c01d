"""Nothing that nodes send in lockstep is lost on a busy machine: the simulator waits for planner and evaluator."""

import os
import signal
import threading
import time
from dataclasses import replace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from ros_runs import SHORT, drive, make_plan, messages, node_process, nothing_left, until  # noqa: F401


def test_an_evaluator_without_processor_time_is_waited_for(tmp_path, nothing_left):  # noqa: F811
    longer = replace(SHORT, limit_s=20.0, timeout_time_s=20.0)
    part = tmp_path / "run" / "bags" / "dwa_w0000_r00.partial" / "dwa_w0000_r00_0.mcap"

    def suspend():
        for size in (10_000, 100_000, 200_000):
            until(lambda size=size: part.exists() and part.stat().st_size > size)
            (pid,) = node_process(nothing_left, "barn_eval.ros.evaluator")
            os.kill(pid, signal.SIGSTOP)
            time.sleep(1.0)  # dozens of cycles, far more than publishers keep
            os.kill(pid, signal.SIGCONT)

    suspended = threading.Thread(target=suspend, daemon=True)
    suspended.start()
    (result,) = drive(tmp_path / "run", make_plan(longer))
    suspended.join(timeout=1.0)
    assert not suspended.is_alive()
    assert result.measures.unanswered_cycles == 0
    bag = messages(tmp_path / "run" / "bags" / result.trial_id)
    cycles = len(bag["/odom"])
    assert cycles > 200
    assert {topic: len(bag[topic]) for topic in ("/scan", "/amcl_pose", "/clock")} == dict.fromkeys(
        ("/scan", "/amcl_pose", "/clock"), cycles
    )
    assert len(bag["/cmd_vel"]) in (cycles - 1, cycles)
