"""Planners that go wrong in mode direct, in the process of a worker."""

import resource
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from fault_cases.kit import Lab, add, case, ending, expect_row, hold, repeatable

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
for _must, _outcome, _options, _kinds in (
    (
        _DIED,
        "planner_died",
        (),
        (
            (
                "raises",
                "The planner raises an exception of two lines.",
                "RuntimeError: out of",
            ),
            (
                "raises-at-start",
                "The planner raises when it gets its goal.",
                "OSError: no such map",
            ),
            (
                "no-decision",
                "The planner returns a text instead of a decision.",
                "must return a Decision",
            ),
            (
                "wrong-type",
                "The planner's command is a pair of numbers.",
                "must be a Velocity2D",
            ),
            ("recursion", "The planner recurses without end.", "RecursionError"),
        ),
    ),
    (
        _INVALID,
        "invalid_command",
        (),
        (
            ("nan", "The planner commands NaN.", "nan m/s"),
            ("inf", "The planner commands a turn at infinite speed.", "inf rad/s"),
        ),
    ),
    (
        _LOST,
        "planner_died",
        (),
        (
            ("system-exit", "The planner calls sys.exit.", "at the last of 3 attempts"),
            (
                "keyboard-interrupt",
                "The planner raises KeyboardInterrupt.",
                "3 attempts",
            ),
            ("os-exit", "The planner ends its process by os._exit.", "exit code 7"),
            ("segfault", "The planner reads address 0.", "SIGSEGV"),
            ("kills-itself", "The planner sends itself SIGKILL.", "SIGKILL"),
            (
                "closes-files",
                "The planner closes all file descriptors of its process.",
                "",
            ),
        ),
    ),
    (
        _STALLED,
        "planner_stalled",
        _QUICK,
        (
            ("endless-loop", "The planner loops without end.", ""),
            (
                "catches-everything",
                "The planner sleeps and catches BaseException.",
                "",
            ),
            (
                "hangs-in-c",
                "The planner hangs in C with the interpreter's lock.",
                "",
            ),
            ("ignores-signals", "The planner ignores SIGTERM and sleeps.", ""),
        ),
    ),
):
    for _kind, _done, _detail in _kinds:
        _act = partial(
            drive, kind=_kind, outcome=_outcome, detail=_detail, extra=_options
        )
        add(FAMILY, _kind, _done, _must, _act)


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
