"""Compiled kernels can be kept wherever the suite is installed, and none outlives a change of another."""

import os
from pathlib import Path

import pytest

from barn_worlds.base import kernel_cache


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A source tree with one kernel, and a compiled one."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")  # so that what is set meanwhile is undone
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = tmp_path / "tree" / "barn_worlds" / "barn_worlds"
    (folder / "__pycache__").mkdir(parents=True)
    (tmp_path / "tree" / "pyproject.toml").touch()
    (folder / "kernels.py").write_text("from numba import njit")
    return folder


def compiled(package):
    index = package / "__pycache__" / "other.nbi"
    index.touch()
    return index


def test_all_kernels_are_compiled_anew_once_one_has_changed(package):
    kernel_cache.prepare(package)
    files = compiled(package)
    kernel_cache.prepare(package)
    assert files.exists()
    (package / "plain.py").write_text("pass")
    kernel_cache.prepare(package)
    assert files.exists()
    (package / "kernels.py").write_text("from numba import njit  # changed")
    kernel_cache.prepare(package)
    assert not files.exists()
    assert not os.environ["NUMBA_CACHE_DIR"]


@pytest.mark.parametrize(
    "source",
    [
        "from barn_worlds.base.arrays import inline_kernel",
        "class Argument(NamedTuple):",
    ],
)
def test_the_suites_own_decorators_and_types_of_arguments_count_too(package, source):
    (package / "own.py").write_text(source)
    kernel_cache.prepare(package)
    files = compiled(package)
    (package / "own.py").write_text(f"{source}  # changed")
    kernel_cache.prepare(package)
    assert not files.exists()


def read_only(monkeypatch, *folders):
    denied = tuple(map(str, folders))
    able = os.access

    def access(path, mode):
        return not str(path).startswith(denied) and able(path, mode)

    monkeypatch.setattr(os, "access", access)


@pytest.fixture
def temporary(package, tmp_path, monkeypatch):
    """The folder for temporary files, the only one that can be written to."""
    read_only(monkeypatch, package, tmp_path / "cache")
    monkeypatch.setattr(kernel_cache.tempfile, "gettempdir", lambda: str(tmp_path))
    return tmp_path


def test_a_read_only_package_caches_kernels_for_the_user(
    package, tmp_path, monkeypatch, capsys
):
    read_only(monkeypatch, package)
    kernel_cache.prepare(package)
    assert os.environ["NUMBA_CACHE_DIR"].startswith(str(tmp_path / "cache" / "barn"))
    assert capsys.readouterr().err == ""


def test_without_a_writable_home_kernels_go_to_a_temp_folder(
    package, temporary, capsys
):
    kernel_cache.prepare(package)
    folder = os.environ["NUMBA_CACHE_DIR"]
    assert folder.startswith(str(temporary / "barn_kernels_"))
    assert Path(folder).stat().st_mode & 0o077 == 0
    warning = f"compiled kernels go to {folder}: neither "
    assert capsys.readouterr().err.startswith(warning)
    kernel_cache.prepare(package)  # what it has found stands, and is said once
    assert capsys.readouterr().err == ""


def test_a_folder_that_others_can_write_to_is_not_used(package, temporary):
    folder = temporary / f"barn_kernels_{os.getuid()}"
    folder.mkdir()
    folder.chmod(0o777)
    kernel_cache.prepare(package)
    assert not Path(os.environ["NUMBA_CACHE_DIR"]).is_relative_to(folder)
