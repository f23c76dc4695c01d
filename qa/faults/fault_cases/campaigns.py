"""Campaigns in mode direct that are killed, suspended and disturbed.

Their tables must be the undisturbed ones after that.
"""

import signal
import sys
import threading
import time
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from shutil import which
from subprocess import Popen
from typing import Any

from fault_cases.kit import Lab, Skipped, add, case, hold, scratch
from fault_cases.system import kill, send, succeeds

FAMILY = "campaign"
TABLES = ("results.parquet", "results.csv", "tracks.jsonl")
TRIALS = 12
_PROTOCOL = "schema_version: 1\nbase: challenge\nname: short\nlimit_s: 8.0\nfirst_motion_limit_s: 3.0\n"
_CAMPAIGN = """schema_version: 1
dataset: barn300
worlds: "0,100,200"
planners: [gap]
repetitions: 4
protocol: {folder}/short.yaml
seed: 5
"""
_HELD = threading.Lock()


def campaign(lab: Lab, *options: object) -> list[object]:
    """Return the words of a campaign of 12 trials by two workers."""
    (lab.folder / "short.yaml").write_text(_PROTOCOL)
    file = lab.folder / "campaign.yaml"
    file.write_text(_CAMPAIGN.format(folder=lab.folder))
    workers = () if "--workers" in options else ("--workers", 2)
    return [
        "campaign",
        file,
        *(() if "--out" in options else ("--out", lab.out)),
        *workers,
        *options,
    ]


def expect_tables(out: Path) -> None:
    """Wrong if the tables of a campaign are not the undisturbed ones to the byte."""
    expected = run_undisturbed()
    for name in TABLES:
        equal = (out / name).read_bytes() == (expected / name).read_bytes()
        hold(equal, f"{name} differs from the undisturbed one")


@cache
def _drive_undisturbed() -> Path:
    lab = Lab(scratch())
    lab.barn(*campaign(lab, "--workers", 1))
    return lab.out


def run_undisturbed() -> Path:
    """Return the folder of the same campaign of one worker, without any disturbance."""
    with _HELD:
        return _drive_undisturbed()


def resume(lab: Lab, *options: object) -> str:
    """Run the campaign to its end.

    Raises:
        Wrong: If its tables are not the undisturbed ones to the byte.
    """
    row_count = len(lab.rows())
    lab.barn(*campaign(lab, *options))
    return same(lab, row_count)


def same(lab: Lab, row_count: int) -> str:
    """Wrong if the tables are not the undisturbed ones to the byte."""
    expect_tables(lab.out)
    total = len(lab.rows())
    hold(total == TRIALS, f"{total} rows")
    return (
        f"{row_count} rows kept; tables equal to the byte"
        if row_count
        else "tables equal to the byte"
    )


def start_two_rows(lab: Lab, *options: object, **how: Any) -> "Popen[bytes]":
    """Start the campaign and wait until it has two rows."""
    run_undisturbed()
    run = lab.start(*campaign(lab, *options), **how)
    lab.wait_for_two_rows(lab.out)
    return run


def _interrupt(lab: Lab, number: int) -> str:
    run = start_two_rows(lab)
    send(run.pid, number)
    if number == signal.SIGKILL:
        lab.finish(run, -number)
    else:
        ended = lab.finish(run, 130)
        hold("the same command resumes" in ended.text, ended.text)
    lab.wait_for_end()
    return resume(lab)


for _number in (
    signal.SIGKILL,
    signal.SIGINT,
    signal.SIGTERM,
    signal.SIGHUP,
    signal.SIGQUIT,
):
    signal_note = (
        ""
        if _number == signal.SIGKILL
        else "It ends with code 130 and says how to resume. "
    )
    add(
        FAMILY,
        _number.name.lower(),
        f"The campaign gets {_number.name} after two trials, and is then run again.",
        f"{signal_note}No worker is left; the tables are the undisturbed ones to the byte.",
        _interrupt,
        _number,
    )


def _disturb(
    lab: Lab, disturb: Callable[[Lab], object], words: str = "", *options: object
) -> str:
    run = start_two_rows(lab, *options)
    disturb(lab)
    ended = lab.finish(run)
    hold(words in ended.text, ended.text[-500:])
    return same(lab, 0)


def _suspend(lab: Lab, text: str = "", for_s: float = 8.0) -> None:
    pids = lab.processes(text)
    kill(pids, signal.SIGSTOP)
    time.sleep(for_s)
    kill(pids, signal.SIGCONT)


def _load_machine(lab: Lab) -> str:
    """Let a campaign compete with 30 busy processes for a minute at most.

    They have the campaign's own priority, which is a low one.
    """
    run_undisturbed()
    low = ["nice", "-n", "10"]
    loop = [*low, "timeout", "60", sys.executable, "-c", "while True: pass"]
    busy = [Popen(loop) for _ in range(30)]
    lab.finish(lab.start(*campaign(lab), prefix=low))
    for process in busy:
        process.terminate()
        process.wait()
    return same(lab, 0)


_MUST = "The tables are the undisturbed ones to the byte."


def _kill_workers(lab: Lab, count: int, number: int = signal.SIGKILL) -> None:
    kill(lab.processes("running.worker")[:count], number)


add(
    FAMILY,
    "worker-killed",
    "One of two workers gets SIGKILL.",
    f"Its trial is tried again, and the loss is told. {_MUST}",
    _disturb,
    partial(_kill_workers, count=1),
    "was killed by SIGKILL",
)
add(
    FAMILY,
    "all-workers-killed",
    "Both workers get SIGKILL.",
    f"Their trials are tried again. {_MUST}",
    _disturb,
    partial(_kill_workers, count=2),
    "was killed by SIGKILL",
)
add(
    FAMILY,
    "worker-stopped",
    "A worker gets SIGSTOP, for ever; trials may take 25 s.",
    f"It is given up after its time, and its trial is tried again. {_MUST}",
    _disturb,
    partial(_kill_workers, count=1, number=signal.SIGSTOP),
    "no result within 25 s",
    "--execution",
    "trial_limit_s=25",
)
add(
    FAMILY,
    "machine-suspended",
    "All processes of the campaign are suspended for 8 s.",
    f"It goes on. {_MUST}",
    _disturb,
    _suspend,
)
add(
    FAMILY,
    "workers-suspended",
    "Both workers are suspended for 40 s, longer than a planner may take for a cycle.",
    f"No planner is blamed. {_MUST}",
    _disturb,
    partial(_suspend, text="running.worker", for_s=40.0),
)
add(
    FAMILY,
    "group-suspended",
    "All processes of the campaign are suspended for 40 s, longer than a planner may take for a cycle.",
    f"No planner is blamed. {_MUST}",
    _disturb,
    partial(_suspend, for_s=40.0),
)
add(
    FAMILY,
    "machine-loaded",
    "30 busy processes of the campaign's own priority run beside it, for a minute at most.",
    f"No planner is blamed. {_MUST}",
    _load_machine,
)


def shifted_clock(lab: Lab, seconds: int) -> tuple[Path, dict[str, str]]:
    """Return a file with the clock's error and the environment that applies it."""
    library = lab.folder / "clock.so"
    note = lab.folder / "shift"
    source = Path(__file__).with_name("clock.c")
    words = ["cc", "-shared", "-fPIC", "-O1", f"-o{library}", str(source), "-ldl"]
    if which("cc") is None or not succeeds(words):
        raise Skipped("the clock cannot be shifted without a C compiler")
    note.write_text(str(seconds))
    return note, {"LD_PRELOAD": str(library), "BARN_CLOCK_SHIFT": str(note)}


def _jump(lab: Lab, days: int) -> str:
    """Let the clock of all processes of a campaign jump, and it alone."""
    note, false = shifted_clock(lab, 0)
    run = start_two_rows(lab, environment=false)
    note.write_text(str(days * 86_400))
    lab.finish(run)
    dates = {row["wall_clock"]["started_at"][:10] for row in lab.rows()}
    hold(len(dates) >= 2, f"the clock did not jump: {dates}")
    durations_s = [row["wall_clock"]["duration_s"] for row in lab.rows()]
    are_short = all(duration_s < 100.0 for duration_s in durations_s)
    hold(are_short, "durations are of the clock")
    return f"{same(lab, 0)}; from {min(dates)} to {max(dates)}"


for _name, _days in (("forward", 40), ("backward", -40)):
    add(
        FAMILY,
        f"clock-jumps-{_name}",
        f"The clock jumps {_name} by 40 days after two trials.",
        f"No trial is given up and no duration is wrong. {_MUST}",
        _jump,
        _days,
    )


@case(FAMILY)
def two_writers(lab: Lab) -> str:
    """The same campaign is started three times at once in one folder.

    One runs, the others are refused in one line each; the tables are the undisturbed
    ones to the byte.
    """
    run_undisturbed()
    runs = [lab.start(*campaign(lab)) for _ in range(3)]
    ended = [lab.finish(run, None) for run in runs]
    codes = sorted(session.code for session in ended)
    hold(codes == [0, 2, 2], codes)
    refusals = [session.error for session in ended if session.code]
    reason = "another process is working in this folder"
    hold(all(reason in refusal for refusal in refusals), refusals)
    return f"{same(lab, 0)}; {refusals[0]}"


@case(FAMILY)
def worker_of_another_number(lab: Lab) -> str:
    """The campaign is killed after two trials and resumed with five workers.

    The tables are the undisturbed ones to the byte.
    """
    run = start_two_rows(lab)
    kill([run.pid])
    lab.finish(run, -9)
    lab.wait_for_end()
    return resume(lab, "--workers", 5)


@case(FAMILY)
def output_closed(lab: Lab) -> str:
    """Whoever reads what the campaign prints goes away after the first line.

    The campaign completes its rows or ends without a traceback; after running it again
    the tables are the undisturbed ones.
    """
    run_undisturbed()
    (lab.folder / "run.sh").write_text('"$@" 2>&1 | head -1\n')
    words = ["sh", str(lab.folder / "run.sh")]
    lab.finish(lab.start(*campaign(lab), prefix=words), None)
    lab.wait_for_end()
    return resume(lab)
