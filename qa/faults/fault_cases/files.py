"""Disks that fail."""

import errno
import os
import resource
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from barn_worlds.base.errors import ExitCode
from fault_cases.campaigns import (
    campaign,
    expect_tables,
    resume,
    run_undisturbed,
    start_two_rows,
)
from fault_cases.kit import Lab, Skipped, case, hold
from fault_cases.system import kill, succeeds

FAMILY = "files"


@contextmanager
def disk(lab: Lab, size: str) -> Iterator[Path]:
    """Give a small file system at the case's folder of results."""
    lab.out.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", f"size={size}", "barn-faults", str(lab.out)]
    if os.geteuid() != 0 or not succeeds(words):
        raise Skipped("a file system cannot be mounted here (needs root)")
    try:
        yield lab.out
    finally:
        subprocess.run(["umount", "-l", str(lab.out)], check=True)


@case(FAMILY)
def disk_full(lab: Lab) -> str:
    """The disk is full after some rows; the campaign is run again after there is room.

    It stops with one line that names the file and the reason; the tables are the
    undisturbed ones to the byte.
    """
    run_undisturbed()
    with disk(lab, "160k") as out:
        words = campaign(lab, "--out", out / "inner")
        (out / "filler").write_bytes(bytes(132 * 1024))
        refusal = lab.expect_refusal(*words)
        hold(os.strerror(errno.ENOSPC) in refusal and "inner" in refusal, refusal)
        (out / "filler").unlink()
        row_count = len(lab.rows(out / "inner"))
        hold(1 <= row_count < 12, f"{row_count} rows")
        lab.barn(*words)
        expect_tables(out / "inner")
    return f"{row_count} rows kept; {refusal[:160]}"


@case(FAMILY)
def disk_read_only(lab: Lab) -> str:
    """A campaign is killed after two trials, and the file system is read-only when it
    is run again.

    Refused in one line with the reason; once it is writable, the tables are the
    undisturbed ones to the byte.
    """
    run_undisturbed()
    with disk(lab, "4m") as out:
        words = campaign(lab, "--out", out / "inner")
        run = lab.start(*words)
        lab.wait_for_two_rows(out / "inner")
        kill([run.pid])
        lab.wait_for_end()
        subprocess.run(["mount", "-o", "remount,ro", str(out)], check=True)
        refusal = lab.expect_refusal(*words)
        hold(os.strerror(errno.EROFS) in refusal, refusal)
        subprocess.run(["mount", "-o", "remount,rw", str(out)], check=True)
        row_count = len(lab.rows(out / "inner"))
        lab.barn(*words)
        expect_tables(out / "inner")
    return f"{row_count} rows kept; {refusal[:160]}"


@case(FAMILY)
def file_size_limited(lab: Lab) -> str:
    """Files may have 9 kB (ulimit -f); the campaign is run again without the limit.

    It stops with one line that names the file and the reason; the tables are the
    undisturbed ones to the byte.
    """
    run_undisturbed()
    limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (9_000, 9_000))
    refusal = lab.expect_refusal(*campaign(lab), before=limit)
    hold(os.strerror(errno.EFBIG) in refusal, refusal)
    return f"{resume(lab)}; {refusal[:160]}"


@case(FAMILY)
def folder_removed(lab: Lab) -> str:
    """The folder of results is removed after two trials; the campaign is then run
    again.

    It stops with one line that names the folder; run again, the tables are the
    undisturbed ones to the byte.
    """
    run = start_two_rows(lab)
    lab.out.rename(lab.folder / "gone")
    shutil.rmtree(lab.folder / "gone")
    error = lab.finish(run, ExitCode.REFUSED).error
    hold(str(lab.out) in error, error)
    return f"{resume(lab)}; {error[:160]}"
