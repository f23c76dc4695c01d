"""Files are read up to a size and written whole or not at all."""

import gzip
import subprocess
import sys

import pytest

from barn_worlds.base.errors import WorldError
from barn_worlds.base.files import new_folder, read_bytes, read_maybe_gzipped, remove_partial, replacing, write_bytes


def test_sizes_are_bounded_packed_and_unpacked(tmp_path):
    plain, bomb = tmp_path / "plain", tmp_path / "bomb.gz"
    plain.write_bytes(b"x" * 101)
    bomb.write_bytes(gzip.compress(bytes(50_000_000)))
    with pytest.raises(WorldError, match="plain: cannot be read: more than the allowed 100 bytes"):
        read_bytes(plain, 100)
    with pytest.raises(WorldError, match=r"bomb\.gz: unpacks to more than the allowed 1000000 bytes"):
        read_maybe_gzipped(bomb, 1_000_000)
    assert read_bytes(plain, 101) == b"x" * 101
    assert len(read_maybe_gzipped(bomb, 50_000_000)) == 50_000_000


@pytest.mark.parametrize("cut", [3, 12, 20, -1])
def test_damaged_gzip_is_said(tmp_path, cut):
    path = tmp_path / "a.gz"
    path.write_bytes(gzip.compress(b"text " * 100)[:cut])
    with pytest.raises(WorldError, match=r"a\.gz: damaged gzip file"):
        read_maybe_gzipped(path)


def test_missing_files_and_folders_are_said(tmp_path):
    with pytest.raises(WorldError, match="none: cannot be read: No such file"):
        read_bytes(tmp_path / "none")
    with pytest.raises(WorldError, match="is a folder"):
        read_bytes(tmp_path)


def test_a_failed_write_leaves_what_was_there(tmp_path, monkeypatch):
    path = tmp_path / "a.txt"
    write_bytes(path, b"old")

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("barn_worlds.base.files.os.replace", fail)
    with pytest.raises(WorldError, match=r"a\.txt: cannot be written: No space left"):
        write_bytes(path, b"new")
    assert path.read_bytes() == b"old"
    assert [file.name for file in tmp_path.iterdir()] == ["a.txt"]


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    target = tmp_path / "set"
    with pytest.raises(RuntimeError), new_folder(target) as folder:
        (folder / "half").write_text("x")
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []
    with new_folder(target) as folder:
        (folder / "whole").write_text("x")
        assert not target.exists()
    assert [file.name for file in target.iterdir()] == ["whole"]
    assert [file.name for file in tmp_path.iterdir()] == ["set"]
    with pytest.raises(WorldError, match="exists already; name a new folder"), new_folder(target):
        pass
    assert [file.name for file in target.iterdir()] == ["whole"]


def test_a_file_is_private_while_it_is_written_and_gone_if_that_fails(tmp_path):
    path = tmp_path / "a.gif"
    with pytest.raises(KeyboardInterrupt), replacing(path) as temporary:
        temporary.write_bytes(b"half")
        assert temporary.stat().st_mode & 0o777 == 0o600
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "usual").write_bytes(b"")
    write_bytes(path, b"")
    assert (tmp_path / "usual").stat().st_mode == path.stat().st_mode


def test_what_a_killed_writer_left_is_hidden_and_removed(tmp_path):
    script = (
        "import os, signal, sys; from pathlib import Path; from barn_worlds.base.files import replacing\n"
        "with replacing(Path(sys.argv[1])) as temporary: os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", script, tmp_path / "a.gif"], check=False)
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".a.gif.")
    assert left.name.endswith(".partial")
    remove_partial(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_two_writers_leave_the_file_of_one(tmp_path):
    path = tmp_path / "page.html"
    with replacing(path) as first, replacing(path) as second:
        first.write_bytes(b"first")
        second.write_bytes(b"second")
    assert path.read_bytes() == b"first"
    assert [entry.name for entry in tmp_path.iterdir()] == ["page.html"]
