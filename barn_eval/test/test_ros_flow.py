"""Nothing that nodes send in lockstep is lost on a busy machine: the simulator waits for planner and evaluator."""

import os
import signal
import threading
import time
from dataclasses import replace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from ros_runs import FOREIGN, SHORT, drive, foreign, make_plan, messages, node_process, nothing_left  # noqa: F401
from waiting import until


@pytest.mark.parametrize("planner", ["dwa", "talks"])
def test_an_evaluator_without_processor_time_is_waited_for(tmp_path, nothing_left, planner):  # noqa: F811
    longer = replace(SHORT, limit_s=20.0, timeout_time_s=20.0, collision_ends_trial=False)
    command = foreign(FOREIGN, tmp_path / "starts", planner) if planner == "talks" else ""
    plan = make_plan(longer, planner=planner, planner_command=command)
    part = tmp_path / "run" / "bags" / f"{planner}_w0000_r00.partial" / f"{planner}_w0000_r00_0.mcap"

    def suspend():
        for size in (10_000, 100_000, 200_000):
            until(lambda size=size: part.exists() and part.stat().st_size > size)
            (pid,) = node_process(nothing_left, "barn_eval.ros.evaluator")
            os.kill(pid, signal.SIGSTOP)
            time.sleep(1.0)  # dozens of cycles, far more than publishers keep
            os.kill(pid, signal.SIGCONT)

    suspended = threading.Thread(target=suspend, daemon=True)
    suspended.start()
    (result,) = drive(tmp_path / "run", plan)
    suspended.join(timeout=600.0)
    assert not suspended.is_alive()
    assert result.measures.unanswered_cycles == 0
    bag = messages(tmp_path / "run" / "bags" / result.trial_id)
    cycles = len(bag["/odom"])
    assert cycles > 200
    topics = ("/scan", "/amcl_pose", "/clock")
    assert {topic: len(bag[topic]) for topic in topics} == dict.fromkeys(topics, cycles)
    own = ("/cmd_vel", "/thoughts") if planner == "talks" else ("/cmd_vel",)
    assert [len(bag[topic]) for topic in own if len(bag[topic]) not in (cycles - 1, cycles)] == []
