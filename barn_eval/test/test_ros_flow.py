"""Nothing that nodes send in lockstep is lost on a busy machine: the simulator waits for planner and evaluator."""

import os
import signal
import threading
import time
from dataclasses import replace

from ros_runs import SHORT, drive_kinds, messages, node_process, nothing_left  # noqa: F401
from waiting import until


def test_an_evaluator_without_processor_time_is_waited_for(tmp_path, nothing_left):  # noqa: F811
    longer = replace(SHORT, limit_s=20.0, timeout_time_s=20.0, collision_ends_trial=False)
    part = tmp_path / "run" / "bags" / "foreign_w0000_r00.partial" / "foreign_w0000_r00_0.mcap"

    def suspend():
        for size in (10_000, 100_000, 200_000):
            until(lambda size=size: part.exists() and part.stat().st_size > size)
            (pid,) = node_process(nothing_left, "barn_eval.ros.evaluator")
            os.kill(pid, signal.SIGSTOP)
            time.sleep(1.0)  # dozens of cycles, far more than publishers keep
            os.kill(pid, signal.SIGCONT)

    suspended = threading.Thread(target=suspend, daemon=True)
    suspended.start()
    (result,) = drive_kinds(tmp_path, "talks", protocol=longer)
    suspended.join(timeout=600.0)
    assert not suspended.is_alive()
    assert result.measures.unanswered_cycles == 0
    bag = messages(tmp_path / "run" / "bags" / result.trial_id)
    cycles = len(bag["/odom"])
    assert cycles > 200
    topics = ("/scan", "/amcl_pose", "/clock")
    assert {topic: len(bag[topic]) for topic in topics} == dict.fromkeys(topics, cycles)
    own = [len(bag[topic]) for topic in ("/cmd_vel", "/thoughts")]
    assert [count for count in own if count not in (cycles - 1, cycles)] == []
