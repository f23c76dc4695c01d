"""What fault cases are made of.

The cases by name, and the place in which each is tried with the real commands.
"""

import inspect
import json
import os
import re
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from processes import MARK, list_marked

from barn_eval.trials.result import UNDRIVEN_OUTCOMES
from barn_worlds.base.errors import ExitCode
from fault_cases.system import command_line, kill

T = TypeVar("T")
Row = dict[str, Any]

TESTS = Path(__file__).resolve().parents[3] / "barn_eval" / "test"
_LIMIT_S = 400.0  # of a case: many times what it takes, since the machine may be busy
_LEFT_S = 60.0  # for processes to end after a command that was killed
_MESSAGE = 4000  # characters of an error, with the end of a log in it


class Wrong(AssertionError):
    """What a case found that must not be."""


class Skipped(Exception):
    """A case that cannot be tried here, and why."""


@dataclass(frozen=True)
class Case:
    """A fault: what is done, what must happen, and the function that does it.

    The function gets a lab and the arguments, and returns what was measured.
    """

    family: str
    name: str
    done: str
    must: str
    act: Callable[..., str]
    arguments: tuple[object, ...] = ()

    @property
    def key(self) -> str:
        """Name among all cases."""
        return f"{self.family}/{self.name}"


CASES: dict[str, Case] = {}


def add(
    family: str,
    name: str,
    done: str,
    must: str,
    act: Callable[..., str],
    *arguments: object,
) -> None:
    """Add a case under an unused name."""
    case = Case(family, name, done, must, act, arguments)
    if case.key in CASES:
        raise ValueError(f"two cases are named {case.key}")
    CASES[case.key] = case


def add_all(
    family: str, must: str, act: Callable[..., str], rows: Iterable[Sequence[Any]]
) -> None:
    """Add a case for each row: its name, what is done, and the arguments of `act`."""
    for name, done, *arguments in rows:
        add(family, name, done, must, act, *arguments)


def case(family: str) -> "Callable[[Callable[[Lab], str]], Callable[[Lab], str]]":
    """Return a decorator that adds a function as a case.

    Its doc is what is done and, below, what must happen.
    """

    def add_function(act: Callable[[Lab], str]) -> Callable[[Lab], str]:
        done, _, must = (inspect.getdoc(act) or "").partition("\n\n")
        name = act.__name__.replace("_", "-")
        add(family, name, " ".join(done.split()), " ".join(must.split()), act)
        return act

    return add_function


def cases_of(text: str) -> Iterator[list[str]]:
    """Yield of each case its name, what is done (a line below), and further cells."""
    lines = text.strip().splitlines()
    for head, done in zip(lines[::2], lines[1::2], strict=True):
        name, *cells = map(str.strip, head.split("|"))
        yield [name, done.strip(), *cells]


def hold(condition: object, otherwise: object) -> None:
    """Raise Wrong unless a condition holds."""
    if not condition:
        raise Wrong(str(otherwise))


@dataclass(frozen=True)
class Ended:
    """A command that has ended."""

    code: int
    out: str
    err: str

    @property
    def text(self) -> str:
        """All that was printed, in one line."""
        return " ".join(f"{self.out} {self.err}".split())

    @property
    def error(self) -> str:
        """The error, on a line of its own; Wrong if there is not one such line."""
        lines = [line for line in self.err.splitlines() if line.startswith("error: ")]
        line_count = len(lines)
        hold(line_count == 1, f"{line_count} lines of errors: {self.err[-600:]}")
        length = len(lines[0])
        hold(length < _MESSAGE, f"an error of {length} characters")
        return lines[0].removeprefix("error: ")


class Lab:
    """The folder of a case and the processes that it starts there.

    The processes are recognized by a mark in their environment.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.out = folder / "out"
        self.mark = uuid.uuid4().hex
        self._deadline = time.monotonic() + _LIMIT_S
        self._commands = 0
        self.environment = os.environ | {MARK: self.mark}
        self.environment.pop("ROS_DOMAIN_ID", None)

    @property
    def left_s(self) -> float:
        """Time that is left; Wrong if none is."""
        left_s = self._deadline - time.monotonic()
        hold(left_s > 0.0, "took too long")
        return left_s

    def start(
        self,
        *arguments: object,
        prefix: Sequence[str] = (),
        environment: Mapping[str, str] | None = None,
        before: Callable[[], None] | None = None,
    ) -> "subprocess.Popen[bytes]":
        """Start `barn` in a session of its own, as a terminal does."""
        words = [*prefix, sys.executable, "-m", "barn_eval", *map(str, arguments)]
        return self.start_program(words, environment, before)

    def start_program(
        self,
        words: Sequence[str],
        environment: Mapping[str, str] | None = None,
        before: Callable[[], None] | None = None,
    ) -> "subprocess.Popen[bytes]":
        """Start any program in a session of its own."""
        self._commands += 1
        stem = self.folder / f"command_{self._commands}"
        with (
            stem.with_suffix(".out").open("wb") as out,
            stem.with_suffix(".err").open("wb") as err,
        ):
            process = subprocess.Popen(
                words,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                cwd=self.folder,
                env=self.environment | dict(environment or {}),
                start_new_session=True,
                preexec_fn=before,  # noqa: PLW1509
            )
        process.stem = stem  # type: ignore[attr-defined]
        return process

    def finish(self, process: "subprocess.Popen[bytes]", code: int | None = 0) -> Ended:
        """Wait for a command.

        Raises:
            Wrong: If it hangs, ends with another code, or shows a traceback.
        """
        try:
            process.wait(self.left_s)
        except subprocess.TimeoutExpired:
            raise Wrong("the command hangs") from None
        stem: Path = process.stem  # type: ignore[attr-defined]
        out, err = (
            stem.with_suffix(end).read_text("utf-8", "replace")
            for end in (".out", ".err")
        )
        ended = Ended(process.returncode, out, err)
        both = out + err
        traceback = re.search(r"^Traceback", both, re.MULTILINE)
        hold(not traceback, f"a traceback: {both[-1500:]}")
        failed = (
            code == 0
            and ended.code
            and all(row["outcome"] in UNDRIVEN_OUTCOMES for row in self.rows())
        )
        due = ExitCode.NOT_SCORED if failed else code
        hold(
            code is None or ended.code == due,
            f"exit code {ended.code}, not {due}: {ended.text[-800:]}",
        )
        return ended

    def barn(self, *arguments: object, code: int | None = 0, **how: Any) -> Ended:
        """Run `barn` to its end."""
        return self.finish(self.start(*arguments, **how), code)

    def expect_refusal(
        self, *arguments: object, code: int = ExitCode.REFUSED, **how: Any
    ) -> str:
        """Run `barn`, which must refuse in one line, and return that."""
        return self.barn(*arguments, code=code, **how).error

    def until(self, condition: Callable[[], T], what: str) -> T:
        """Wait for a condition and return its value."""
        while not (value := condition()):
            hold(time.monotonic() < self._deadline, f"timed out waiting for {what}")
            time.sleep(0.01)
        return value

    def rows(self, out: Path | None = None) -> list[Row]:
        """Return the whole rows of a folder in the order in which the trials ended."""
        path = (out or self.out) / "results.jsonl"
        lines = path.read_text().splitlines(keepends=True) if path.exists() else []
        return [json.loads(line) for line in lines if line.endswith("\n")]

    def row(self) -> Row:
        """Return the only row."""
        rows = self.rows()
        hold(len(rows) == 1, f"{len(rows)} rows, not one")
        return rows[0]

    def wait_for_two_rows(self, folder: Path) -> None:
        """Wait until a folder of results has two rows."""
        self.until(lambda: len(self.rows(folder)) >= 2, "two rows")

    def processes(self, text: str = "") -> list[int]:
        """Return the processes with the mark whose command line contains a text."""
        pids = [process.pid for process in list_marked(self.mark)]
        return [pid for pid in pids if text in command_line(pid)]

    def wait_for_end(self) -> None:
        """Wait for the end of all processes with the mark."""
        self.until(lambda: not self.processes(), "the end of all processes")

    def nodes(self, text: str) -> list[int]:
        """Return the processes of a node, not their launchers."""
        return [
            pid
            for pid in self.processes(text)
            if "launcher.py" not in command_line(pid)
        ]

    def launchers(self, text: str) -> list[int]:
        """Return the launchers of a node."""
        return [
            pid for pid in self.processes(text) if "launcher.py" in command_line(pid)
        ]

    def nothing_left(self) -> None:
        """Wrong if a process outlives the commands; it is ended."""
        end = time.monotonic() + _LEFT_S
        while (left := self.processes()) and time.monotonic() < end:
            time.sleep(0.05)
        lines = [command_line(pid)[:200] for pid in left]
        self.end_all()
        hold(not lines, f"processes are left: {lines}")

    def end_all(self) -> None:
        """End what is left."""
        while left := self.processes():
            kill(left)
            time.sleep(0.01)


def ending(row: Row) -> str:
    """Return in words how a trial ended."""
    return (
        f"{row['outcome']}: {row['detail']}" if row["detail"] else str(row["outcome"])
    )


def expect_row(lab: Lab, outcome: str, detail: str) -> Row:
    """Return the only row; Wrong if its trial ended otherwise than it must."""
    row = lab.row()
    as_expected = row["outcome"] == outcome and detail in row["detail"]
    hold(as_expected, f"{ending(row)}, not {outcome}: {detail}")
    fault = "" if outcome == "success" else "planner"
    hold(row["fault"] == fault, f"fault {row['fault']!r}")
    return row


def repeatable(rows: Sequence[Row]) -> list[Row]:
    """Return rows without what is the wall clock's, in the order of their trials."""
    return [
        {key: value for key, value in row.items() if key not in ("wall_clock", "crc32")}
        for row in sorted(rows, key=lambda row: str(row["trial_id"]))
    ]


def scratch() -> Path:
    """Return a new folder under the temporary one; the tool removes it."""
    return Path(tempfile.mkdtemp(prefix="barn-faults-"))
