"""Processes of a run over ROS that are killed, stopped or suspended.

Runs beside each other are here, too.
"""

import signal
import subprocess
import threading
import time
from collections.abc import Callable
from functools import cache
from typing import Any

from fault_cases.kit import (
    Lab,
    Row,
    add,
    add_all,
    case,
    ending,
    hold,
    repeatable,
    scratch,
)
from fault_cases.planners import FOREIGN, SCRIPT, by_command, ros
from fault_cases.system import any_lives, kill, send

FAMILY = "processes"
SIMULATOR = "barn_sim.ros.simulator"
EVALUATOR = "barn_eval.ros.evaluator"
_LIMIT_S = 6.0
_HELD = threading.Lock()


def words(lab: Lab) -> list[object]:
    """Return the words of a run whose planner does nothing wrong."""
    return ros(
        lab, *by_command(FOREIGN, "starts", "drives"), limit_s=_LIMIT_S, bags="all"
    )


@cache
def _drive_undisturbed() -> list[Row]:
    lab = Lab(scratch())
    lab.barn(*words(lab))
    return repeatable(lab.rows())


def run_undisturbed() -> list[Row]:
    """Return the rows of the same run without any disturbance."""
    with _HELD:
        return _drive_undisturbed()


def driving(lab: Lab, run: "subprocess.Popen[bytes]") -> None:
    """Wait until the robot is on its way."""

    def on_its_way() -> bool:
        hold(run.poll() is None, f"the run ended with {run.returncode}")
        return any(
            path.stat().st_size > 10_000
            for path in (lab.out / "bags").glob("*.partial/*.mcap")
        )

    lab.until(on_its_way, "the robot to drive")


def start_driving(lab: Lab, **how: Any) -> "subprocess.Popen[bytes]":
    """Start the run and wait until its robot is on its way."""
    run_undisturbed()
    run = lab.start(*words(lab), **how)
    driving(lab, run)
    return run


def same(lab: Lab, lost: int = 0) -> str:
    """Wrong if the rows are not the undisturbed ones, but for some lost commands."""
    rows = repeatable(lab.rows())
    for row in rows:
        measures = row["measures"]
        measures["unanswered_cycles"] = max(0, measures["unanswered_cycles"] - lost)
    hold(rows == run_undisturbed(), [ending(row) for row in rows])
    return f"{ending(lab.row())}; row as undisturbed"


def _expect_repetition(
    lab: Lab, disturb: Callable[[Lab], object], words_noted: str
) -> str:
    run = start_driving(lab)
    disturb(lab)
    ended = lab.finish(run)
    hold(words_noted in ended.text, ended.text[-600:])
    wall_clock = lab.row()["wall_clock"]
    hold(wall_clock["attempts"] == 2, wall_clock)
    return same(lab)


def _suspend(lab: Lab, pids: list[int], seconds: float) -> None:
    kill(pids, signal.SIGSTOP)
    time.sleep(min(seconds, lab.left_s))
    kill(pids, signal.SIGCONT)


_MUST = "The trial is repeated and said to be; but for its attempts the row equals that of an undisturbed run."
_DEEDS = (
    (
        "simulator-killed",
        "The simulator gets SIGKILL.",
        lambda lab: kill(lab.nodes(SIMULATOR)),
        "simulator_died",
    ),
    (
        "simulator-terminated",
        "The simulator gets SIGTERM.",
        lambda lab: kill(lab.nodes(SIMULATOR), 15),
        "simulator_died",
    ),
    (
        "simulator-wedged",
        "The simulator gets SIGSTOP, for ever.",
        lambda lab: kill(lab.nodes(SIMULATOR), 19),
        "no tick",
    ),
    (
        "evaluator-killed",
        "The evaluator gets SIGKILL.",
        lambda lab: kill(lab.nodes(EVALUATOR)),
        "evaluator was killed",
    ),
    (
        "guard-killed",
        "The guards of the planner get SIGKILL.",
        lambda lab: kill(lab.launchers(str(FOREIGN))),
        "lost with its launcher",
    ),
    (
        "guard-terminated",
        "The guards of the planner get SIGTERM.",
        lambda lab: kill(lab.launchers(str(FOREIGN)), 15),
        "lost with its launcher",
    ),
    (
        "simulators-guard-killed",
        "The guards of the simulator get SIGKILL.",
        lambda lab: kill(lab.launchers(SIMULATOR)),
        "",
    ),
    (
        "worker-killed",
        "The worker that supervises the nodes gets SIGKILL.",
        lambda lab: kill(lab.nodes("running.worker")),
        "",
    ),
)
add_all(FAMILY, _MUST, _expect_repetition, _DEEDS)


@case(FAMILY)
def evaluator_suspended(lab: Lab) -> str:
    """The evaluator is suspended for 12 s.

    It is waited for; the row is the undisturbed one, of the first attempt.
    """
    run = start_driving(lab)
    _suspend(lab, lab.nodes(EVALUATOR), 12.0)
    lab.finish(run)
    wall_clock = lab.row()["wall_clock"]
    hold(wall_clock["attempts"] == 1, wall_clock)
    return same(lab)


@case(FAMILY)
def machine_suspended(lab: Lab) -> str:
    """All processes of the run are suspended for 25 s in the middle of the trial, as a
    laptop's lid does.

    The trial ends as an undisturbed one does, repeated or not; one command may be lost.
    """
    run = start_driving(lab)
    _suspend(lab, lab.processes(), 25.0)
    lab.finish(run)
    return same(lab, lost=1)


def _stop(lab: Lab, number: int) -> str:
    run = start_driving(lab)
    began = time.monotonic()
    send(run.pid, number)
    ended = lab.finish(run, 130)
    hold("the same command resumes" in ended.text, ended.text)
    lab.wait_for_end()
    took = time.monotonic() - began
    lab.barn(*words(lab))
    return f"ended within {took:.0f} s; resumed: {same(lab)}"


for _number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
    add(
        FAMILY,
        _number.name.lower(),
        f"The run gets {_number.name} in the middle of the trial, and is then run again.",
        "It ends with code 130 and says how to resume; nothing is left; the row after that is the undisturbed one.",
        _stop,
        _number,
    )


@case(FAMILY)
def run_killed(lab: Lab) -> str:
    """The run gets SIGKILL in the middle of the trial, and is then run again.

    No process is left; the row after that is the undisturbed one.
    """
    run = start_driving(lab)
    kill([run.pid])
    lab.wait_for_end()
    lab.barn(*words(lab))
    return same(lab)


def _kill_together(lab: Lab, guards: int) -> str:
    """Kill run and worker at once, and some guards of a planner with daemons.

    `guards` says how many of the two.
    """
    planner = by_command(SCRIPT, "escapes", lab.folder)
    run = lab.start(*ros(lab, *planner, limit_s=60.0))
    note = lab.folder / "pids"
    lab.until(
        lambda: note.exists() and note.read_text().endswith("\n"),
        "the planner's daemon",
    )
    guarding = lab.launchers(str(SCRIPT))
    hold(len(guarding) >= guards, f"guards {guarding}")
    kill([run.pid, *lab.nodes("running.worker"), *sorted(guarding)[:guards]])
    run.wait()
    lab.until(lambda: not any_lives(note.read_text()), "the end of the daemon")
    lab.wait_for_end()
    return "nothing is left"


add(
    FAMILY,
    "supervisors-killed",
    "Run and worker get SIGKILL at once, while the planner has a daemon with an empty environment.",
    "Nothing is left, neither the nodes nor the daemon.",
    _kill_together,
    0,
)
add(
    FAMILY,
    "supervisors-and-guard-killed",
    "Run, worker and the planner's guard get SIGKILL at once, while the planner has such a daemon.",
    "Nothing is left, neither the nodes nor the daemon.",
    _kill_together,
    1,
)
