"""Builds all five packages as one distribution: setuptools, with the commit written into what it makes."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from setuptools import build_meta
from setuptools.command.build_py import build_py

ROOT = Path(__file__).resolve().parent
COMMIT = (
    ROOT / "barn_eval" / "barn_eval" / "data" / "commit"
)  # which barn_eval reads where there is no repository

PATH_FILE = ROOT / "ros_stand_ins" / "barn_ros_stand_ins.pth"


class BuildWithPathFile(build_py):
    """Builds with the file that imports the stand-ins whenever Python starts."""

    def run(self) -> None:
        """Build the packages and copy the file beside them."""
        super().run()
        self.copy_file(str(PATH_FILE), self.build_lib)


# What an installer asks besides; an editable installation runs from the repository, which knows its commit.
build_editable = build_meta.build_editable
get_requires_for_build_editable = build_meta.get_requires_for_build_editable
get_requires_for_build_sdist = build_meta.get_requires_for_build_sdist
get_requires_for_build_wheel = build_meta.get_requires_for_build_wheel
prepare_metadata_for_build_editable = build_meta.prepare_metadata_for_build_editable
prepare_metadata_for_build_wheel = build_meta.prepare_metadata_for_build_wheel


def build_wheel(*arguments: Any, **options: Any) -> str:
    """Build a wheel, as PEP 517 has it."""
    with _commit_written():
        return str(build_meta.build_wheel(*arguments, **options))


def build_sdist(*arguments: Any, **options: Any) -> str:
    """Build an archive of the source, as PEP 517 has it; a wheel that is built from it has its commit."""
    with _commit_written():
        return str(build_meta.build_sdist(*arguments, **options))


@contextmanager
def _commit_written() -> Iterator[None]:
    shutil.rmtree(
        ROOT / "build" / "lib", ignore_errors=True
    )  # else what has been removed since would be in it
    if not (ROOT / ".git").exists():  # an archive, which has it
        yield
        return
    changes = _git("status", "--porcelain", "--untracked-files=no")
    COMMIT.write_text(
        _git("rev-parse", "HEAD") + ("+changes" if changes else "") + "\n"
    )
    try:
        yield
    finally:
        COMMIT.unlink()


def _git(*arguments: str) -> str:
    command = ["git", "--no-optional-locks", "-C", str(ROOT), *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, check=True
    ).stdout.strip()
