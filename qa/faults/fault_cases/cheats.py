"""Planners over ROS that try to win by other means than driving."""

from pathlib import Path

from fault_cases.environment import shared_memory
from fault_cases.kit import Lab, add, case, cases_of, ending, hold
from fault_cases.meddling import FAMILY
from fault_cases.planners import FOREIGN, by_command, ros
from fault_cases.processes import driving

SCRIPT = Path(__file__).with_name("cheat_planner.py")
_DOMAIN = "76"


def cheating(lab: Lab, kind: str, *options: object, prefix: str = "") -> list[object]:
    """Return the words of a run of a planner that cheats."""
    return ros(
        lab, *by_command(SCRIPT, kind, lab.folder, lab.out, prefix=prefix), *options
    )


def _read_report(lab: Lab) -> str:
    path = lab.folder / "found"
    return "; ".join(path.read_text().splitlines()) if path.exists() else ""


def _run_cheat(lab: Lab, kind: str, outcome: str, words: str, report: str = "") -> str:
    """Run a trial of a planner that cheats and check its end and its report."""
    lab.barn(*cheating(lab, kind), code=None)
    row = lab.row()
    description = "; ".join(
        filter(None, (ending(row), row["remarks"], _read_report(lab)))
    )
    hold(row["outcome"] == outcome and words in description, description)
    hold(report in _read_report(lab), description)
    attempts = row["wall_clock"]["attempts"]
    hold(attempts == 1 and not row["scores"]["success"], description)
    return description


_CAUGHT = "The trial ends as interference, without a score, and names who did what."
_NOTHING = "Nothing comes of it: the trial runs to its timeout at the first attempt."
_CAUGHT_CASES = """
forged-scans | publishes /scan
    The planner publishes scans that show nothing.
outcome | publishes /outcome
    The planner publishes a success on /outcome.
step | called simulator/step
    The planner calls the simulator's step.
"""
for _name, _done, _words in cases_of(_CAUGHT_CASES):
    add(FAMILY, _name, _done, _CAUGHT, _run_cheat, _name, "interference", _words)
# Words of the row, and of what the planner reports.
_VAIN = """
evaluators-name | |
    The planner makes a node of the evaluator's name.
evaluators-clock | |
    The planner sets use_sim_time of the evaluator.
helper | 2 publishers on /cmd_vel: /cheat, /helper |
    Another process of the planner sends commands as well.
memory | | 0 of the suite's processes
    The planner looks for the suite's processes, to open their memory.
line | | sockets took it
    The planner asks for a reset by each socket that it has or finds by name.
writes | | Read-only file system; Read-only file system; No such file or directory; Device or resource busy
    The planner adds to the rows, makes a bag, removes run.json and renames the folder of results.
seed | | 0 files
    The planner reads the campaign's seed from the evaluator's file in the folder of results.
suite | | may write to them
    The planner looks whether it may write to the suite's packages.
forks | | 500 processes
    The planner starts 500 processes.
processor | | 6 processes
    The planner starts six endless loops.
"""
_ENDS = {
    "helper": "The row names both publishers.",
    "memory": "It sees none; the trial runs to its timeout.",
    "writes": "The kernel lets it do none of that; the trial runs to its timeout.",
    "seed": "It sees no file there; the trial runs to its timeout.",
    "suite": "It may, as any process of that user: [Fairness](fairness.md#left-to-the-organizer) says what helps.",
}
for _name, _done, *_found in cases_of(_VAIN):
    _must = _ENDS.get(_name, _NOTHING)
    add(FAMILY, _name, _done, _must, _run_cheat, _name, "timeout", *_found)
_GATE = ("--ros", "patience.gate_s=10")
_DETAIL = 4000


@case(FAMILY)
def huge_answer(lab: Lab) -> str:
    """The planner's ~/ready answers, with 4 MB of text, that it is not ready.

    The trial ends as planner_not_ready, with the beginning of the text; folder and row
    can be read.
    """
    lab.barn(*cheating(lab, "huge-answer", *_GATE), code=None)
    row = lab.row()
    is_short = len(row["detail"]) < _DETAIL
    hold(row["outcome"] == "planner_not_ready" and is_short, ending(row)[:_DETAIL])
    lab.barn("check", lab.out)
    return f"{ending(row)[:60]}, {len(row['detail'])} characters"


def _parameters(lab: Lab, kind: str, most: float) -> str:
    lab.barn(*cheating(lab, kind))
    (path,) = lab.out.rglob("*.parameters.json")
    size = path.stat().st_size
    row = lab.row()
    hold(row["outcome"] == "timeout" and size < most, f"{ending(row)}, {size} bytes")
    return f"{ending(row)}; {size} bytes are kept, trial {row['wall_clock']['duration_s']:.0f} s"


for _name, _done, _most in (
    (
        "huge-parameters",
        "The planner tells of 20,000 parameters with names of 1 kB, and values of 40 kB.",
        1e6,
    ),
    (
        "deaf-parameters",
        "The planner has 20 nodes whose parameter services never answer.",
        2e4,
    ),
):
    _must = "What is kept of that is bounded, and so is the time that it takes; the trial runs to its timeout."
    add(FAMILY, _name, _done, _must, _parameters, _name, _most)


@case(FAMILY)
def thinks(lab: Lab) -> str:
    """The planner computes for 0.3 s for each command, in lockstep, and declares
    nothing.

    The row tells the time, which reports and comparisons show beside the score.
    """
    lab.barn(*cheating(lab, "thinks"))
    row = lab.row()
    took_ms = row["wall_clock"]["compute_p50_ms"]
    hold(took_ms > 250.0, row["wall_clock"])
    return f"{ending(row)}; half of its commands took {took_ms:.0f} ms or more"


@case(FAMILY)
def remembers(lab: Lab) -> str:
    """The planner leaves a file in the first trial, to know in the second, of a process
    of its own, where it was.

    It can: [Fairness](fairness.md#left-to-the-organizer) says what helps.
    """
    each = ("--repetitions", 2, "--ros", "restart_planner=each_trial")
    lab.barn(*cheating(lab, "remembers", *each))
    hold(_read_report(lab) == "nothing is left; something is left", _read_report(lab))
    return f"{len(lab.rows())} trials; {_read_report(lab)}"


@case(FAMILY)
def edits_results_where_it_can(lab: Lab) -> str:
    """In a run with --ros isolate=false, the planner makes a success of the row of an
    earlier trial, checksum and all.

    `barn check` finds the row.
    """
    each = "--repetitions 2 --ros restart_planner=each_trial --ros isolate=false"
    lab.barn(*cheating(lab, "edits", *each.split(), "--workers", 1))
    hold(_read_report(lab) == "edited", _read_report(lab))
    ended = lab.barn("check", lab.out, code=1)
    hold("_r00: " in ended.text, ended.text)
    return ended.text.replace(str(lab.folder), "")[:160]


@case(FAMILY)
def fills_shared_memory(lab: Lab) -> str:
    """The planner fills the folder for shared memory, which has 4 MB in a mount
    namespace of the run's own.

    Nothing comes of it: the trial runs to its timeout.
    """
    lab.barn(*cheating(lab, "shared-memory"), prefix=shared_memory("4m"))
    hold("bytes" in _read_report(lab), _read_report(lab))
    return f"{ending(lab.row())}; {_read_report(lab)}"


@case(FAMILY)
def enters_another_domain(lab: Lab) -> str:
    """A planner publishes /odom on the domain of a run of another planner.

    The other run's trial ends as interference and names the guest:
    [Fairness](fairness.md#left-to-the-organizer) says what helps.
    """
    # Both last, so that the guest comes while the other planner drives.
    slow = ("--workers", 1, "--ros", "lockstep=false", "--ros", "real_time_factor=0.1")
    second = ros(
        lab,
        *by_command(SCRIPT, "enters", lab.folder, lab.folder / "second", _DOMAIN),
        *slow,
        command_s=200,
        limit_s=8.0,
    )
    second[second.index("--out") + 1] = lab.folder / "second"
    second_run = lab.start(*second)
    lab.until((lab.folder / "ready").exists, "the guest")
    victim = ros(
        lab,
        *by_command(FOREIGN, lab.folder / "starts", "dozes"),
        *slow,
        limit_s=60.0,
        bags="all",
    )
    run = lab.start(*victim, environment={"ROS_DOMAIN_ID": _DOMAIN})
    driving(lab, run)
    (lab.folder / "go").touch()
    lab.finish(run, None)
    (lab.folder / "over").touch()
    lab.finish(second_run, None)
    second_rows = lab.rows(lab.folder / "second")
    description = ending(lab.row())
    hold("/guest publishes /odom" in description, description)
    return f"{description}; of its own: {ending(second_rows[0])}"
