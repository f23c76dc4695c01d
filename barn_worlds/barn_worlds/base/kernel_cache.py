"""Where numba keeps compiled kernels: beside the source, else in a folder that can be written; never those of old code.

numba asks for a kernel's own file whether it has changed, and not for those of the kernels that it calls, so that old
code would run on. In a source tree all compiled kernels go once one of them has changed.
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


def prepare(package: Path) -> None:
    """See to it that kernels can be kept; package: folder of barn_worlds. To be called before numba is imported.

    A line on stderr says where they go if that is neither beside the source nor in the user's folder for caches.
    """
    if os.environ.get(_VARIABLE):
        return
    tree = package.parents[1]
    if os.access(package, os.W_OK):
        if (tree / "pyproject.toml").exists():
            _drop_stale(
                [tree / name / name for name in _PACKAGES],
                package / "__pycache__" / "kernels.digest",
            )
        return
    digest = kernel_digest([package.parent / name for name in _PACKAGES])
    homes = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
    shared = Path(tempfile.gettempdir()) / f"barn_kernels_{os.getuid()}"
    kept = homes / "barn" / digest
    if not _is_own(kept):
        # the second where somebody else has taken the name of the first
        kept = (
            shared / digest
            if _is_own(shared / digest)
            else Path(tempfile.mkdtemp(prefix="barn_kernels_"))
        )
        print(
            f"compiled kernels go to {kept}: neither {package} nor {homes} can be written",
            file=sys.stderr,
        )
    os.environ[_VARIABLE] = str(kept)


def kernel_digest(packages: list[Path]) -> str:
    """Return a digest of all files that hold kernels."""
    found = hashlib.blake2b(digest_size=8)
    for path in _sources(packages):
        if b"njit" in (content := path.read_bytes()):
            found.update(content)
    return found.hexdigest()


def _drop_stale(packages: list[Path], note: Path) -> None:
    """Remove all compiled kernels if the digest in a note is of others; read no file if none is newer than the note."""
    with suppress(OSError):
        since = note.stat().st_mtime_ns if note.exists() else 0
        if since and all(
            path.stat().st_mtime_ns < since for path in _sources(packages)
        ):
            return
        digest = kernel_digest(packages)
        if not note.exists() or note.read_text("ascii") != digest:
            for package in packages:
                for index in package.rglob("*.nbi"):
                    index.unlink(missing_ok=True)
        note.parent.mkdir(exist_ok=True)
        note.write_text(digest, "ascii")


def _sources(packages: list[Path]) -> Iterator[Path]:
    for package in packages:
        for folder, _, names in os.walk(package):
            yield from (
                Path(folder, name) for name in sorted(names) if name.endswith(".py")
            )


def _is_own(folder: Path) -> bool:
    """Make a folder if need be, and tell whether nobody else can put code there."""
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        return os.access(folder, os.W_OK) and all(
            one.lstat().st_uid == os.getuid()
            and not one.is_symlink()
            and not one.lstat().st_mode & 0o022
            for one in (folder, folder.parent)
        )
    return False
