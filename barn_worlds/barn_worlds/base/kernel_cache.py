"""The folder of numba's compiled kernels, and the removal of stale ones.

Kernels lie beside the source or, if that is not writable, in a folder of the user.

numba compiles a kernel again when its own file changes, but not when it calls a kernel
in another file that changed: old code would still run. In a source tree, a change of
any file with kernels or types of their arguments deletes all compiled kernels.
"""

import hashlib
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

_PACKAGES = ("barn_worlds", "barn_sim", "barn_planners", "barn_metrics", "barn_eval")
_VARIABLE = "NUMBA_CACHE_DIR"
# What every source file with kernels, or with a type of their arguments, contains.
_MARKS = (b"numba", b"barn_worlds.base.arrays", b"NamedTuple")


def prepare(package: Path) -> None:
    """Remove stale kernels, or set NUMBA_CACHE_DIR if read-only; do nothing if set.

    Call this before numba is imported. If the folder is neither beside the source nor
    in the user's cache, a line on stderr names it.

    Args:
        package: Folder of the Python package barn_worlds.
    """
    if os.environ.get(_VARIABLE):
        return

    if os.access(package, os.W_OK):
        tree = package.parents[1]
        if (tree / "pyproject.toml").exists():
            packages = [tree / name / name for name in _PACKAGES]
            _remove_stale(packages, package / "__pycache__" / "kernels.digest")
        return

    # Folders of digests keep kernels of several installed versions apart.
    digest = kernel_digest([package.parent / name for name in _PACKAGES])
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
    folder = caches / "barn" / digest
    if not _is_private(folder):
        folder = Path(tempfile.gettempdir()) / f"barn_kernels_{os.getuid()}" / digest
        # Another user may have created that folder first, to plant code in it.
        if not _is_private(folder):
            folder = Path(tempfile.mkdtemp(prefix="barn_kernels_"))
        print(
            f"compiled kernels go to {folder}: "
            f"neither {package} nor {caches} is writable",
            file=sys.stderr,
        )
    os.environ[_VARIABLE] = str(folder)


def kernel_digest(packages: list[Path]) -> str:
    """Return a hex digest of the .py files below some folders that concern kernels."""
    digest = hashlib.blake2b(digest_size=8)
    for path in _find_sources(packages):
        content = path.read_bytes()
        if any(mark in content for mark in _MARKS):
            digest.update(content)
    return digest.hexdigest()


def _remove_stale(packages: list[Path], note: Path) -> None:
    """Delete all kernels' .nbi files if a source changed; update `note`, raise nothing.

    Args:
        packages: Folders of Python packages.
        note: File with the digest of the kernels at the last check.
    """
    with suppress(OSError):
        checked_ns = note.stat().st_mtime_ns if note.exists() else 0
        # Most of the time nothing has changed, and no file needs to be read.
        if checked_ns and all(
            path.stat().st_mtime_ns < checked_ns for path in _find_sources(packages)
        ):
            return

        digest = kernel_digest(packages)
        if not checked_ns or note.read_text("ascii") != digest:
            for package in packages:
                # Without its index, numba does not find a compiled kernel.
                for index in package.rglob("*.nbi"):
                    index.unlink(missing_ok=True)
        note.parent.mkdir(exist_ok=True)
        note.write_text(digest, "ascii")


def _find_sources(packages: list[Path]) -> Iterator[Path]:
    """Yield all .py files below folders of packages."""
    for package in packages:
        # This runs whenever the suite starts, and os.walk is faster than Path.rglob.
        for folder, _, names in os.walk(package):
            for name in sorted(names):
                if name.endswith(".py"):
                    yield Path(folder, name)


def _is_private(folder: Path) -> bool:
    """Create a folder; tell whether this user alone can write to it and its parent."""
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        if not os.access(folder, os.W_OK):
            return False
        # Whoever owns the parent could replace the folder.
        for level in (folder, folder.parent):
            status = level.lstat()
            if status.st_uid != os.getuid() or status.st_mode & 0o022:
                return False
            if level.is_symlink():
                return False
        return True
    return False
