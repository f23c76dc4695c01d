"""A small campaign for tests: short trials of two light planners, run by the command as a user does.

One of the two is announced by an installed package, as a planner of somebody else is.
"""

import os
import signal
import subprocess
import sys
from pathlib import Path

from waiting import processes

PROTOCOL = "schema_version: 1\nbase: {base}\nname: short\nlimit_s: 5.0\nfirst_motion_limit_s: 3.0\n"
# Where nothing moves and among moving obstacles: the rules, and a data set with three of its worlds.
STATIC = {"base": "challenge", "dataset": "barn300", "worlds": (0, 100, 200)}
MOVING = {"base": "dynabarn", "dataset": "dynabarn60", "worlds": (0, 7, 12)}
KINDS = {"static": STATIC, "moving": MOVING}
PACKAGE = "Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n"
ENTRY_POINTS = "[barn_planners.planners]\nstranger = barn_planners.gap.planner:ENTRY\n"
TABLES = ("results.parquet", "results.csv", "tracks.jsonl")


def write_campaign(folder, kind="static", **changes):
    """Write a campaign of 12 trials as YAML and return its path; `changes` are further lines."""
    of = KINDS[kind]
    (folder / "short.yaml").write_text(PROTOCOL.format(base=of["base"]))
    installed = folder / "stranger-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text(PACKAGE)
    (installed / "entry_points.txt").write_text(ENTRY_POINTS)
    lines = {
        "schema_version": 1,
        "dataset": of["dataset"],
        "planners": "[gap, stranger]",
    }
    lines |= {"worlds": f'"{",".join(map(str, of["worlds"]))}"'}
    lines |= {"repetitions": 2, "protocol": folder / "short.yaml", "seed": 5} | changes
    path = folder / "campaign.yaml"
    path.write_text("".join(f"{key}: {value}\n" for key, value in lines.items()))
    return path


def command(file, *arguments):
    return [
        sys.executable,
        "-m",
        "barn_eval",
        "campaign",
        str(file),
        *map(str, arguments),
    ]


def options(file):
    """Return where and how the command is run: with the stranger installed beside the campaign's file."""
    path = os.pathsep.join(
        [str(file.parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    )
    environment = os.environ | {"PYTHONPATH": path}
    return {"text": True, "cwd": Path(__file__).parent, "env": environment}


def run(file, *arguments):
    """Run the command to its end."""
    return subprocess.run(
        command(file, *arguments),
        check=False,
        capture_output=True,
        timeout=600,
        **options(file),
    )


def start(file, *arguments):
    """Start the command in a session of its own, as a terminal does."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(
        command(file, *arguments), start_new_session=True, **pipes, **options(file)
    )


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
