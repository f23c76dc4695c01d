"""A small campaign for tests: short trials of a light planner, run by the command as a user does."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

PROTOCOL = "schema_version: 1\nbase: challenge\nname: short\nlimit_s: 5.0\nfirst_motion_limit_s: 3.0\n"
TABLES = ("results.parquet", "results.csv")


def write_campaign(folder, **changes):
    """Write a campaign of 12 trials as YAML and return its path; `changes` are further lines."""
    (folder / "short.yaml").write_text(PROTOCOL)
    lines = {"schema_version": 1, "dataset": "barn300", "worlds": '"0,100,200"', "planners": "[gap, eband]"}
    lines |= {"repetitions": 2, "protocol": folder / "short.yaml", "seed": 5} | changes
    path = folder / "campaign.yaml"
    path.write_text("".join(f"{key}: {value}\n" for key, value in lines.items()))
    return path


def command(*arguments):
    return [sys.executable, "-m", "barn_eval", "campaign", *map(str, arguments)]


def run(*arguments, **options):
    """Run the command to its end."""
    return subprocess.run(
        command(*arguments), capture_output=True, text=True, timeout=240, cwd=Path(__file__).parent, **options
    )


def start(*arguments):
    """Start the command in a session of its own, as a terminal does."""
    return subprocess.Popen(
        command(*arguments),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        cwd=Path(__file__).parent,
    )


def rows(out):
    """Return the number of whole rows."""
    path = out / "results.jsonl"
    return path.read_bytes().count(b"\n") if path.exists() else 0


def tables(out):
    return {name: (out / name).read_bytes() for name in TABLES}


def until(condition, limit_s=120.0):
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def children(pid):
    """Return the pids of the workers of a campaign: its children that multiprocessing has spawned for work."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                parent = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
                line = (entry / "cmdline").read_bytes()
            except OSError:
                continue
            if parent == pid and b"spawn_main" in line:
                found.append(int(entry.name))
    return found


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def kill_group(process, number=signal.SIGINT):
    os.killpg(process.pid, number)
