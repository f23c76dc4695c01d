"""A robot that somebody else runs is judged live, by its odometry and its own clock."""

import os
import pty
import re
import shlex
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
import ros_runs as ros
import yaml
from refusals import refused
from waiting import barn_words

from barn_eval.results.bags.bagfile import BagFile
from barn_eval.results.rows import RowFile
from barn_eval.ros.observed import load_interfaces
from barn_eval.ros.simulator import SimulatorClient
from barn_eval.trials.protocol import CHALLENGE
from barn_eval.trials.result import Outcome
from barn_eval.trials.ros_config import EvaluatorConfig
from barn_eval.trials.system_file import SystemFile, read_system
from barn_eval.verification.check import check_folder
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import BarnError
from barn_worlds.messages import decode
from barn_worlds.ros.domain import reserve_domain

ROBOT = Path(__file__).parents[1] / "emulated_robot.py"
FAULTS = ("none", "gap", "clock", "stamp", "contact")
FILE = {
    "schema_version": 1,
    "name": "emulated",
    "kind": "robot",
    "pose": "/odom",
    "contact": "/robot/bumper",
    "reset": "service",
    "reset_service": "/robot/reset",
    "topics": {
        "odom": "/robot/odom",
        "scan": "/robot/scan",
        "cmd_vel": "/robot/cmd_vel",
    },
}


def write(folder, **changes):
    path = folder / "robot.yaml"
    path.write_text(yaml.safe_dump(FILE | changes), "utf-8")
    return path


def run_in_terminal(command, environment, keys):
    """Run a command in a terminal; type each line once its text is shown.

    Returns what the terminal has shown.
    """
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        ["setsid", "--ctty", "--wait", *command],
        env=environment,
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
    )
    os.close(theirs)
    shown = ""
    read = 0
    waiting = list(keys)
    # Reading fails once nobody has the terminal any more.
    with suppress(OSError):
        while data := os.read(ours, 4096):
            shown += data.decode().replace("\r", "")
            while waiting and waiting[0][0] in shown[read:]:
                text, line = waiting.pop(0)
                read = shown.index(text, read) + len(text)
                os.write(ours, f"{line}\n".encode())
    process.wait()
    os.close(ours)
    return shown


def judge(folder, faults, keys=None, **changes):
    """Return rows of trials of the emulated robot, one for each of its faults.

    With keys, as of `run_in_terminal`, also what the terminal has shown.
    """
    # The robot goes straight and far faster than any that the suite knows.
    protocol = as_dict(CHALLENGE) | {"name": "straight", "first_motion_limit_s": 60.0}
    (folder / "straight.yaml").write_text(
        yaml.safe_dump({"schema_version": 1} | protocol), "utf-8"
    )
    with reserve_domain(os.environ) as domain:
        environment = os.environ | {"ROS_DOMAIN_ID": str(domain)}
        robot = subprocess.Popen(
            [sys.executable, ROBOT, ",".join(faults)], env=environment
        )
        try:
            words = ["run", "--system", str(write(folder, **changes)), "--worlds", "0"]
            words += ["--protocol", str(folder / "straight.yaml")]
            words += ["--repetitions", str(len(faults)), "--out", str(folder / "out")]
            command = barn_words(shlex.join(words))
            if keys is not None:
                shown = run_in_terminal(command, environment, keys)
            else:
                shown = subprocess.run(
                    command,
                    env=environment,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.STDOUT,
                    text=True,
                    check=False,
                ).stdout
        finally:
            robot.kill()
            robot.wait()
    rows = RowFile(folder / "out").read()
    assert len(rows) == len(faults), shown
    if keys is not None:
        return rows, shown
    return rows


@pytest.fixture(scope="module")
def trials(tmp_path_factory):
    """Row and bag of a trial with each fault."""
    folder = tmp_path_factory.mktemp("observed")
    rows = judge(folder, FAULTS)
    bags = [folder / "out/bags" / row.trial_id for row in rows]
    return dict(zip(FAULTS, zip(rows, bags, strict=True), strict=True))


def poses_of(bag):
    """The times of a bag's odometry, in s, and its distance from the first pose."""
    messages = [
        message.data for message in BagFile(bag).messages() if message.topic == "/odom"
    ]
    odometry = list(map(decode.odometry, messages))
    start = odometry[0].pose
    return [(1e-9 * item.stamp_ns, start.distance(item.pose)) for item in odometry]


def test_a_robot_is_judged_by_odometry_that_begins_anywhere(trials):
    row, bag = trials["none"]
    assert row.outcome is Outcome.SUCCESS
    # By the bag alone: from leaving the start to arriving 1 m before the goal.
    times = poses_of(bag)
    left_s = next(time_s for time_s, way_m in times if way_m > 0.1)
    arrived_s = next(time_s for time_s, way_m in times if way_m > 9.0)
    assert row.scores.traversal_time_s == pytest.approx(arrived_s - left_s, abs=0.1)
    assert row.measures.contacts == 0
    assert row.speed_cap_mps is None
    assert row.observed.system == "emulated"
    # Two seconds more than the trial.
    assert times[-1][0] - arrived_s > 1.5


def test_a_check_judges_no_bag_in_a_frame_of_its_own(trials):
    _, bag = trials["none"]
    check = check_folder(bag.parents[1])
    assert not any("readings" in text for text in check.problems)
    assert check.driven == 0
    assert any("not driven again (emulated" in text for text in check.unchecked)


def test_a_gap_makes_times_uncertain(trials):
    row, _ = trials["gap"]
    assert row.outcome is Outcome.SUCCESS
    assert row.observed.time_uncertainty_s > 0.3


def test_a_clock_that_is_set_ends_the_trial(trials):
    row, _ = trials["clock"]
    assert row.outcome is Outcome.ENVIRONMENT_FAILED
    assert re.search(r"jump by \+3\d\.\d\d s: the clock was set", row.detail)


def test_an_isolated_wrong_stamp_changes_no_verdict(trials):
    row, _ = trials["stamp"]
    assert row.outcome is Outcome.SUCCESS
    assert row.scores.traversal_time_s < 10.0


def test_a_contact_that_the_robot_reports_ends_the_trial(trials):
    row, _ = trials["contact"]
    assert row.outcome is Outcome.COLLISION
    assert row.measures.contacts == 1


def test_an_operator_starts_a_trial_and_tells_of_a_contact(tmp_path):
    (row,) = judge(tmp_path, ["operator"], reset="operator", contact="operator")
    assert row.outcome is Outcome.COLLISION
    assert row.observed.contact_source == "operator"


def test_an_operator_has_keys_in_the_terminal(tmp_path):
    rows, shown = judge(
        tmp_path,
        ["none", "none"],
        keys=[
            ("Enter starts", "c"),
            ("has no effect now", "s"),
            ("Enter reports a contact", "c"),
            ("Enter starts", "abort"),
        ],
        reset="operator",
        contact="operator",
    )
    assert [row.outcome for row in rows] == [
        Outcome.COLLISION,
        Outcome.ENVIRONMENT_FAILED,
    ]
    assert rows[1].detail == "the operator aborted the trial"
    assert "put the robot at the start of world_0\n  x -2.250 m, y 3.000 m" in shown


STANDARD = {
    "kind": "simulator",
    "frame": "world",
    "contact": "none",
    "reset": "simulation_interfaces",
    "reset_service": "/robot/reset_simulation",
    "reset_scope": 2,
    "robot_entity": "jackal",
}


def test_services_of_the_standard_reset_a_simulator(tmp_path, with_extra_messages):
    (row,) = judge(tmp_path, ["simulator"], **STANDARD)
    # Its reset leaves the robot elsewhere than at the start, in the frame of the world.
    assert row.outcome is Outcome.SUCCESS
    assert row.measures.contacts is None


def test_a_reset_that_a_simulator_refuses_is_one_line(tmp_path, with_extra_messages):
    message = "emulated: /robot/set_entity_state: no entity husky"
    with pytest.raises(AssertionError, match=message):
        judge(tmp_path, ["simulator"], **STANDARD | {"robot_entity": "husky"})


def test_a_reset_without_its_package_is_refused_by_name(monkeypatch):
    monkeypatch.setitem(sys.modules, "simulation_interfaces.srv", None)
    with refused(r"simulation_interfaces: .* not installed"):
        load_interfaces()


def test_a_simulator_of_others_is_not_taken_for_the_suites():
    spec = ros.make_plan(CHALLENGE, worlds="0").trials()[0]
    client = SimulatorClient(
        None, lambda *_, **__: "done", EvaluatorConfig(dataset="barn300")
    )
    with refused("~/pause does not answer like the suite's simulator", BarnError):
        client.prepare(spec, 1.0)


WRONG = """
- [{name: barn}, name must not be that of the suite's own simulator]
- [{pose: "/tf:odom.base_link"}, pose must be a topic such as /odom]
- [{contact: bumper}, "contact must be a topic, operator or none"]
- [{topics: {lidar: /scan}}, "topics must be among cmd_vel, collision"]
- [{rest: operator}, "unknown key 'rest'.*reset"]
- [{reset: hand}, reset must be]
- [{robot_entity: jackal}, "robot_entity needs reset: simulation_interfaces"]
"""


@pytest.mark.parametrize("changes, message", yaml.safe_load(WRONG))
def test_a_wrong_file_is_refused_in_one_line(tmp_path, changes, message):
    with refused(message):
        read_system(write(tmp_path, **changes))


def test_the_task_names_the_system_and_nothing_of_how_it_is_reached(tmp_path):
    file = read_system(write(tmp_path))
    assert isinstance(file, SystemFile)
    other = read_system(write(tmp_path, reset="operator", topics={}))
    assert file.system == other.system
    assert "odom:=/robot/odom" in list(file.remappings())
