"""Attacks from inside: answers, second tries, names and folders; see `attacks.py`."""

import json
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import Any
from unittest.mock import patch

from forgery import edit_run
from planners import Straight, run_inline
from report_work import change_row, rewrite_rows

import barn_eval as barn
from barn_eval.results.rows import RowFile, seal_line, unseal_line, write_tables
from barn_eval.results.run_file import RunFile
from barn_eval.trials.protocol import CHALLENGE
from barn_eval.trials.result import pack_delays, unpack_delays
from barn_eval.verification.submission import submit, verify
from barn_planners.interface import Decision, Observation, PlannerView, Task
from barn_sim.simulator import Simulator
from barn_worlds.base.types import Velocity2D
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.formats.dataset_file import write_dataset_file

ATTACKS: dict[str, tuple[str, Callable[[Path], str]]] = {}
Lines = list[dict[str, Any]]
LINES = ("tracks.jsonl", "commands.jsonl")
LOST = 40  # cycles after which a planner knows that it will lose
_SLOW_S = 0.02
_LEAST_MS = 10.0


def attack(name: str, tries: str) -> Callable[[Callable[[Path], str]], None]:
    """Add an attack that returns by what it was seen or prevented, "" if by nothing.

    It gets an empty folder.
    """

    def keep(act: Callable[[Path], str]) -> None:
        ATTACKS[name] = (tries, act)

    return keep


def try_in_folder(act: Callable[[Path], str]) -> str:
    """Try an attack in a folder that is deleted afterwards."""
    with tempfile.TemporaryDirectory(prefix="barn-attacks-") as name:
        folder = Path(name, "out")
        folder.mkdir()
        return act(folder).replace(name, "")


class Loser(Straight):  # type: ignore[misc]
    """Drives blindly at its goal, and does something before it hits a post."""

    def start(self, task: Task, seed: int) -> None:
        """Begin a trial."""
        super().start(task, seed)
        self.cycles = 0

    def step(self, observation: Observation) -> Decision:
        """Return the command of this cycle."""
        self.cycles += 1
        decision: Decision = super().step(observation)
        return self.escape(decision) if self.cycles == LOST else decision

    def escape(self, decision: Decision) -> Decision:
        """Return what saves it."""
        return decision


class Unreadable(Loser):
    """Gives an answer at which the suite's own code would fail."""

    def escape(self, decision: Decision) -> Decision:
        """Return a command that is no number."""
        return replace(decision, command=Velocity2D("half", 0.0))  # type: ignore[arg-type]


class Interrupting(Loser):
    """Ends the run as Ctrl-C does, in its first attempt."""

    attempts = 0

    def escape(self, decision: Decision) -> Decision:
        """Interrupt the run once."""
        Interrupting.attempts += 1
        if Interrupting.attempts == 1:
            raise KeyboardInterrupt
        return decision


class Refusing(Loser):
    """Ends the run, as a mistake of the user does, where its view is recorded."""

    attempts = 0

    def view(self) -> PlannerView:
        """Refuse once."""
        if self.cycles >= LOST:
            Refusing.attempts += 1
            if Refusing.attempts == 1:
                raise barn.BarnError("name another folder")
        view: PlannerView = super().view()
        return view


class Number(float):
    """A number that is computed when it is asked for."""

    def __float__(self) -> float:
        end_s = time.thread_time() + _SLOW_S
        while time.thread_time() < end_s:
            pass
        return 0.5


class Postponing(Loser):
    """Computes its command after its cycle, which nobody measures."""

    def step(self, observation: Observation) -> Decision:
        """Return a command that is not computed yet."""
        decision = super().step(observation)
        return replace(decision, command=Velocity2D(Number(), 0.0))


class Ghost(Loser):
    """Keeps the simulator, in whose process it is, from reporting contacts."""

    def escape(self, decision: Decision) -> Decision:
        """Change the simulator."""
        setattr(Simulator, "read_collision", lambda _: False)  # noqa: B010
        return decision


class Haunting(Ghost):
    """Does so in a thread."""

    def escape(self, decision: Decision) -> Decision:
        """Start the thread and wait for it."""
        thread = Thread(target=super().escape, args=(decision,))
        thread.start()
        thread.join()
        return decision


def drive(out: Path, planner: Any, worlds: str = "120", **options: Any) -> Path:
    """Drive a planner and return the folder."""
    choices = planner if isinstance(planner, str) else {"mine": planner}
    run_inline(worlds, choices, CHALLENGE, out=out, **{"seed": 5} | options)
    return out


def drive_twice(out: Path, planner: type[Loser], **options: Any) -> str:
    """Return what a row says of its attempts if the first one ended the run."""
    try:
        drive(out, planner, **options)
    except (KeyboardInterrupt, barn.BarnError):
        drive(out, planner, **options)
    attempts = barn.load(out).trials[0].wall_clock.attempts
    return f"attempt {attempts}" if attempts > 1 else ""


def describe_check(folder: Path) -> str:
    """Return the first line of what a check does not believe or cannot check."""
    write_tables(folder, RowFile(folder).read())
    check = barn.results.check(folder)
    lines = [*check.problems, *check.unchecked, *check.notes, ""]
    return lines[0].replace(str(folder), "")


def edit_lines(folder: Path, change: Callable[[Lines], Lines]) -> None:
    """Change tracks and commands of a folder."""
    for name in LINES:
        texts = (folder / name).read_text().splitlines()
        lines = change([json.loads(unseal_line(text, name)) for text in texts])
        texts = [f"{seal_line(json.dumps(line))}\n" for line in lines]
        (folder / name).write_text("".join(texts))


def rename_lines(folder: Path, old: str, new: str) -> None:
    """Give tracks and commands of one trial to another, in place of its own."""
    edit_lines(
        folder,
        lambda lines: [
            line | {"trial_id": new} for line in lines if line["trial_id"] == old
        ],
    )


@attack("answer/unreadable", "A planner that loses gives an answer that is no number.")
def _(out: Path) -> str:
    trial = barn.load(drive(out, Unreadable)).trials[0]
    return trial.detail if trial.fault == "planner" else ""


@attack("answer/postponed", "It computes when its command is read, after its cycle.")
def _(out: Path) -> str:
    trial = barn.load(drive(out, Postponing, compute="measured")).trials[0]
    charged_ms = trial.wall_clock.compute_p50_ms or 0.0
    return f"charged {charged_ms:.0f} ms a cycle" if charged_ms > _LEAST_MS else ""


@attack("again/interrupt", "A planner that loses interrupts the run, and drives again.")
def _(out: Path) -> str:
    return drive_twice(out, Interrupting)


@attack("again/refusal", "It ends the run as a user's mistake does, by its view.")
def _(out: Path) -> str:
    return drive_twice(out, Refusing, bags="all")


@attack("again/repetition", "The better repetition takes the place of the other.")
def _(out: Path) -> str:
    drive(out, Loser, repetitions=2)
    with edit_run(out) as content:
        content["experiment"]["repetitions"] = 1
    first, second = "mine_w0120_r00", "mine_w0120_r01"
    identity = {"trial_id": first, "repetition": 0}
    rewrite_rows(out, lambda rows: [rows[1] | identity])
    rename_lines(out, second, first)
    return describe_check(out)


@attack("name/planner", "A planner of one's own is submitted as DWA.")
def _(out: Path) -> str:
    drive(out, "gap")
    source = {"name": "DWA", "preset": "", "source": "0" * 64}
    with edit_run(out) as content:
        content["experiment"]["planners"] = [source]
    (spec,) = RunFile.read(out).run_config().trials()
    keys = ("trial_id", "planner", "preset", "planner_seed", "planner_config")
    identity = {key: getattr(spec, key) for key in keys}
    rewrite_rows(out, lambda rows: [rows[0] | identity])
    rename_lines(out, "gap_w0120_r00", spec.trial_id)
    try:
        submit(out, out.with_name("dwa.zip"))
    except barn.BarnError as error:
        return f"refused: {error}"
    check, _ = verify(out.with_name("dwa.zip"), out.with_name("unpacked"))
    return next(iter(check.problems), "")


@attack("name/worlds", "Easy worlds are called barn300, with numbers of hard ones.")
def _(out: Path) -> str:
    path = out / "barn300.npz"
    write_dataset_file(path, "barn300", {290: open_dataset("barn300").load(0)})
    row = barn.load(drive(out / "run", "gap", "290", dataset=str(path))).trials[0]
    return "" if row.dataset == "barn300" else f"called {row.dataset}"


def drive_ghost(out: Path, planner: type[Ghost]) -> str:
    """Drive a planner that changes the simulator; return what a check says of it."""
    with patch.object(Simulator, "read_collision", Simulator.read_collision):
        drive(out, planner)
    return describe_check(out)


@attack("process/ghost", "A planner in the simulator's process hides contacts.")
def _(out: Path) -> str:
    return drive_ghost(out, Ghost)


@attack("process/thread", "A thread that it has started does so.")
def _(out: Path) -> str:
    return drive_ghost(out, Haunting)


@attack("folder/delays", "Measured computing is said to have taken no time.")
def _(out: Path) -> str:
    drive(out, Postponing, compute="measured")
    count = len(unpack_delays(barn.load(out).trials[0].delays))
    change_row(out, delays=pack_delays([0] * count))
    return describe_check(out)


@attack("folder/older", "Rows claim an older version, which kept no commands.")
def _(out: Path) -> str:
    drive(out, Loser)
    row = change_row(out)
    change_row(out, schema_version=row["schema_version"] - 1)
    (out / "commands.jsonl").unlink()
    return describe_check(out)
