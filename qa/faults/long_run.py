"""Run thousands of trials in one session and check that resources stay flat.

These are memory, handles, threads and files.

    python qa/faults/long_run.py --direct 5000 --ros 500 --json

One worker drives to a goal 2 m ahead, which takes about 2 s simulated; over ROS each
trial is recorded as well, and the bags of successes are removed again. What the
processes use is sampled by finished trials. A quantity is flat if from the first tenth
of the run to its end it grows by less than is allowed below, with 97.5% confidence.
The uncertainty is that of a line through the means of 20 blocks of samples;
neighbouring samples are not independent, blocks nearly are.
"""

import json
import math
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import click
import numpy as np
from processes import (
    NEAR,
    ROLES,
    SHARED_MEMORY,
    Usage,
    campaign_command,
    environment,
    list_marked,
    list_segments,
    usage,
    wait_for_end,
)
from rich.console import Console
from rich.progress import Progress
from rich.table import Table
from scipy.stats import linregress, t

WORLDS = 10
BLOCKS = 20
SETTLED = 0.1
ALLOWED_SHARE = 0.05  # growth of memory that is allowed over a whole run, of its mean
ALLOWED_COUNT = 1.0  # of handles, threads and files
_PERIOD_S = 1.0
_END_S = 60.0  # that processes have to end after their campaign has


@dataclass(frozen=True)
class Growth:
    """How a quantity changes per 1000 trials, with the half-width of its 95% interval.

    `flat` as above.
    """

    quantity: str
    mean: float
    per_1000: float
    uncertainty: float
    samples: int
    flat: bool


Sample = dict[str, float]


def growth(name: str, trials: Sequence[float], values: Sequence[float]) -> Growth:
    """Return the growth of a quantity over a run.

    Raises:
        ValueError: With fewer samples than blocks.
    """
    x = np.asarray(trials, float)
    y = np.asarray(values, float)
    settled = x >= SETTLED * x[-1]
    x, y = x[settled], y[settled]
    if len(x) < BLOCKS:
        raise ValueError(f"{len(x)} samples, at least {BLOCKS} are needed")
    means = np.array(
        [[part.mean() for part in np.array_split(axis, BLOCKS)] for axis in (x, y)]
    )
    fit = linregress(*means)
    quantile = float(t.ppf(0.975, BLOCKS - 2))
    half = quantile * fit.stderr if np.ptp(means[1]) else 0.0
    allowed = ALLOWED_SHARE * y.mean() if name.endswith("_mb") else ALLOWED_COUNT
    flat = (fit.slope + half) * (x[-1] - x[0]) <= allowed
    return Growth(
        name, float(y.mean()), fit.slope * 1000, half * 1000, len(x), bool(flat)
    )


def campaign(mode: str, trials: int, folder: Path) -> list[str]:
    """Return the command of a campaign of that many trials of one planner."""
    protocol = folder / "near.yaml"
    protocol.write_text(NEAR)
    worlds = -(-trials // 99) if trials > 99 * WORLDS else WORLDS
    return campaign_command(
        worlds=f"0-{worlds - 1}",
        repetitions=-(-trials // worlds),
        planners="gap",
        mode=mode,
        protocol=protocol,
        workers=1,
        bags="failed" if mode == "ros" else "none",
        out=folder / "out",
    )


def run(
    mode: str, trials: int, limit_s: float, progress: Progress
) -> tuple[list[Sample], dict[str, int], int]:
    """Return samples of a campaign, its outcomes and how many processes it left behind.

    It is stopped after the limit. Raises ClickException, with what it printed last, if
    it fails.
    """
    with tempfile.TemporaryDirectory(prefix="barn_long_run_") as name:
        folder = Path(name)
        mark = folder.name
        temporary = folder / "tmp"
        rows = folder / "out" / "results.jsonl"
        segments: set[str] = (
            set()
        )  # of shared memory that one of the processes was seen to use
        task = progress.add_task(f"{mode} trials", total=trials)
        end = time.monotonic() + limit_s
        samples: list[Sample] = []
        with (folder / "printed.txt").open("w") as printed:
            process = subprocess.Popen(
                campaign(mode, trials, folder),
                stdout=printed,
                stderr=printed,
                env=environment(mark, temporary),
            )
            try:
                while process.poll() is None and time.monotonic() < end:
                    done = rows.read_bytes().count(b"\n") if rows.exists() else 0
                    progress.update(task, completed=done)
                    if 0 < done < trials:
                        samples.append(sample(done, mark, segments, temporary))
                    time.sleep(_PERIOD_S)
            finally:
                process.terminate()
                process.wait()
        if process.returncode and time.monotonic() < end:
            raise click.ClickException((folder / "printed.txt").read_text()[-2000:])
        outcomes = Counter(
            json.loads(line)["outcome"] for line in rows.read_text().splitlines()
        )
        return samples, dict(outcomes), len(wait_for_end(mark, _END_S))


def sample(done: int, mark: str, segments: set[str], temporary: Path) -> Sample:
    """Return what the processes with a mark use, in all and by role."""
    processes = list_marked(mark)
    used = [(process.role, usage(process)) for process in processes]
    quantities: Sample = {"trials": done, "processes": len(used)}
    for role in ("all", *ROLES):
        usages = [what for who, what in used if role in ("all", who)] or [Usage()]
        quantities[f"{role}.anonymous_mb"] = (
            sum(entry.anonymous_bytes for entry in usages) / 1e6
        )
        quantities[f"{role}.rss_mb"] = sum(entry.rss_bytes for entry in usages) / 1e6
        quantities[f"{role}.handles"] = sum(entry.handles for entry in usages)
        quantities[f"{role}.threads"] = sum(entry.threads for entry in usages)
    segments |= list_segments(processes)
    quantities["shared_memory"] = sum(
        (SHARED_MEMORY / name).exists() for name in segments
    )
    quantities["temporary_files"] = sum(1 for _ in temporary.rglob("*"))
    return quantities


def table(mode: str, growths: Sequence[Growth]) -> Table:
    """Return growths for a terminal."""
    printed = Table("", "mean", "growth per 1000 trials", "", title=f"mode {mode}")
    for growth in growths:
        printed.add_row(
            growth.quantity,
            f"{growth.mean:.1f}",
            f"{growth.per_1000:+.2f} ± {growth.uncertainty:.2f}",
            "flat" if growth.flat else "NOT FLAT",
        )
    return printed


@click.command()
@click.option(
    "--direct", default=5000, show_default=True, help="Trials in mode direct."
)
@click.option("--ros", default=500, show_default=True, help="Trials in mode ros.")
@click.option(
    "--minutes",
    default=0.0,
    help="Longest time of each mode, after which it is stopped; 0: none.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of tables.")
@click.option(
    "--samples",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder for all samples, as JSON.",
)
def main(
    direct: int, ros: int, minutes: float, as_json: bool, samples: Path | None
) -> None:
    """Run trials for long; exit code 1 if something grows or is left behind."""
    console = Console(stderr=True)
    report = {}
    good = True
    for mode, trials in (("direct", direct), ("ros", ros)):
        if not trials:
            continue
        began = time.monotonic()
        with Progress(console=console) as progress:
            taken, outcomes, left = run(
                mode, trials, minutes * 60 or math.inf, progress
            )
        if samples:
            samples.mkdir(parents=True, exist_ok=True)
            (samples / f"{mode}.json").write_text(json.dumps(taken))
        done = [sample["trials"] for sample in taken]
        names = [
            name
            for name in taken[0]
            if name != "trials" and any(sample[name] for sample in taken)
        ]
        names += [
            name for name in ("shared_memory", "temporary_files") if name not in names
        ]
        growths = [
            growth(name, done, [sample[name] for sample in taken]) for name in names
        ]
        good &= not left and all(entry.flat for entry in growths)
        took_min = (time.monotonic() - began) / 60
        report[mode] = {
            "outcomes": outcomes,
            "minutes": round(took_min, 1),
            "left_behind": left,
            "growth": [asdict(entry) for entry in growths],
        }
        if not as_json:
            console.print(
                table(mode, growths),
                f"{outcomes} in {took_min:.1f} min, {left} processes left behind",
            )
    if as_json:
        click.echo(json.dumps(report | {"flat": good}, indent=2))
    sys.exit(int(not good))


if __name__ == "__main__":
    main()
