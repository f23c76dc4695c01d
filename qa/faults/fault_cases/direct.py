"""Planners that go wrong in mode direct, in the process of a worker."""

import resource
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from barn_eval.trials.result import unpack_delays
from fault_cases.kit import (
    Lab,
    add,
    case,
    cases_of,
    ending,
    expect_row,
    hold,
    repeatable,
)

FAMILY = "direct"
SHORT = (
    "schema_version: 1\nbase: challenge\nname: short\n"
    "limit_s: 4.0\nfirst_motion_limit_s: 2.0\ntimeout_time_s: 4.0\n"
)


def with_rogue(lab: Lab) -> dict[str, str]:
    """Install the planners `rogue` and `broken` and return their environment."""
    installed = lab.folder / "installed" / "rogue-1.0.dist-info"
    installed.mkdir(parents=True)
    (installed / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: rogue\nVersion: 1.0\n"
    )
    points = "[barn_planners.planners]\nrogue = fault_cases.rogues:ENTRY\nbroken = broken:ENTRY\n"
    (installed / "entry_points.txt").write_text(points)
    (installed.parent / "broken.py").write_text("import a_package_that_is_not_there\n")
    (lab.folder / "short.yaml").write_text(SHORT)
    path = (
        str(Path(__file__).resolve().parents[1]),
        str(installed.parent),
        lab.environment.get("PYTHONPATH", ""),
    )
    return {"PYTHONPATH": ":".join(filter(None, path))}


def drive(
    lab: Lab,
    kind: str,
    outcome: str,
    detail: str = "",
    extra: Sequence[object] = (),
    memory: int = 0,
) -> str:
    """Run a trial of a rogue, and say how it ended; Wrong if otherwise than it must."""
    words = "run --planner rogue --protocol short.yaml --worlds 0 --bags none"
    options = ["--set", f"kind={kind}", "--out", lab.out, *extra]
    limit = partial(resource.setrlimit, resource.RLIMIT_AS, (memory, memory))
    before = limit if memory else None
    lab.barn(*words.split(), *options, environment=with_rogue(lab), before=before)
    return ending(expect_row(lab, outcome, detail))


_QUICK = ("--execution", "attempts=1", "--execution", "trial_limit_s=8")
_DIED = "The trial ends as planner_died with the reason in one line; exit code 3."
_STALLED = "The trial ends as planner_stalled after the limit on a trial's time; no process is left."
_LOST = "The worker is lost, the trial is tried 3 times and then ends as planner_died."
_INVALID = "invalid_command."
_ENDS = {
    "died": ("planner_died", _DIED, ()),
    "invalid": ("invalid_command", _INVALID, ()),
    "lost": ("planner_died", _LOST, ()),
    "stalled": ("planner_stalled", _STALLED, _QUICK),
}
_KINDS = """
raises | died | RuntimeError: out of
    The planner raises an exception of two lines.
raises-at-start | died | OSError: no such map
    The planner raises when it gets its goal.
no-decision | died | must return a Decision
    The planner returns a text instead of a decision.
wrong-type | died | must be a Velocity2D
    The planner's command is a pair of numbers.
recursion | died | RecursionError
    The planner recurses without end.
nan | invalid | nan m/s
    The planner commands NaN.
inf | invalid | inf rad/s
    The planner commands a turn at infinite speed.
system-exit | lost | at the last of 3 attempts
    The planner calls sys.exit.
keyboard-interrupt | lost | 3 attempts
    The planner raises KeyboardInterrupt.
os-exit | lost | exit code 7
    The planner ends its process by os._exit.
segfault | lost | SIGSEGV
    The planner reads address 0.
kills-itself | lost | SIGKILL
    The planner sends itself SIGKILL.
closes-files | lost |
    The planner closes all file descriptors of its process.
endless-loop | stalled |
    The planner loops without end.
catches-everything | stalled |
    The planner sleeps and catches BaseException.
hangs-in-c | stalled |
    The planner hangs in C with the interpreter's lock.
ignores-signals | stalled |
    The planner ignores SIGTERM and sleeps.
"""
for _kind, _done, _end, _detail in cases_of(_KINDS):
    _outcome, _must, _options = _ENDS[_end]
    add(FAMILY, _kind, _done, _must, drive, _kind, _outcome, _detail, _options)


@case(FAMILY)
def works(lab: Lab) -> str:
    """The planner computes for 30 ms and sleeps for 30 ms a cycle, alone and beside two busy loops.

    What is charged and what is called too slow agree within 10%, with and without load.
    """
    environment = with_rogue(lab)
    cycles_ms: list[float] = []
    for loops in (0, 2):
        loop = (sys.executable, "-c", "while True: pass")
        busy = [lab.start_program(loop) for _ in range(loops)]
        for option in ("", " --execution compute=measured"):
            out = lab.folder / str(len(cycles_ms))
            words = f"run --planner rogue --protocol short.yaml --worlds 0 --out {out}"
            words = f"{words} --set kind=works{option}"
            lab.barn(*words.split(), environment=environment)
            (row,) = lab.rows(out)
            cycle_ms = 50.0 * (row["wall_clock"]["computer"] or 0.0)
            if option:
                delays_ns = unpack_delays(row["delays"])
                cycle_ms = 1e-6 * float(np.percentile(delays_ns, 95.0))
            cycles_ms.append(cycle_ms)
        for process in busy:
            process.kill()
            process.wait()
    hold(max(cycles_ms) < 1.1 * min(cycles_ms), cycles_ms)
    return ", ".join(f"{cycle_ms:.1f} ms" for cycle_ms in cycles_ms)


@case(FAMILY)
def eats_memory(lab: Lab) -> str:
    """The planner takes memory without end; the process may have 4 GB.

    The trial ends as planner_died with MemoryError; exit code 3.
    """
    return drive(lab, "memory", "planner_died", "MemoryError", memory=4_000_000_000)


@case(FAMILY)
def commands_huge_speeds(lab: Lab) -> str:
    """The planner commands 1e300 m/s, once.

    It is a command, and the robot's limits hold: the trial goes on, and the robot is
    nowhere faster than 2 m/s.
    """
    description = drive(lab, "huge", "timeout")
    measures = lab.row()["measures"]
    hold(measures["driven_m"] < 8.0, measures)
    return f"{description}, {measures['driven_m']:.1f} m driven"


@case(FAMILY)
def changes_the_working_directory(lab: Lab) -> str:
    """The planner changes the working directory of its process to /, in the first of
    two trials with bags.

    Rows, bags and tables are in the folder asked for.
    """
    environment = with_rogue(lab)
    words = "run --planner rogue --set kind=working-directory --protocol short.yaml"
    options = "--worlds 0,9 --bags all --out out"
    lab.barn(*words.split(), *options.split(), environment=environment)
    bags = sorted(path.name for path in (lab.out / "bags").iterdir())
    hold(len(bags) == len(lab.rows()) == 2, bags)
    return "2 rows and 2 bags in the folder"


@case(FAMILY)
def changes_the_global_random_state(lab: Lab) -> str:
    """A planner seeds and sets the global random states; another planner drives in the
    same worker after it.

    The other planner's rows are those of a run without it, to the byte.
    """
    environment = with_rogue(lab)
    shared = "campaign --protocol short.yaml --worlds 0,9 --repetitions 1 --workers 1"
    for planners, out in (
        ("rogue,gap --set rogue.kind=random-state", lab.out),
        ("gap", lab.folder / "alone"),
    ):
        words = f"{shared} --planners {planners} --out".split()
        lab.barn(*words, out, environment=environment)
    both = [row for row in lab.rows() if row["planner"] == "gap"]
    alone = lab.rows(lab.folder / "alone")
    hold(repeatable(both) == repeatable(alone), "the rows differ")
    return "2 rows equal"


@case(FAMILY)
def cannot_be_imported(lab: Lab) -> str:
    """The planner's module imports a package that is not there.

    Refused in one line that names planner, module and package, before any folder is
    made.
    """
    words = "run --planner broken --worlds 0 --out out"
    refusal = lab.expect_refusal(*words.split(), environment=with_rogue(lab))
    hold("'broken'" in refusal and "a_package_that_is_not_there" in refusal, refusal)
    hold(not lab.out.exists(), refusal)
    return refusal


def gap_run(lab: Lab) -> list[object]:
    """Return the words of a short run of a planner that does nothing wrong."""
    (lab.folder / "short.yaml").write_text(SHORT)
    words = "run --planner gap --worlds 0 --protocol short.yaml --out"
    return [*words.split(), lab.out]
