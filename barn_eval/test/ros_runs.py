"""What the tests of trials over ROS have in common.

Plans, the processes of a test, and the messages of a bag.
"""

import os
import shlex
import signal
import sys
import uuid
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader
from waiting import ROOT

from barn_eval.results.bags.bagfile import BagFile
from barn_eval.results.store import BagStore
from barn_eval.ros.supervision.supervisor import run_ros_trials
from barn_eval.ros.work import run_request
from barn_eval.running.reporting import Reporter
from barn_eval.running.request import RunRequest
from barn_eval.trials.protocol import CHALLENGE
from barn_eval.trials.ros_config import RosConfig, WaitLimits
from barn_eval.trials.run_config import ExecutionConfig, PlannerChoice, RunConfig
from barn_eval.trials.spec import simulator_config
from barn_worlds.messages.cdr import deserialize, find_slots

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

EXAMPLE = ROOT / "examples" / "simple_planner.py"
FOREIGN = Path(__file__).with_name("foreign_planner.py")
MARK = "BARN_TEST_MARK"
# Ends by itself after two seconds of driving, half a second of the machine's time.
SHORT = replace(
    CHALLENGE, name="short", limit_s=2.0, first_motion_limit_s=2.0, timeout_time_s=2.0
)
_LONG_S = 600.0  # only what hangs takes as long
_PATIENCE = WaitLimits(
    start_s=_LONG_S, simulator_s=_LONG_S, gate_s=_LONG_S, lifecycle_s=_LONG_S, service_s=_LONG_S, command_s=_LONG_S,
    clock_s=_LONG_S, vanished_s=60.0, connection_s=60.0
)  # fmt: skip
PATIENT = RosConfig(
    command_wait_s=_LONG_S, patience=_PATIENCE
)  # no verdict hangs on the pace of the machine
EACH = replace(PATIENT, restart_planner="each_trial")
MANAGED = replace(
    PATIENT, command_wait_s=5.0
)  # what a scan costs that comes while nodes become active
# So, but for a planner's silence: for tests that wait for it in full. It counts by the
# evaluator's own progress.
QUICK = RosConfig(patience=replace(_PATIENCE, command_s=5.0))


@pytest.fixture(autouse=True)
def nothing_left(monkeypatch):
    """Mark all processes of a test by a variable of their environment, and see that
    none outlives it.
    """
    mark = uuid.uuid4().hex
    monkeypatch.setenv(MARK, mark)
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    yield mark
    left = marked(mark)
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    assert not left


def marked(mark, text=""):
    """Return the processes other than this one that carry the mark and have the text in
    their command line.
    """
    processes = []
    for entry in Path("/proc").iterdir():
        with suppress(OSError, ValueError):
            pid = int(entry.name)
            state = (entry / "stat").read_text().rsplit(")", 1)[1].split()[0]
            if (
                pid == os.getpid()
                or state == "Z"
                or f"{MARK}={mark}".encode() not in (entry / "environ").read_bytes()
            ):
                continue
            if text in (entry / "cmdline").read_bytes().decode():
                processes.append(pid)
    return processes


def node_process(mark, module):
    """Return the process of a node of ours, not its launcher."""
    return [
        pid
        for pid in marked(mark, module)
        if b"launcher.py" not in Path(f"/proc/{pid}/cmdline").read_bytes()
    ]


def launchers(mark, command):
    """Return the launchers of a command."""
    return [
        pid
        for pid in marked(mark, command)
        if b"launcher.py" in Path(f"/proc/{pid}/cmdline").read_bytes()
    ]


def make_plan(
    protocol=SHORT, ros=PATIENT, planner="dwa", planner_command="", **changes
):
    planners = (PlannerChoice(planner, command=planner_command),)
    rules = {"protocol": protocol, "simulator": simulator_config(protocol), "ros": ros}
    return replace(
        RunConfig(
            worlds="0", planners=planners, mode="ros", seed=5, bags="all", **rules
        ),
        **changes,
    )


def drive(folder, plan, notice=lambda _: None):
    """Yield the result of each trial of a plan once it has ended.

    Bags go to the folder.
    """
    for record in run_ros_trials(
        plan, plan.trials(), BagStore(folder, plan.bags), notice=notice
    ):
        yield record.result


def drive_kinds(folder, *kinds, protocol=SHORT, setup=EACH, repetitions=0):
    """Return the results of the foreign planner, which is of one kind after the other."""
    command = foreign(FOREIGN, folder / "starts", *kinds)
    plan = make_plan(
        protocol, setup, "foreign", command, repetitions=repetitions or len(kinds)
    )
    return list(drive(folder / "run", plan))


def run(folder, plan):
    """Run a plan as the command does, by a worker, and return its results.

    They are in the folder as well.
    """
    request = RunRequest(plan, ExecutionConfig(workers=1), folder)
    return run_request(request, Reporter())


def foreign(script, *arguments):
    return shlex.join([sys.executable, str(script), *map(str, arguments)])


def messages(bag):
    """Return the decoded messages of a bag by topic, as (time from the first, message)."""
    messages_by_topic = {}
    with AnyReader([bag]) as reader:
        for connection, stamp, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            messages_by_topic.setdefault(connection.topic, []).append(
                (stamp - reader.start_time, message)
            )
    return messages_by_topic


def unstamped(bag):
    """Return the bytes of a bag's messages by topic with the seconds of all stamps 0:
    over ROS they count from another.

    Of the reports on /diagnostics only those of the planner.
    """
    contents = {}
    for record in BagFile(bag).messages():
        data = bytearray(record.data)
        message = deserialize(record.data, record.type_name)
        if record.topic == "/diagnostics" and message.status[0].name != "planner":
            continue
        for name, slot in find_slots(message).items():
            if name.endswith(".sec"):
                data[slot.offset : slot.offset + 4] = bytes(4)
        contents.setdefault(record.topic, []).append(bytes(data))
    return contents
