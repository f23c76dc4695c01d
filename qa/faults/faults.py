"""Do to the suite what a campaign may meet and say what comes of it.

All cases use the real commands.

    python qa/faults/faults.py --only 'campaign/*'

Each case has a folder of its own, a time limit, and must leave no process behind. Exit
code 1 if one failed. What was measured is kept in OUT/faults.json, from which `--write
docs/reliability.md` renews the table; other rows stay.
"""

import fnmatch
import json
import re
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import click
from fault_cases import CASES, FAMILIES
from fault_cases.kit import Case, Lab, Skipped, Wrong
from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
)

BEGIN = "<!-- fault table -->"
END = "<!-- end of the fault table -->"
PASSED = "passed"
FAILED = "failed"
SKIPPED = "skipped"
UNTRIED = "not tried"
_MEASURED = 160  # characters of the table


@dataclass(frozen=True)
class Outcome:
    """How a case went.

    Passed, failed or skipped, what was measured or went wrong, and how long it took.
    """

    case: str
    status: str
    measured: str
    duration_s: float


def try_case(case: Case, failed_folder: Path, labs: list[Lab]) -> Outcome:
    """Try a case in a folder of its own, which is kept where it failed.

    `labs`: gets the place.
    """
    folder = Path(tempfile.mkdtemp(prefix="barn-fault-"))
    lab = Lab(folder, case.limit_s)
    labs.append(lab)
    began = time.monotonic()
    try:
        status = PASSED
        measured = case.act(lab)
        lab.nothing_left()
    except Skipped as reason:
        status = SKIPPED
        measured = str(reason)
    except Wrong as wrong:
        status = FAILED
        measured = str(wrong)
    except Exception as error:  # a case is not to end the others
        status = FAILED
        measured = f"{type(error).__name__}: {error}"
    duration_s = time.monotonic() - began
    lab.end_all()
    labs.remove(lab)
    if status == FAILED:
        place = failed_folder / case.key.replace("/", "-")
        shutil.rmtree(place, ignore_errors=True)
        with suppress(OSError, shutil.Error):
            shutil.copytree(
                folder, place, symlinks=True, ignore=lambda *_: ["pipe", "c.yaml"]
            )
    shutil.rmtree(folder, ignore_errors=True)
    text = " ".join(measured.replace(str(folder), "").split())
    return Outcome(case.key, status, text, round(duration_s, 1))


def select_cases(patterns: Sequence[str]) -> list[Case]:
    """Return the cases that match one of the patterns, all without any."""
    cases = [
        case
        for key, case in CASES.items()
        if not patterns or any(fnmatch.fnmatch(key, p) for p in patterns)
    ]
    return sorted(cases, key=lambda case: list(FAMILIES).index(case.family))


def read_outcomes(path: Path) -> dict[str, Outcome]:
    """Return what was measured earlier."""
    if not path.exists():
        return {}
    return {row["case"]: Outcome(**row) for row in json.loads(path.read_text())}


def table(rows: Mapping[str, str]) -> Iterator[str]:
    """Yield the lines of the table, family by family; rows: by case."""
    for family, title in FAMILIES.items():
        yield f"\n### {title}\n"
        yield "| case | what is done | what must happen | measured | s |"
        yield "| --- | --- | --- | --- | ---: |"
        yield from (rows[key] for key, case in CASES.items() if case.family == family)


def row(case: Case, outcome: Outcome) -> str:
    """Return the line of a case in the table."""
    measured = outcome.measured
    if len(measured) > _MEASURED:
        measured = measured[:_MEASURED] + " ..."
    word = "" if outcome.status == PASSED else f"**{outcome.status}** "
    seconds = f"{outcome.duration_s:.0f}" if outcome.status != UNTRIED else ""
    text = _cell(measured).replace("[", "\\[")  # no link
    return f"{_beginning(case)}{word}{text} | {seconds} |"


def _beginning(case: Case) -> str:
    return f"| `{case.key}` | {_cell(case.done)} | {_cell(case.must)} | "


def _rows(page: str, outcomes: Mapping[str, Outcome]) -> dict[str, str]:
    """Return the line of each case.

    As measured now, else that of the page if the case is still the same.
    """
    page_lines = page.splitlines()
    lines = {}
    for key, case in CASES.items():
        old_lines = [line for line in page_lines if line.startswith(_beginning(case))]
        untried = Outcome(key, UNTRIED, "", 0.0)
        fresh = row(case, outcomes.get(key, untried))
        lines[key] = old_lines[0] if old_lines and key not in outcomes else fresh
    return lines


def _cell(text: str) -> str:
    text = text.replace("&", "&amp;").replace("<", "&lt;")
    return re.sub(r"([|*_])", r"\\\1", text)


def _status(cell: str) -> str:
    """Return the status that the cell of a case states.

    It is left out where it passed.
    """
    for status in (FAILED, SKIPPED, UNTRIED):
        if f"**{status}**" in cell:
            return status
    return PASSED


def write(page: Path, outcomes: Mapping[str, Outcome]) -> None:
    """Replace the table of a page; ClickException where it has no place for it."""
    text = page.read_text("utf-8")
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise click.ClickException(f"{page}: must have the lines {BEGIN} and {END}")
    rows = _rows(text, outcomes)
    cells = [line.rsplit(" | ", 2)[1:] for line in rows.values()]
    words = Counter(_status(cell) for cell, _ in cells)
    durations_s = [float(seconds.strip("| ") or 0.0) for _, seconds in cells]
    took_min = sum(durations_s) / 60.0
    statuses = [word for word in (PASSED, FAILED, SKIPPED, UNTRIED) if words[word]]
    counts = ", ".join(f"{words[word]} {word}" for word in statuses)
    head = (
        f"{len(CASES)} cases: {counts}. Their times sum up to {took_min:.0f} minutes."
    )
    page.write_text(
        f"{before}{begin}\n{head}\n" + "\n".join(table(rows)) + f"\n\n{end}{after}",
        "utf-8",
    )


@click.command()
@click.option("--list", "listed", is_flag=True, help="List the cases and try none.")
@click.option(
    "--only", multiple=True, metavar="GLOB", help="Cases such as 'ros/*'; repeatable."
)
@click.option(
    "--resume", is_flag=True, help="Leave out what has passed already, as OUT says."
)
@click.option(
    "--jobs",
    default=2,
    show_default=True,
    type=click.IntRange(1, 64),
    help="Cases at a time.",
)
@click.option(
    "--json", "as_json", is_flag=True, help="Print what was measured as JSON."
)
@click.option(
    "--out",
    default="out/faults",
    show_default=True,
    type=click.Path(path_type=Path),
    help="Results.",
)
@click.option(
    "--write",
    "page",
    type=click.Path(path_type=Path, exists=True),
    help="Page whose table is renewed.",
)
def main(
    listed: bool,
    only: Sequence[str],
    resume: bool,
    jobs: int,
    as_json: bool,
    out: Path,
    page: Path | None,
) -> None:
    """Try fault cases; exit code 1 if one failed."""
    cases = select_cases(only)
    if not cases:
        raise click.ClickException(f"no case matches {', '.join(only)}")
    if listed:
        if as_json:
            entries = [
                {"case": case.key, "done": case.done, "must": case.must}
                for case in cases
            ]
            click.echo(json.dumps(entries, indent=1))
        else:
            click.echo("\n".join(f"{case.key}: {case.done}" for case in cases))
        return
    out.mkdir(parents=True, exist_ok=True)
    outcomes = read_outcomes(out / "faults.json")
    if resume:
        cases = [
            case
            for case in cases
            if case.key not in outcomes or outcomes[case.key].status != PASSED
        ]
    fresh = []
    for outcome in _all_tried(cases, jobs, out):
        fresh.append(outcome)
        outcomes[outcome.case] = outcome
        (out / "faults.json").write_text(
            json.dumps([asdict(case) for case in outcomes.values()], indent=1)
        )
    if as_json:
        click.echo(json.dumps([asdict(case) for case in fresh], indent=1))
    if page is not None:
        write(page, outcomes)
    has_failed = any(case.status == FAILED for case in fresh)
    sys.exit(int(has_failed))


def _all_tried(cases: Sequence[Case], jobs: int, out: Path) -> Iterator[Outcome]:
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    colors = {PASSED: "green", FAILED: "red", SKIPPED: "yellow"}
    with (
        Progress(
            *columns, console=console, disable=not console.is_terminal
        ) as progress,
        ThreadPoolExecutor(jobs) as pool,
    ):
        bar = progress.add_task("fault cases", total=len(cases))
        labs: list[Lab] = []
        waited_for = [pool.submit(try_case, case, out, labs) for case in cases]
        try:
            for future in as_completed(waited_for):
                outcome = future.result()
                text = f"{outcome.case} ({outcome.duration_s:.0f} s) {escape(outcome.measured)}"
                console.print(
                    f"[{colors[outcome.status]}]{outcome.status}[/] {text}",
                    highlight=False,
                    soft_wrap=True,
                )
                progress.advance(bar)
                yield outcome
        except (
            BaseException
        ):  # interrupted: nothing is left of the cases that are being tried
            pool.shutdown(wait=False, cancel_futures=True)
            for lab in tuple(labs):
                lab.end_all()
            raise


if __name__ == "__main__":
    main()
