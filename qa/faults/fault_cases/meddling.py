"""Planners that try to change their score."""

import signal
import time
from contextlib import suppress

from fault_cases.kit import Lab, add, cases_of, ending, hold
from fault_cases.planners import FOREIGN, SCRIPT, by_command, drive, judge, ros
from fault_cases.system import peak_memory_mb

FAMILY = "meddling"


def _expect_interference(lab: Lab, kind: str, words: str) -> str:
    planner = by_command(FOREIGN, lab.folder / "starts", kind)
    lab.barn(*ros(lab, *planner))
    description = judge(lab, "interference", words)
    scores = lab.row()["scores"]
    hold(not scores["success"] and scores["challenge"] == 0.0, scores)
    return description


def _expect_remark(lab: Lab, ground_truth: str, heard: bool) -> str:
    words = by_command(FOREIGN, lab.folder / "starts", "curious")
    lab.barn(*ros(lab, *words, "--ros", f"ground_truth={ground_truth}"))
    row = lab.row()
    hold("/foreign subscribed to /ground_truth/odom" in row["remarks"], row["remarks"])
    hold(
        (lab.folder / "starts.heard").exists() is heard,
        "heard" if not heard else "not heard",
    )
    return f"{ending(row)}; {row['remarks']}"


_MUST = "The trial ends as interference, without a score, and names who did what."
_MEDDLING = """
poses | publishes /odom
    The planner publishes poses at the goal on /odom and /ground_truth/odom.
older_stamps | publishes /clock
    The planner publishes /clock with time 0.
no_contact | publishes /collision
    The planner publishes on /collision that there is no contact.
score | publishes /score
    The planner publishes /score.
twin | named /simulator
    The planner's node has the simulator's name, and publishes /scan.
parameters | set start_y_m of simulator
    The planner sets the start pose of the simulator.
reset | called simulator/reset
    The planner calls the simulator's reset.
pause | called simulator/pause
    The planner calls the simulator's pause.
"""
for _kind, _done, _words in cases_of(_MEDDLING):
    _name = _kind.replace("_", "-")
    add(FAMILY, _name, _done, _MUST, _expect_interference, _kind, _words)

add(
    FAMILY,
    "reads-the-truth",
    "The planner subscribes to /ground_truth/odom.",
    "It hears nothing, and the row names it.",
    _expect_remark,
    "false",
    False,
)
add(
    FAMILY,
    "reads-the-truth-asked-for",
    "The planner subscribes to /ground_truth/odom in a run with --ros ground_truth=true.",
    "It hears the truth, and the row names it.",
    _expect_remark,
    "true",
    True,
)


def _break_bytes(lab: Lab) -> str:
    planner = by_command(FOREIGN, lab.folder / "starts", "broken_command")
    lab.barn(*ros(lab, *planner))
    return judge(lab, "invalid_command", "not finite")


add(
    FAMILY,
    "broken-bytes",
    "The planner publishes bytes on /cmd_vel that are no command.",
    "The trial ends as invalid_command, by the planner's fault.",
    _break_bytes,
)


def _send_signal(lab: Lab, what: str, number: int, isolate: bool, expected: str) -> str:
    words = by_command(SCRIPT, "signals", lab.folder, what, int(number))
    run = ros(lab, *words, "--ros", f"isolate={str(isolate).lower()}")
    killed = what == "run" and not isolate
    lab.barn(*run, code=-signal.SIGKILL if killed else None)
    if killed:
        lab.wait_for_end()
        lab.barn(*run, code=None)
    row = lab.row()
    attempts = row["wall_clock"]["attempts"]
    reasons = row["wall_clock"]["repeated"]
    description = f"{ending(row)}, attempt {attempts} {reasons}".strip()
    hold(
        (lab.folder / "done").exists() is not isolate,
        "the planner found the process" if isolate else "it found none",
    )
    fault = "planner" if expected != "repeated" else row["fault"]
    hold(row["fault"] == fault and not row["scores"]["success"], description)
    hold(
        (expected if expected != "repeated" else "timeout") in description, description
    )
    hold((attempts > 1) is (expected == "repeated"), description)
    return description


for _name in ("simulator", "evaluator", "guard", "worker", "run"):
    for _number in (signal.SIGKILL, signal.SIGSTOP, signal.SIGTERM):
        add(
            FAMILY,
            f"{_number.name.lower()}-for-the-{_name}",
            f"The planner looks for the {_name} of its run, to send it {_number.name}.",
            "It sees none of the suite's processes; the trial runs to its timeout at the first attempt.",
            _send_signal,
            _name,
            _number,
            True,
            "timeout",
        )
for _name, _number, _expected in (
    ("simulator", signal.SIGKILL, "may have caused it"),
    ("simulator", signal.SIGTERM, "may have caused it"),
    ("simulator", signal.SIGSTOP, "may have caused it"),
    ("evaluator", signal.SIGKILL, "interference: the evaluator was"),
    ("guard", signal.SIGKILL, "may have caused it"),
    ("worker", signal.SIGKILL, "repeated"),
    ("run", signal.SIGKILL, "repeated"),
):
    add(
        FAMILY,
        f"{_number.name.lower()}-for-the-{_name}-where-it-can",
        f"The planner sends {_number.name} to the {_name} of its run, once, in a run with --ros isolate=false.",
        "The row says that the trial was repeated, and why."
        if _expected == "repeated"
        else "The trial is not repeated and counts as the planner's failure.",
        _send_signal,
        _name,
        _number,
        False,
        _expected,
    )
add(
    FAMILY,
    "kills-its-parent",
    "The planner sends SIGKILL to its parent, the first process that it sees.",
    "The kernel drops it: the trial runs to its timeout.",
    drive,
    "kills-its-parent",
    "timeout",
)


def _expect_bounded_memory(lab: Lab, kind: str, outcome: str, words: str) -> str:
    planner = by_command(SCRIPT, kind, lab.folder)
    run = lab.start(*ros(lab, *planner, bags="all", limit_s=20.0))
    peak_mb = 0
    while run.poll() is None:
        for pid in lab.nodes("barn_eval.ros.evaluator"):
            with suppress(OSError, StopIteration):
                peak_mb = max(peak_mb, peak_memory_mb(pid))
        hold(lab.left_s, "")
        time.sleep(0.1)
    description = judge(lab, outcome, words)
    hold(peak_mb < 3000, f"the evaluator took {peak_mb} MB; {description}")
    duration_s = lab.row()["wall_clock"]["duration_s"]
    return f"{description}; evaluator at most {peak_mb} MB, trial {duration_s:.0f} s"


_CROWDS = """
crowd | interference | topics are on the graph
    The planner makes 5,000 topics in the midst of a trial.
meet | interference | nodes are on the graph
    The planner makes 400 nodes in the midst of a trial.
floods | collision |
    The planner publishes 4 MB at 50 Hz on a topic of its own, and answers.
floods-slowly | collision |
    The planner publishes 1 MB at 50 Hz on a topic of its own, and answers.
"""
_MUST = "The trial ends at once, and names that; or it goes on, and the evaluator's memory stays below 3 GB."
for _kind, _done, *_arguments in cases_of(_CROWDS):
    add(FAMILY, _kind, _done, _MUST, _expect_bounded_memory, _kind, *_arguments)
