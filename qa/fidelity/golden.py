"""Drive a golden record of trials, and list what differs between two of them.

    python qa/fidelity/golden.py drive out/golden
    python qa/fidelity/golden.py digest out/golden > after.json
    python qa/fidelity/golden.py compare before.json after.json

Sixty direct trials (five planners under four protocols) and twelve over ROS. A digest
holds each trial's row without wall-clock figures, a hash of its track and, for direct
trials, a hash of every topic in its bag. Bags of trials over ROS stamp messages from
another second in each session, so their rows and tracks stand for them.
"""

import hashlib
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
from mcap.reader import make_reader

PLANNERS = "dwa,eband,mppi,gap,policy"
SETS = {
    "challenge": ("challenge", "barn300", "12,150,271", PLANNERS, "direct"),
    "known_map": ("known_map", "barn300", "40,133,222", PLANNERS, "direct"),
    "paper2020": ("paper2020", "barn300", "7,161,244", PLANNERS, "direct"),
    "dynabarn": ("dynabarn", "dynabarn60", "3,25,49", PLANNERS, "direct"),
    "ros_challenge": ("challenge", "barn300", "12,150", "dwa,eband,gap,mppi", "ros"),
    "ros_known_map": ("known_map", "barn300", "40,133", "dwa,eband", "ros"),
}
_EXISTING = click.Path(exists=True, path_type=Path)


@click.group()
def main() -> None:
    """Drive a golden record of trials, and list what differs between two of them."""


@main.command()
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--only", type=click.Choice(sorted(SETS)), multiple=True)
def drive(out: Path, only: tuple[str, ...]) -> None:
    """Drive the trials of all sets, or of some, into folders below OUT."""
    barn = Path(sys.executable).with_name("barn")
    for name in only or SETS:
        protocol, dataset, worlds, planners, mode = SETS[name]
        options = {
            "--protocol": protocol,
            "--dataset": dataset,
            "--worlds": worlds,
            "--planners": planners,
            "--mode": mode,
            "--seed": "7",
            "--bags": "all",
            "--out": str(out / name),
        }
        words = [word for pair in options.items() for word in pair]
        subprocess.run([barn, "run", *words, "--overwrite"], check=True)


@main.command()
@click.argument("out", type=_EXISTING)
def digest(out: Path) -> None:
    """Print the digest of the trials in the folders below OUT as JSON."""
    trials = {}
    for folder in sorted(out.iterdir()):
        tracks = {track["trial_id"]: track for track in lines_of(folder, "tracks")}
        for row in lines_of(folder, "results"):
            trial_id = row["trial_id"]
            del row["wall_clock"]
            bag = folder / "bags" / trial_id
            trials[f"{folder.name}/{trial_id}"] = {
                "row": row,
                "track": hash_of(json.dumps(tracks.get(trial_id)).encode()),
                "bag": hashes_of_topics(bag) if row["mode"] == "direct" else {},
            }
    click.echo(json.dumps(trials, indent=1, sort_keys=True))


@main.command()
@click.argument("before", type=_EXISTING)
@click.argument("after", type=_EXISTING)
def compare(before: Path, after: Path) -> None:
    """List the trials that differ between two digests; exit code 1 if any does."""
    old_trials = json.loads(before.read_text("utf-8"))
    new_trials = json.loads(after.read_text("utf-8"))
    differing = 0

    for name in sorted(old_trials.keys() | new_trials.keys()):
        old = dict(leaves(old_trials.get(name, {})))
        new = dict(leaves(new_trials.get(name, {})))
        keys = sorted(old.keys() | new.keys())
        changes = [key for key in keys if old.get(key) != new.get(key)]
        if changes:
            differing += 1
            click.echo(name)
        for key in changes:
            click.echo(f"  {key}: {old.get(key)} -> {new.get(key)}")

    click.echo(f"{len(old_trials)} trials before, {len(new_trials)} after")
    click.echo(f"{differing} differ")
    sys.exit(1 if differing else 0)


def lines_of(folder: Path, name: str) -> Iterator[dict[str, Any]]:
    """Yield the lines of a results folder's file without their checksums.

    Args:
        folder: A results folder.
        name: The stem of a JSON-lines file in it, "results" or "tracks".
    """
    for line in (folder / f"{name}.jsonl").read_text("utf-8").splitlines():
        content = json.loads(line)
        del content["crc32"]
        yield content


def hashes_of_topics(bag: Path) -> dict[str, str]:
    """Return for each topic of a bag the number of its messages and their hash."""
    hashes: dict[str, Any] = {}
    counts: dict[str, int] = {}
    for path in sorted(bag.glob("*.mcap")):
        with path.open("rb") as file:
            for _, channel, message in make_reader(file).iter_messages():
                topic = channel.topic
                total = hashes.setdefault(topic, hashlib.sha256())
                total.update(message.log_time.to_bytes(8, "little"))
                total.update(message.data)
                counts[topic] = counts.get(topic, 0) + 1
    return {
        topic: f"{counts[topic]} {total.hexdigest()}" for topic, total in hashes.items()
    }


def hash_of(content: bytes) -> str:
    """Return the SHA-256 of some bytes in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of nested mappings by their dotted names.

    Args:
        value: A mapping, or a value inside one.
        name: Dotted name of the value, empty at the top.
    """
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from leaves(inner, f"{name}.{key}" if name else key)
    else:
        yield name, value


if __name__ == "__main__":
    main()
