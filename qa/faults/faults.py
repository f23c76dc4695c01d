"""Do to the suite what a campaign may meet and say what comes of it.

All cases use the real commands.

    python qa/faults/faults.py --only 'campaign/*'

Each case has a folder of its own, a time limit, and must leave no process behind. Exit
code 1 if one failed. OUT/faults.json keeps what was measured. From it, `--write
docs/reliability.md` renews the log docs/reliability.csv and the summary on the page;
rows of other cases stay.
"""

import csv
import fnmatch
import inspect
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
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

BEGIN = "<!-- fault summary: begin -->"
END = "<!-- fault summary: end -->"
_COLUMNS = "case family done must status measured duration_s since held_by"
COLUMNS = tuple(_COLUMNS.split())
PASSED = "passed"
FAILED = "failed"
SKIPPED = "skipped"
UNTRIED = "not tried"
_MEASURED = 160  # characters in the log
_ROOT = Path(__file__).resolve().parents[2]


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
    lab = Lab(folder)
    labs.append(lab)
    began = time.monotonic()
    try:
        status = PASSED
        measured = case.act(lab, *case.arguments)
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
    return [
        case
        for case in cases_by_family()
        if not patterns or any(fnmatch.fnmatch(case.key, p) for p in patterns)
    ]


def cases_by_family() -> list[Case]:
    """Return all cases in the order of the families."""
    families = list(FAMILIES)
    return sorted(CASES.values(), key=lambda case: families.index(case.family))


def read_outcomes(path: Path) -> dict[str, Outcome]:
    """Return what was measured earlier."""
    if not path.exists():
        return {}
    return {row["case"]: Outcome(**row) for row in json.loads(path.read_text())}


def read_log(path: Path) -> dict[str, dict[str, str]]:
    """Return the rows of the log by case; empty if there is no log yet."""
    if not path.exists():
        return {}
    with path.open(encoding="utf-8", newline="") as file:
        return {row["case"]: row for row in csv.DictReader(file)}


def source(case: Case) -> str:
    """Return the file that holds the case, relative to the repository."""
    return Path(inspect.getfile(case.act)).relative_to(_ROOT).as_posix()


def log_row(
    case: Case, outcome: Outcome | None, logged: Mapping[str, str]
) -> dict[str, str]:
    """Return the row of a case in the log.

    Args:
        case: The case as it is now.
        outcome: What was measured now, None if the case was not tried.
        logged: Its row so far. Without a new outcome, its measurement counts as long
            as the case itself is the same; `since` is always kept.

    Returns:
        The row, by column.
    """
    row = {
        "case": case.key,
        "family": FAMILIES[case.family],
        "done": case.done,
        "must": case.must,
        "status": UNTRIED,
        "measured": "",
        "duration_s": "",
        "since": logged.get("since") or _current_commit(),
        "held_by": source(case),
    }
    if outcome is not None:
        measured = outcome.measured
        if len(measured) > _MEASURED:
            measured = measured[:_MEASURED] + " ..."
        row["status"] = outcome.status
        row["measured"] = measured
        row["duration_s"] = f"{outcome.duration_s:.0f}"
        return row

    is_same = all(logged.get(key) == row[key] for key in ("case", "done", "must"))
    if is_same:
        for key in ("status", "measured", "duration_s"):
            row[key] = logged[key]
    return row


def _current_commit() -> str:
    """Return the short hash of the commit that is checked out."""
    command = ["git", "-C", str(_ROOT), "rev-parse", "--short=8", "HEAD"]
    return subprocess.run(
        command, check=True, capture_output=True, text=True
    ).stdout.strip()


def summary(rows: Iterable[Mapping[str, str]]) -> str:
    """Return the log's counts by family as a Markdown table, with the total below."""
    statuses: dict[str, Counter[str]] = {
        title: Counter() for title in FAMILIES.values()
    }
    minutes = dict.fromkeys(FAMILIES.values(), 0.0)
    for row in rows:
        statuses[row["family"]][row["status"]] += 1
        minutes[row["family"]] += float(row["duration_s"] or 0.0) / 60.0

    lines = ["| kind | cases | passed | not passed | minutes |"]
    lines.append("| --- | ---: | ---: | ---: | ---: |")
    for title, counts in statuses.items():
        cases = counts.total()
        lines.append(_summary_line(title, cases, counts[PASSED], minutes[title]))
    total = sum(statuses.values(), Counter())
    lines.append(
        _summary_line("all", total.total(), total[PASSED], sum(minutes.values()))
    )
    return "\n".join(lines)


def _summary_line(title: str, cases: int, passed: int, minutes: float) -> str:
    return f"| {title} | {cases} | {passed} | {cases - passed} | {minutes:.0f} |"


def write(page: Path, outcomes: Mapping[str, Outcome]) -> None:
    """Renew the log beside a page, PAGE.csv, and the summary on the page.

    Raises:
        ClickException: If the page has no place for the summary.
    """
    text = page.read_text("utf-8")
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise click.ClickException(f"{page}: must have the lines {BEGIN} and {END}")

    log = page.with_suffix(".csv")
    logged = read_log(log)
    rows = [
        log_row(case, outcomes.get(case.key), logged.get(case.key, {}))
        for case in cases_by_family()
    ]
    with log.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    page.write_text(f"{before}{begin}\n\n{summary(rows)}\n\n{end}{after}", "utf-8")


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
    help="Page whose log and summary are renewed.",
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
