"""Planners of other people that go wrong over ROS, each in a process of its own."""

import shlex
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from barn_worlds.base.errors import ExitCode
from fault_cases.kit import (
    TESTS,
    Ended,
    Lab,
    Skipped,
    add,
    case,
    cases_of,
    ending,
    expect_row,
    hold,
)
from fault_cases.system import any_lives

FAMILY = "ros"
SCRIPT = Path(__file__).with_name("ros_planner.py")
FOREIGN = TESTS / "foreign_planner.py"
_PROTOCOL = (
    "schema_version: 1\nbase: challenge\nname: short\n"
    "first_motion_limit_s: {s}\nlimit_s: {s}\ntimeout_time_s: {s}\n"
)
# Short where a case waits for it in full, and yet long enough for a slow and busy
# machine.
_PATIENCE = ("command_wait_s=2", "patience.service_s=30", "patience.clock_s=20")


def ros(
    lab: Lab,
    *options: object,
    limit_s: float = 2.0,
    bags: str = "none",
    command_s: int = 12,
) -> list[object]:
    """Return the words of a run over ROS whose trial ends after some seconds."""
    if find_spec("rclpy") is None:
        raise Skipped("ROS 2 is not installed")
    (lab.folder / "short.yaml").write_text(_PROTOCOL.format(s=limit_s))
    settings = (*_PATIENCE, f"patience.command_s={command_s}")
    patience = [word for setting in settings for word in ("--ros", setting)]
    words = "run --mode ros --worlds 0 --protocol short.yaml --bags"
    return [*words.split(), bags, *patience, "--out", lab.out, *options]


def by_command(*words: object, prefix: str = "") -> list[str]:
    """Return the options for a planner that is started by a Python script."""
    command = shlex.join([sys.executable, *map(str, words)])
    return ["--planner-command", f"x={prefix}{command}"]


def drive(
    lab: Lab, kind: str, outcome: str, detail: str = "", options: Sequence[object] = ()
) -> str:
    """Run a trial of a planner that goes wrong, and say how it ended.

    Raises:
        Wrong: If otherwise than it must.
    """
    planner = by_command(SCRIPT, kind, lab.folder)
    return _drive(lab, [*planner, *options], outcome, detail)


def faulty(lab: Lab, kind: str, outcome: str, detail: str = "") -> str:
    """Do the same with the planner of the tests."""
    planner = by_command(FOREIGN, lab.folder / "starts", kind)
    return _drive(lab, planner, outcome, detail)


def _drive(lab: Lab, options: Sequence[object], outcome: str, detail: str) -> str:
    # Simulated time runs on while a planner is silent.
    limit_s = 2.0 if outcome == "timeout" else 60.0
    lab.barn(*ros(lab, *options, limit_s=limit_s))
    return judge(lab, outcome, detail)


def judge(lab: Lab, outcome: str, detail: str) -> str:
    """Say how the only trial ended; Wrong if otherwise than it must."""
    row = expect_row(lab, outcome, detail)
    remarks = f" ({row['remarks']})" if row["remarks"] else ""
    return ending(row) + remarks


def end_children(lab: Lab, outcome: str) -> str:
    """Wrong if a process that the planner noted lives on."""
    note = (lab.folder / "pids").read_text()
    lab.until(lambda: not any_lives(note), f"the end of {note.splitlines()}")
    count = len(note.splitlines())
    return f"{outcome}; {count} of {count} descendants ended"


def _ends(what: str) -> str:
    return f"The trial ends as {what}, by the planner's fault; nothing is left."


_ENDS = """
first-scan | planner_died | exited with code 1
    The planner exits with code 1 at the first scan.
crashes | planner_died | exited with code 1
    The planner raises in a callback in the middle of the trial.
segfault | planner_died | SIGSEGV
    The planner reads address 0 in the middle of the trial.
sleeps | planner_stalled | no command for 12 s
    The planner sleeps in a callback.
loops | planner_stalled | no command for 12 s
    The planner loops without end in a callback.
stops-itself | planner_stalled | no command for 12 s
    The planner sends itself SIGSTOP.
kills-its-group | planner_died | SIGKILL
    The planner sends SIGKILL to its process group.
shuts-down | planner_died |
    The planner shuts its DDS participant down.
inf | invalid_command | inf m/s
    The planner commands an infinite speed.
"""
for _kind, _done, _outcome, _detail in cases_of(_ENDS):
    add(FAMILY, _kind, _done, _ends(_outcome), drive, _kind, _outcome, _detail)
_FAULTS = """
wrong_type | wrong_message_type | String publisher exists
    The planner publishes std_msgs/String on /cmd_vel.
silent | no_first_motion | no command
    The planner never sends a command.
nan | invalid_command | nan m/s
    The planner commands NaN in the middle of the trial.
dies | planner_died | SIGKILL
    The planner sends itself SIGKILL in the middle of the trial.
exits | planner_died | exited with code 3
    The planner exits with code 3 in the middle of the trial.
"""
for _kind, _done, _outcome, _detail in cases_of(_FAULTS):
    _name = _kind.replace("_", "-")
    add(FAMILY, _name, _done, _ends(_outcome), faulty, _kind, _outcome, _detail)
_HARMLESS = """
ignores-signals
    The planner ignores SIGINT, SIGTERM, SIGHUP and SIGQUIT.
thousand-hertz
    The planner sends 1,000 commands a second.
stale
    The planner's commands are stamped 1 s.
future
    The planner's commands are stamped in the year 2033.
two-publishers
    The planner has two publishers on /cmd_vel.
"""
for _kind, _done in cases_of(_HARMLESS):
    _must = "The trial runs to its timeout; nothing is left."
    add(FAMILY, _kind, _done, _must, drive, _kind, "timeout")


def _run_with_limit(lab: Lab, kind: str) -> str:
    planner = by_command(SCRIPT, kind, lab.folder)
    lab.barn(*ros(lab, *planner))
    row = lab.row()
    driven_m = row["measures"]["driven_m"]
    duration_s = row["scores"]["duration_s"]
    hold(row["outcome"] in ("timeout", "collision"), ending(row))
    hold(0.5 < driven_m < 2.1 * duration_s, f"{driven_m} m in {duration_s} s")
    return f"{ending(row)}, {driven_m:.2f} m in {duration_s:.2f} s"


for _kind, _done in (
    ("too-fast", "The planner commands 200 m/s."),
    ("huge", "The planner commands 1e300 m/s."),
):
    _must = "The robot's limits hold: no more than 2 m/s."
    add(FAMILY, _kind, _done, _must, _run_with_limit, _kind)


def _expect_refusal(lab: Lab, kind: str, words: str) -> str:
    planner = by_command(SCRIPT, kind, lab.folder)
    refusal = lab.expect_refusal(*ros(lab, *planner), code=ExitCode.NOT_SCORED)
    hold(words in refusal, refusal)
    hold(not lab.rows(), "there is a row")
    return refusal.partition(";")[0]


_EARLY = """
import | a_package_that_is_not_there
    The planner's script imports a package that is not there.
start | no such parameter: speed
    The planner raises once it has begun with ROS.
exits-early | exited with code 0 at its start
    The planner exits with code 0 before it has a node.
"""
for _kind, _done, _words in cases_of(_EARLY):
    _must = "After three starts the run ends with one line that quotes the planner's log; exit code 3."
    add(FAMILY, _kind, _done, _must, _expect_refusal, _kind, _words)
_UNREADY = """
never-ready | /cmd_vel
    The planner sleeps before it has a node.
wrong-topic | /command_velocity
    The planner publishes on another topic.
no-odometry | /odom
    The planner does not subscribe to /odom.
"""
for _kind, _done, _detail in cases_of(_UNREADY):
    _must = "The trial ends as planner_not_ready, with what is missing; exit code 3."
    _options = ("--ros", "patience.start_s=40")
    _outcome = "planner_not_ready"
    add(FAMILY, _kind, _done, _must, drive, _kind, _outcome, _detail, _options)


@case(FAMILY)
def has_children(lab: Lab) -> str:
    """The planner starts three processes, each in a session of its own, and drives on.

    They end with the run.
    """
    return end_children(lab, drive(lab, "has-children", "timeout"))


@case(FAMILY)
def escapes(lab: Lab) -> str:
    """The planner starts a daemon: forked twice, in a session of its own, with an empty
    environment.

    The daemon ends with the run.
    """
    return end_children(lab, drive(lab, "escapes", "timeout"))


@case(FAMILY)
def prints_without_end(lab: Lab) -> str:
    """The planner prints 1 GB in the middle of the trial.

    Its log keeps 5 MB of the beginning and 5 MB of the end; the trial has a verdict.
    """
    planner = by_command(SCRIPT, "loud", lab.folder)
    ended: Ended = lab.barn(*ros(lab, *planner, command_s=120))
    size = sum(path.stat().st_size for path in (lab.out / "logs").rglob("planner.log*"))
    hold(5e6 < size < 10.5e6, f"{size} bytes of log")
    hold(len(ended.text) < 5000, "the log is printed")
    return f"{ending(lab.row())}; {size / 1e6:.1f} MB of log"


@case(FAMILY)
def eats_memory(lab: Lab) -> str:
    """The planner takes memory without end, of which it may have 2.5 GB.

    The trial ends as planner_died; exit code 3.
    """
    limited = by_command(SCRIPT, "eats", lab.folder, prefix="prlimit --as=2500000000 ")
    lab.barn(*ros(lab, *limited, command_s=60))
    return judge(lab, "planner_died", "")


@case(FAMILY)
def closes_its_files(lab: Lab) -> str:
    """The planner closes all its file descriptors, those of DDS among them.

    The trial ends with a verdict against the planner; nothing is left.
    """
    planner = by_command(SCRIPT, "closes-files", lab.folder)
    lab.barn(*ros(lab, *planner))
    hold(lab.row()["fault"] == "planner", lab.row())
    return ending(lab.row())


@case(FAMILY)
def does_not_exist(lab: Lab) -> str:
    """The planner's command names a program that is not there.

    Refused in one line that names it.
    """
    words = ros(lab, "--planner-command", "x=/no/such/planner --fast")
    refusal = lab.expect_refusal(*words, code=ExitCode.NOT_SCORED)
    hold("/no/such/planner: No such file" in refusal, refusal)
    return refusal
