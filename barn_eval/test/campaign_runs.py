"""A small campaign for tests: short trials of two light planners, run by the command as
a user does.

One of the two is announced by an installed package, as a planner of somebody else is.
"""

import os
import signal
import subprocess
from pathlib import Path

from waiting import barn_words, processes, with_search_path

PROTOCOL = "schema_version: 1\nbase: {base}\nname: short\nlimit_s: 5.0\nfirst_motion_limit_s: 3.0\n"
# Where nothing moves and among moving obstacles: the rules, and a data set with three
# of its worlds.
STATIC = {"base": "challenge", "dataset": "barn300", "worlds": (0, 100, 200)}
MOVING = {"base": "dynabarn", "dataset": "dynabarn60", "worlds": (0, 7, 12)}
KINDS = {"static": STATIC, "moving": MOVING}
PACKAGE = "Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n"
ENTRY_POINTS = "[barn_planners.planners]\nstranger = barn_planners.gap.planner:ENTRY\n"
TABLES = ("results.parquet", "results.csv", "tracks.jsonl")


def write_campaign(folder, kind="static", **changes):
    """Write a campaign of 12 trials as YAML and return its path.

    `changes` are further lines.
    """
    of = KINDS[kind]
    protocol = folder / "short.yaml"
    protocol.write_text(PROTOCOL.format(base=of["base"]))
    install_stranger(folder, ENTRY_POINTS)
    lines = {
        "schema_version": 1,
        "dataset": of["dataset"],
        "planners": "[gap, stranger]",
        "worlds": f'"{",".join(map(str, of["worlds"]))}"',
        "repetitions": 2,
        "protocol": protocol,
        "seed": 5,
    } | changes
    path = folder / "campaign.yaml"
    path.write_text("".join(f"{key}: {value}\n" for key, value in lines.items()))
    return path


def install_stranger(folder, entry_points):
    """Put the metadata of an installed package with entry points into a folder."""
    installed = folder / "stranger-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text(PACKAGE)
    (installed / "entry_points.txt").write_text(entry_points)


def start(file, line):
    """Start the command in a session of its own, as a terminal does.

    The stranger is installed beside the campaign's file.
    """
    return subprocess.Popen(
        barn_words(f"campaign {file} {line}"),
        start_new_session=True,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        cwd=Path(__file__).parent,
        env=with_search_path(file.parent),
    )


def run(file, line):
    """Run the command to its end, and return its exit code and error output."""
    process = start(file, line)
    _, errors = process.communicate(timeout=600)
    return process.returncode, errors


def rows(out):
    """Return the number of whole rows."""
    path = out / "results.jsonl"
    return path.read_bytes().count(b"\n") if path.exists() else 0


def tables(out):
    return {name: (out / name).read_bytes() for name in TABLES}


def children(pid):
    """Return the pids of the workers of a campaign: its children that do its work."""
    return [
        process_id
        for process_id, parent, line in processes()
        if parent == pid and b"barn_eval.running.worker" in line
    ]


def stop(process, number):
    """Send a signal to a process; Ctrl-C goes to all that run in its terminal."""
    os.killpg(process.pid, number) if number == signal.SIGINT else process.send_signal(
        number
    )
