"""Print the share of branches that tests reach, by package, and list the others.

The exit code is 1 below the goal.

    python qa/checks/coverage_report.py --json

Reads the data that `make coverage` has collected. Counted are branches alone: lines
without a choice come on top. uncovered.yaml beside this file says of branches that no
test can reach, or that none need reach, why that is so.
"""

import json
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import click
import yaml
from rich.console import Console
from rich.table import Table

GOAL_PERCENT = 92.0
REASONS = Path(__file__).with_name("uncovered.yaml")
REFUSAL = "refusals, in one line, that no test provokes"


@dataclass
class Reached:
    """Branches of a package: how many there are and how many tests reach.

    `missing` holds the others by file, as (from line, to line); line 0 is the end.
    """

    branches: int = 0
    reached: int = 0
    missing: dict[str, list[tuple[int, int]]] = field(default_factory=dict)

    @property
    def percent(self) -> float:
        """Share of branches reached."""
        return 100.0 * self.reached / self.branches if self.branches else 100.0

    def add(self, path: str, content: dict[str, Any]) -> None:
        """Count a file."""
        self.branches += content["summary"]["num_branches"]
        self.reached += content["summary"]["covered_branches"]
        if content["missing_branches"]:
            self.missing[path] = [
                (abs(start), max(end, 0)) for start, end in content["missing_branches"]
            ]


def count_branches(content: dict[str, Any]) -> dict[str, Reached]:
    """Return the branches by package, and of all, from the JSON of coverage.py."""
    branches: dict[str, Reached] = defaultdict(Reached)
    for path, file_report in content["files"].items():
        for name in (path.split("/")[0], "all"):
            branches[name].add(path, file_report)
    names = sorted(branches, key=lambda name: (name == "all", name))
    return {name: branches[name] for name in names}


def reason_for(path: str, line: str, reasons: Mapping[str, str]) -> str:
    """Return why a branch to a line of a file is not reached, empty if nobody says.

    `reasons`: by pattern of paths.
    """
    if line.startswith("raise "):
        return REFUSAL
    return next(
        (reason for pattern, reason in reasons.items() if fnmatch(path, pattern)), ""
    )


def group_by_reason(
    missing: Mapping[str, list[tuple[int, int]]], reasons: Mapping[str, str]
) -> dict[str, int]:
    """Return the number of branches not reached by reason, the most first."""
    counts: Counter[str] = Counter()
    for path, gaps in missing.items():
        lines = Path(path).read_text("utf-8").splitlines()
        for _, end in gaps:
            line = lines[end - 1].strip() if end else ""
            counts[reason_for(path, line, reasons) or "no reason is given"] += 1
    return dict(counts.most_common())


def collect() -> dict[str, Any]:
    """Return what coverage.py has collected; ClickException if there is nothing."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "coverage.json"
        command = [sys.executable, "-m", "coverage", "json", "--quiet", "-o", str(file)]
        ended = subprocess.run(command, capture_output=True, text=True, check=False)
        if ended.returncode:
            raise click.ClickException(ended.stdout.strip() or ended.stderr.strip())
        content: dict[str, Any] = json.loads(file.read_text())
        return content


@click.command()
@click.option(
    "--goal",
    default=GOAL_PERCENT,
    show_default=True,
    help="Least share of branches, in percent.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
def main(goal: float, as_json: bool) -> None:
    """Report the branches that tests reach."""
    branches = count_branches(collect())
    reasons = yaml.safe_load(REASONS.read_text("utf-8"))
    whys = group_by_reason(branches["all"].missing, reasons)
    if as_json:
        content = {
            name: asdict(reached) | {"percent": reached.percent}
            for name, reached in branches.items()
        }
        click.echo(json.dumps(content | {"reasons": whys}, indent=2))
    else:
        table = Table("", "branches", "reached", "%")
        for name, reached in branches.items():
            table.add_row(
                name,
                str(reached.branches),
                str(reached.reached),
                f"{reached.percent:.1f}",
            )
        console = Console()
        console.print(table)
        for path, gaps in branches["all"].missing.items():
            texts = (
                f"{start} to {end}" if end else f"{start} to the end"
                for start, end in gaps
            )
            console.print(
                f"{path}: {', '.join(texts)}",
                markup=False,
                highlight=False,
                soft_wrap=True,
            )
        for reason, count in whys.items():
            console.print(
                f"{count} not reached: {reason}",
                markup=False,
                highlight=False,
                soft_wrap=True,
            )
    sys.exit(int(branches["all"].percent < goal))


if __name__ == "__main__":
    main()
