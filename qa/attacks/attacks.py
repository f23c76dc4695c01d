"""Attacks on results: each tries to win unseen, to break a verdict or to see the answers.

    python qa/attacks/attacks.py --only 'folder/*'

A line for each attack says what it tries and by what it is seen or prevented. The exit
code is 1 if one succeeds unseen. `beat_the_bound.py` searches for more.
"""

import fnmatch
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import click

TESTS = Path(__file__).resolve().parents[2] / "barn_eval" / "test"
sys.path.insert(0, str(TESTS))

import inside  # noqa: E402
import outside  # noqa: E402, F401 (adds its attacks)
import records  # noqa: E402, F401
from forgery import edit_run, forge, won  # noqa: E402
from planners import Straight, run_inline  # noqa: E402
from report_work import rewrite_rows  # noqa: E402

import barn_eval as barn  # noqa: E402
from barn_eval.analysis.leaderboard import make_boards  # noqa: E402
from barn_eval.results.commands import parse_commands_line  # noqa: E402
from barn_eval.results.tracks import pack_arrays  # noqa: E402
from barn_eval.ros.isolation import probe_isolation  # noqa: E402
from barn_eval.ros.supervision.process import SupervisedProcess  # noqa: E402
from barn_eval.trials.protocol import CHALLENGE  # noqa: E402
from barn_planners.gap.planner import ENTRY  # noqa: E402

SCRATCH = Path(tempfile.mkdtemp(prefix="barn-attacks-"))
ROOM = Path(__file__).with_name("room.py")
LOST = "straight_w0120_r00"  # which drives blindly at its goal and hits a post
OTHER = "other_w0120_r00"

ATTACKS: dict[str, tuple[str, Callable[[], str]]] = {}


def add(name: str, tries: str, act: Callable[[], str]) -> None:
    """Add an attack that returns by what it was seen or prevented, "" if by nothing."""
    ATTACKS[name] = (tries, act)


@cache
def driven(*planners: str, **options: Any) -> Path:
    """Return a folder of trials in world 120, driven once."""
    other = ENTRY.build(ENTRY.presets["default"])
    kinds = {"straight": Straight, "other": other, "twin": other}
    choices = {name: kinds[name] for name in planners}
    out = SCRATCH / f"driven{len(list(SCRATCH.iterdir()))}"
    options = {"out": out, "worlds": "120", "seed": 5} | options
    worlds = options.pop("worlds")
    folder: Path = run_inline(worlds, choices, CHALLENGE, **options).folder
    return folder


def copy(folder: Path) -> Path:
    """Return a copy of a folder, to be forged."""
    number = len(list(SCRATCH.iterdir()))
    return Path(shutil.copytree(folder, SCRATCH / f"forged{number}" / "out"))


def forged(change: Callable[[Path], object], *planners: str, **options: Any) -> str:
    """Forge a copy of a folder and return what a check says of it."""
    folder = copy(driven(*(planners or ("straight",)), **options))
    try:
        change(folder)
        return inside.describe_check(folder)
    except barn.BarnError as error:
        return f"refused: {error}"


def blame_environment(folder: Path, *, erase: bool = False) -> None:
    """Make a collision the environment's, which is driven again."""
    forge(folder, outcome="environment_failed", fault="environment", detail="stalled")
    if erase:
        forge(folder, measures__driven_m=0.0, measures__mean_speed_mps=0.0)
        for name in inside.LINES:
            (folder / name).unlink()


def take_the_other_trial(folder: Path, nudge: float = 0.0) -> None:
    """Put row, track and commands of the other planner in place of one's own."""
    rows = {row["trial_id"]: row for row in rewrite_rows(folder, lambda rows: rows)}
    names = ("outcome", "detail", "fault", "scores", "measures", "recoveries")
    kept = {name: rows[OTHER][name] for name in names}
    rewrite_rows(folder, lambda rows: [row | kept for row in rows])
    inside.edit_lines(folder, partial(take_lines, nudge=nudge))


def take_lines(lines: inside.Lines, nudge: float) -> inside.Lines:
    """Return the winner's lines, and the same as the loser's, a little changed."""
    lines = [line for line in lines if line["trial_id"] == OTHER]
    copies = [line | {"trial_id": LOST} for line in lines]
    for line in copies:
        if "commands" in line:
            _, commands = parse_commands_line(json.dumps(line), "")
            line.update(pack_arrays({"commands": (commands + nudge).ravel()}))
    return copies + lines


def double_row(folder: Path) -> None:
    """Append a better row of the same trial."""
    path = folder / "results.jsonl"
    first = path.read_text()
    forge(folder, **won(barn.load(folder).trials[0], 18.0))
    path.write_text(first + path.read_text())


def in_run(*keys: str, value: object) -> Callable[[Path], None]:
    """Return what sets a key of run.json."""

    def change(folder: Path) -> None:
        with edit_run(folder) as content:
            part = content
            for key in keys[:-1]:
                part = part[int(key)] if isinstance(part, list) else part[key]
            part[keys[-1]] = value

    return change


def leave_out(folder: Path) -> None:
    """Leave the world out in which one's own planner failed."""
    in_run("experiment", "worlds", value="0")(folder)
    with edit_run(folder) as content:
        content["worlds"].pop("120")
    rewrite_rows(folder, lambda rows: [row for row in rows if row["world"] == 0])
    inside.edit_lines(
        folder, lambda lines: [line for line in lines if "_w0000_" in line["trial_id"]]
    )


def board_of_part() -> str:
    """Rank a folder that leaves a world out beside a whole one."""
    whole = driven("other", worlds="0,120")
    part = copy(driven("straight", worlds="0,120"))
    leave_out(part)
    problem = inside.describe_check(part)
    if problem:
        return problem
    notes = [note for board in make_boards([whole, part]) for note in board.notes]
    return next((note for note in notes if "other trials" in note), "")


def rank_twins() -> str:
    """Enter one planner twice, so that one of them leads or others lose a test."""
    folder = driven("other", "twin", worlds="0,120")
    (board,) = make_boards([folder])
    return next((note for note in board.notes if "equal commands" in note), "")


def shuffle() -> str:
    """Bring rows into another order, by which the verdict might change."""
    folder = driven("other", "straight", worlds="0,120")
    other = copy(folder)
    rewrite_rows(other, lambda rows: rows[::-1])
    verdicts = {barn.load(path).verdict() for path in (folder, other)}
    return f"the same verdict: {verdicts.pop()}" if len(verdicts) == 1 else ""


def in_room(deed: str) -> str:
    """Do a deed in a process that is kept apart; return what kept it from success."""
    if probe_isolation() != "apart":
        return f"not tried here: {probe_isolation()}"
    folder = SCRATCH / deed
    out = folder / "above" / "out"
    (out / "bags").mkdir(parents=True)
    (out / "bags" / "secret").write_text("true pose")
    log = folder / "log"
    words = [sys.executable, str(ROOM), deed, str(out), str(os.getpid())]
    process = SupervisedProcess(
        "planner", words, os.environ, log, kind=f"isolated:{out}"
    )
    process.wait(60.0)
    process.stop()
    text = log.read_text()
    has_moved = not (out / "bags" / "secret").exists()
    return "" if has_moved or "SUCCESS" in text else text.strip().splitlines()[-1]


for _name, _tries, _change in (
    (
        "environment",
        "A collision becomes the environment's failure, to be driven again.",
        blame_environment,
    ),
    (
        "environment-erased",
        "The same, and its track and commands are deleted.",
        partial(blame_environment, erase=True),
    ),
    ("double-row", "A better row of the same trial is appended.", double_row),
    (
        "limit",
        "The protocol in run.json gets more time.",
        in_run("experiment", "protocol", "limit_s", value=200.0),
    ),
    (
        "robot",
        "The robot in run.json gets faster.",
        in_run("experiment", "simulator", "drive", "max_speed_m_s", value=3.0),
    ),
    ("seed", "The seed in run.json is another.", in_run("experiment", "seed", value=6)),
    ("sessions", "run.json has no session.", in_run("sessions", value=[])),
    (
        "release",
        "run.json says that a later version computed it.",
        in_run("code_versions", "physics", value=99),
    ),
    (
        "link",
        "Rows are a link to a file elsewhere, to be changed after the check.",
        lambda folder: (
            (folder / "results.jsonl").replace(folder.parent / "rows")
            and (folder / "results.jsonl").symlink_to(folder.parent / "rows")
        ),
    ),
):
    add(f"folder/{_name}", _tries, partial(forged, _change))

for _name, _tries, _nudge in (
    ("others-trial", "Row, track and commands are another planner's.", 0.0),
    ("nudged-trial", "The same, and its commands are changed by 1e-9.", 1e-9),
):
    _take = partial(take_the_other_trial, nudge=_nudge)
    add(f"folder/{_name}", _tries, partial(forged, _take, "straight", "other"))
add("folder/part", "The world in which it failed is left out.", board_of_part)
add("verdict/twins", "One planner is entered under two names.", rank_twins)
add("verdict/order", "Rows come in another order.", shuffle)

for _name, _tries in {
    "list": "The planner lists the folder of results.",
    "move": "It moves the folders above the results.",
    "unmount": "It takes away what hides the results.",
    "unshare": "It does so in namespaces of its own.",
    "bind": "It mounts the file system a second time, without what hides them.",
    "root": "It goes around that by /proc/1 and open files.",
    "trace": "It stops or traces the supervisor.",
    "kernel": "It changes settings of the kernel, or freezes the suite.",
    "disk": "It reads the disk itself.",
    "overlay": "It lays an empty folder over the root.",
    "handle": "It opens folders by their numbers.",
    "memory": "It reads memory of other processes.",
    "descriptors": "It uses sockets that the suite has left open.",
}.items():
    add(f"room/{_name}", _tries, partial(in_room, _name))
for _name, (_tries, _act) in inside.ATTACKS.items():
    add(_name, _tries, partial(inside.try_in_folder, _act))


@click.command()
@click.option("--list", "is_list", is_flag=True, help="List the attacks and try none.")
@click.option("--only", multiple=True, metavar="GLOB", help="Such as 'room/*'.")
def main(is_list: bool, only: Sequence[str]) -> None:
    """Try attacks; exit code 1 if one succeeds unseen."""
    unseen = 0
    for name, (tries, act) in ATTACKS.items():
        if only and not any(fnmatch.fnmatch(name, pattern) for pattern in only):
            continue
        click.echo(f"{name}: {tries}")
        if is_list:
            continue
        sight = " ".join(act().replace(str(SCRATCH), "").split())
        unseen += not sight
        click.echo(f"    {sight[:200] or 'SUCCEEDS UNSEEN'}")
    shutil.rmtree(SCRATCH, ignore_errors=True)
    sys.exit(int(unseen > 0))


if __name__ == "__main__":
    main()
