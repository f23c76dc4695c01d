"""Kill processes of small campaigns at random moments and resume the campaigns.

The tables are compared with undisturbed ones.

    python qa/faults/kill_points.py --points 100 --seed 1 --json

Each point starts a campaign of four trials with two workers, every second one over ROS,
and kills (SIGKILL) one process of it: campaign, worker, and over ROS also a guard,
simulator, planner or evaluator. The same command is then repeated until it returns 0.
After each session no process may be left. In the end `barn check` must find nothing
wrong, and tables, tracks and, in mode direct, bags must be those of the undisturbed
campaign to the last byte. One difference is allowed: a planner that dies has failed,
whoever killed it, so a trial may say that its planner was killed by SIGKILL. Moment and
role are drawn from the seed; what the process was doing by then is not the same twice.
"""

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import click
from processes import (
    NEAR,
    Seen,
    campaign_command,
    environment,
    list_marked,
    wait_for_end,
)
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from barn_eval.results.rows import RowFile
from barn_eval.verification.check import check_folder
from barn_worlds.base.errors import BarnError

FILES = ("results.csv", "results.parquet", "tracks.jsonl")
ROLES = {
    "direct": ("campaign", "worker"),
    "ros": ("campaign", "worker", "guard", "simulator", "planner", "evaluator"),
}
# What is waited for in wall-clock time is waited for longer than usual: a busy machine
# is not what is looked at.
PATIENT = ("simulator", "gate", "service", "command", "clock", "vanished")
PATIENCE_S = 300
SESSIONS = 5  # most, until a campaign must be complete
LEFT_S = 60.0  # time that processes have to end after one of them was killed
SESSION_S = 600.0  # after which a session hangs
_SOONEST_S = 0.1


@dataclass(frozen=True)
class Point:
    """A kill and what came of it.

    at_s: from the start of the campaign. sessions: until it was complete, the one that
    was disturbed included. equal: to the last byte, or but for a trial whose planner
    was killed (planner_died). problems: all that must not be.
    """

    mode: str
    role: str
    at_s: float
    sessions: int = 0
    seconds: float = 0.0
    equal: bool = False
    planner_died: str = ""
    problems: tuple[str, ...] = ()


class Session:
    """One process of `barn campaign` in a folder, with all that it starts."""

    def __init__(self, folder: Path, mode: str) -> None:
        self._mark = folder.name
        protocol = folder.parent / "near.yaml"
        protocol.write_text(NEAR)
        command = campaign_command(
            worlds="0,100,200,299",
            planners="gap",
            protocol=protocol,
            mode=mode,
            seed=5,
            workers=2,
            bags="all",
            repetitions=1,
            out=folder / "out",
        )
        if mode == "ros":
            command += [f"--ros=patience.{name}_s={PATIENCE_S}" for name in PATIENT]
        with (folder / "printed.txt").open("a") as printed:
            self.process = subprocess.Popen(
                command,
                stdout=printed,
                stderr=printed,
                env=environment(self._mark, folder / "tmp"),
            )

    def kill(self, role: str, at_s: float) -> bool:
        """Kill a process of a role that lives at a moment, or the first one after it.

        False if there was none.
        """
        time.sleep(at_s)
        while self.process.poll() is None:
            for process in list_marked(self._mark):
                if process.role == role and self._kill_process(process):
                    return True
            time.sleep(0.05)
        return False

    def _kill_process(self, process: Seen) -> bool:
        try:
            handle = os.pidfd_open(process.pid)
        except ProcessLookupError:
            return False
        try:
            # the number may be another's by then
            if process not in list_marked(self._mark):
                return False
            signal.pidfd_send_signal(handle, signal.SIGKILL)
        finally:
            os.close(handle)
        return True

    def end(self) -> tuple[int | None, list[str]]:
        """Wait until nothing of it is left; return its exit code and what is wrong."""
        problems = []
        try:
            self.process.wait(SESSION_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            problems.append(f"no end within {SESSION_S:g} s")
        for process in wait_for_end(self._mark, LEFT_S):
            problems.append(f"{process.role} is left {LEFT_S:g} s after the end")
            os.kill(process.pid, signal.SIGKILL)
        return self.process.wait(), problems


def run_undisturbed(folder: Path, mode: str) -> float:
    """Run a campaign to its end and return how long it took.

    Raises:
        ClickException: If it fails.
    """
    folder.mkdir()
    began = time.monotonic()
    code, problems = Session(folder, mode).end()
    if code or problems:
        printed = (folder / "printed.txt").read_text()[-2000:]
        raise click.ClickException(f"undisturbed: {code} {problems} {printed}")
    return time.monotonic() - began


def try_point(point: Point, folder: Path, model: Path) -> Point:
    """Run a campaign with a kill, resume it and compare it with the undisturbed one."""
    folder.mkdir()
    began = time.monotonic()
    session = Session(folder, point.mode)
    hit = session.kill(point.role, point.at_s)
    code, problems = session.end()
    if not hit and point.at_s < _SOONEST_S:
        return replace(point, problems=(f"no {point.role} was seen",))
    # it was over sooner than the undisturbed one
    if not hit and code == 0 and not problems:
        sooner = replace(point, at_s=point.at_s / 2)
        return try_point(sooner, folder.with_name(f"{folder.name}s"), model)
    sessions = 1
    while code and not problems and sessions < SESSIONS:
        sessions += 1
        code, problems = Session(folder, point.mode).end()
    point = replace(
        point, sessions=sessions, seconds=round(time.monotonic() - began, 1)
    )
    if code or problems:
        printed = (folder / "printed.txt").read_text()[-1000:]
        return replace(point, problems=(*problems, f"exit code {code}: {printed}"))
    return compare_folders(point, folder / "out", model / "out")


def compare_folders(point: Point, out: Path, model: Path) -> Point:
    """Return the point with what is the matter with a complete campaign."""
    try:
        problems = check_folder(out).problems
        died = [
            result.trial_id
            for result in RowFile(out).read()
            if result.detail == "the planner was killed by SIGKILL"
        ]
    except BarnError as error:
        return replace(point, problems=(str(error),))
    if not died and commands(out) != commands(model):
        problems.append("commands.jsonl is not that of the undisturbed campaign")
    names = [*FILES, *bags(model)] if point.mode == "direct" else FILES
    unequal = [name for name in names if not same(out / name, model / name)]
    if point.role == "planner" and len(died) == 1 and set(unequal) == set(FILES):
        tables = [without(folder / "results.csv", died[0]) for folder in (out, model)]
        unequal = [] if tables[0] == tables[1] else ["results.csv"]
        point = replace(point, planner_died=died[0])
    problems += [f"{name} is not that of the undisturbed campaign" for name in unequal]
    return replace(point, equal=not unequal, problems=tuple(problems))


def same(path: Path, other: Path) -> bool:
    """Tell whether two files are there and hold the same."""
    return (
        path.is_file() and other.is_file() and path.read_bytes() == other.read_bytes()
    )


def commands(out: Path) -> dict[str, str]:
    """Return the last commands of each trial of a campaign, in the order of names."""
    lines = (out / "commands.jsonl").read_text("utf-8").splitlines()
    last = {json.loads(line)["trial_id"]: line for line in lines}
    return dict(sorted(last.items()))


def bags(out: Path) -> list[str]:
    """Return the files of the bags of a campaign."""
    return sorted(
        str(path.relative_to(out))
        for path in (out / "bags").rglob("*")
        if path.is_file()
    )


def without(table: Path, trial_id: str) -> list[str]:
    """Return the lines of a table without that of a trial."""
    return [
        line
        for line in table.read_text().splitlines()
        if not line.startswith(f"{trial_id},")
    ]


def draw_points(
    points: int, seed: int, modes: Sequence[str], durations_s: dict[str, float]
) -> list[Point]:
    """Return that many points, the modes in turn."""
    draw = random.Random(seed)
    kill_points = []
    for number in range(points):
        mode = modes[number % len(modes)]
        role = draw.choice(ROLES[mode])
        at_s = draw.uniform(0.0, durations_s[mode])
        kill_points.append(Point(mode, role, round(at_s, 3)))
    return kill_points


@click.command()
@click.option("--points", default=100, show_default=True, help="Number of kills.")
@click.option("--seed", default=1, show_default=True, help="Of moments and roles.")
@click.option(
    "--mode",
    "modes",
    multiple=True,
    type=click.Choice(list(ROLES)),
    help="Mode; both without one.",
)
@click.option(
    "--log",
    type=click.Path(path_type=Path, dir_okay=False),
    help="File for a line of JSON per point.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
def main(
    points: int, seed: int, modes: Sequence[str], log: Path | None, as_json: bool
) -> None:
    """Kill, resume and compare; exit code 1 if anything differs or is left behind."""
    console = Console(stderr=True)
    modes = list(dict.fromkeys(modes)) or list(ROLES)
    done: list[Point] = []
    with (
        tempfile.TemporaryDirectory(prefix="barn_kill_points_") as name,
        Progress(console=console) as progress,
    ):
        root = Path(name)
        task = progress.add_task("points", total=points)
        durations_s = {
            mode: run_undisturbed(root / f"{root.name}_{mode}", mode)
            for mode in modes[:points]
        }
        for number, point in enumerate(draw_points(points, seed, modes, durations_s)):
            folder = root / f"{root.name}_{number}"
            done.append(try_point(point, folder, root / f"{root.name}_{point.mode}"))
            progress.advance(task)
            if log:
                with log.open("a") as file:
                    line = json.dumps(asdict(done[-1]))
                    file.write(line + "\n")
            for problem in done[-1].problems:
                progress.console.print(
                    f"{point.mode} {point.role} at {point.at_s} s: {problem}",
                    markup=False,
                )
    good = all(result.equal and not result.problems for result in done)
    if as_json:
        points_as_json = [asdict(result) for result in done]
        click.echo(json.dumps({"good": good, "points": points_as_json}, indent=2))
    else:
        console.print(table(done))
    sys.exit(int(not good))


def table(points: Sequence[Point]) -> Table:
    """Return points by mode and role for a terminal."""
    printed = Table(
        "mode",
        "role killed",
        "points",
        "equal",
        "but for a killed planner",
        "most sessions",
        "longest [s]",
    )
    numbers = Counter((point.mode, point.role) for point in points)
    for (mode, role), number in sorted(numbers.items()):
        group = [point for point in points if (point.mode, point.role) == (mode, role)]
        died = sum(bool(point.planner_died) for point in group)
        sessions = max(point.sessions for point in group)
        longest_s = max(point.seconds for point in group)
        equal = sum(point.equal for point in group)
        printed.add_row(
            mode, role, *map(str, (number, equal, died, sessions, longest_s))
        )
    return printed


if __name__ == "__main__":
    main()
