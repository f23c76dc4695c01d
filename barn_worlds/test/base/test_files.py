"""Files are read up to a size and written whole or not at all; what is no YAML, JSON or line is refused in one line."""

import gzip
import json
import math
import os
import re
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest
from refusals import refused

from barn_worlds.base.errors import ConfigError, WorldError
from barn_worlds.base.files import (
    LARGEST_YAML_BYTES,
    LONGEST_LINE_BYTES,
    create_folder,
    make_json_safe,
    parse_yaml,
    read_bytes,
    read_json,
    read_lines,
    read_maybe_gzipped,
    read_yaml,
    remove_partial_files,
    replace_file,
    write_bytes,
)


def test_sizes_are_bounded_packed_and_unpacked(tmp_path):
    plain = tmp_path / "plain"
    bomb = tmp_path / "bomb.gz"
    plain.write_bytes(b"x" * 101)
    bomb.write_bytes(gzip.compress(bytes(50_000_000)))
    message = "plain: cannot be read: more than the allowed 100 bytes"
    with refused(message, WorldError):
        read_bytes(plain, 100)
    message = r"bomb\.gz: unpacks to more than the allowed 1000000 bytes"
    with refused(message, WorldError):
        read_maybe_gzipped(bomb, 1_000_000)
    assert read_bytes(plain, 101) == b"x" * 101
    assert len(read_maybe_gzipped(bomb, 50_000_000)) == 50_000_000


@pytest.mark.parametrize("cut", [3, 12, 20, -1])
def test_damaged_gzip_is_said(tmp_path, cut):
    path = tmp_path / "a.gz"
    path.write_bytes(gzip.compress(b"text " * 100)[:cut])
    with refused(r"a\.gz: damaged gzip file", WorldError):
        read_maybe_gzipped(path)


def test_missing_files_and_folders_are_said(tmp_path):
    with refused("none: cannot be read: No such file", WorldError):
        read_bytes(tmp_path / "none")
    with refused("is a folder", WorldError):
        read_bytes(tmp_path)


def test_a_failed_write_leaves_what_was_there(tmp_path, monkeypatch):
    path = tmp_path / "a.txt"
    write_bytes(path, b"old")
    full = Mock(side_effect=OSError(28, "No space left on device"))
    monkeypatch.setattr("barn_worlds.base.files.os.replace", full)
    with refused(r"a\.txt: cannot be written: No space left", WorldError):
        write_bytes(path, b"new")
    assert path.read_bytes() == b"old"
    assert [file.name for file in tmp_path.iterdir()] == ["a.txt"]


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    target = tmp_path / "set"
    with pytest.raises(RuntimeError), create_folder(target) as folder:
        (folder / "half").write_text("x")
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []
    with create_folder(target) as folder:
        (folder / "whole").write_text("x")
        assert not target.exists()
    assert [file.name for file in target.iterdir()] == ["whole"]
    assert [file.name for file in tmp_path.iterdir()] == ["set"]
    with (
        refused("exists already; name a new folder", WorldError),
        create_folder(target),
    ):
        pass
    assert [file.name for file in target.iterdir()] == ["whole"]


def test_a_file_is_private_while_written_and_gone_on_failure(tmp_path):
    path = tmp_path / "a.gif"
    with pytest.raises(KeyboardInterrupt), replace_file(path) as temporary:
        temporary.write_bytes(b"half")
        assert temporary.stat().st_mode & 0o777 == 0o600
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "usual").write_bytes(b"")
    write_bytes(path, b"")
    assert (tmp_path / "usual").stat().st_mode == path.stat().st_mode


def test_what_a_killed_writer_left_is_hidden_and_removed(tmp_path):
    script = (
        "import os, signal, sys; from pathlib import Path; from barn_worlds.base.files import replace_file\n"
        "with replace_file(Path(sys.argv[1])) as temporary: os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", script, tmp_path / "a.gif"], check=False)
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".a.gif.")
    assert left.name.endswith(".partial")
    remove_partial_files(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_two_writers_leave_the_file_of_one(tmp_path):
    path = tmp_path / "page.html"
    with replace_file(path) as first, replace_file(path) as second:
        first.write_bytes(b"first")
        second.write_bytes(b"second")
    assert path.read_bytes() == b"first"
    assert [entry.name for entry in tmp_path.iterdir()] == ["page.html"]


@pytest.mark.parametrize(
    "content, complaint",
    [
        (b"{", "not JSON: "),
        (b"\xff\xfe\x00", "not JSON: "),
        (b"[" * 100_000, "not JSON: "),
        (b"[" + b" " * 100, "more than the allowed 100 bytes"),
        pytest.param(
            b"[" * 70 + b"1" + b"]" * 70,
            "not JSON: nested more than 60 deep",
            id="deep",
        ),
        (b'[{"a": 1, "b": 2, "a": 1}]', "not JSON: 'a' occurs twice; keep only"),
        (b"[NaN]", "not JSON: numbers must be finite, got NaN"),
        (b"1e999", "not JSON: numbers must be finite, got inf"),
        pytest.param(
            b"1" + b"0" * 400,
            "not JSON: integers must fit in 64 bits, got 1",
            id="10^400",
        ),
        pytest.param(b"9" * 5000, "not JSON: ", id="5000 digits"),
        (b'["\\ud800"]', "not JSON: "),
        pytest.param(
            b"[" + b"[]," * 700_000 + b"[]]", "not JSON: more than ", id="many"
        ),
    ],
)
def test_what_is_no_json_is_one_line(tmp_path, content, complaint):
    path = tmp_path / "file.json"
    path.write_bytes(content)
    with refused(f"^{path}: {complaint}"):
        read_json(path, 100 if "allowed" in complaint else 3_000_000)


def test_numbers_without_a_word_in_json_become_null(tmp_path):
    others = {"b": -math.inf, "c": True, "d": None}
    content = {1: [math.nan, (math.inf, 2.5)], "a": others}
    path = tmp_path / "file.json"
    path.write_text(json.dumps(make_json_safe(content), allow_nan=False))
    assert read_json(path) == {"1": [None, [None, 2.5]], "a": others | {"b": None}}


def test_a_yaml_file_is_a_mapping_with_its_version(tmp_path):
    path = tmp_path / "file.yaml"
    path.write_text("schema_version: 1\na: [1, 2.5, text]\n")
    assert read_yaml(path, 1) == {"a": [1, 2.5, "text"]}


@pytest.mark.parametrize(
    "content, complaint",
    [
        (b"- 1\n", "must be a mapping of names to values, got [1]"),
        (b"schema_version: 2\n", "schema_version must be 1, got 2"),
        (b"a: 1\n", "schema_version must be 1, got None"),
        (b"a: [1\n", "not YAML: "),
        (b"\xff\xfe\x00", "not YAML: "),
        (b"a: &x [1]\nb: *x\n", "not YAML: aliases (*name) are not allowed"),
        (b"a: !!timestamp x\n", "not YAML: "),
        (b"a: !!int x\n", "not YAML: "),
        (b"!!python/object/apply:os.system ['true']", "not YAML: "),
        pytest.param(b"a: " + b"9" * 5000, "not YAML: ", id="digits"),
        pytest.param(b"[" * 2000, "not YAML: ", id="brackets"),
        pytest.param(
            b"#" * (LARGEST_YAML_BYTES + 1),
            "more than the allowed 262144 bytes",
            id="large",
        ),
    ],
)
def test_what_is_no_such_mapping_is_one_line(tmp_path, content, complaint):
    path = tmp_path / "file.yaml"
    path.write_bytes(content)
    with refused(f"^{path}: {re.escape(complaint)}"):
        read_yaml(path, 1)


@pytest.mark.parametrize("name", ["/dev/zero", "pipe", "nul\0.yaml", "."])
def test_what_is_no_file_is_not_read(tmp_path, name):
    os.mkfifo(tmp_path / "pipe")
    for read in (
        lambda path: read_yaml(path, 1),
        read_json,
        lambda path: list(read_lines(path)),
    ):
        with refused(r"not a regular file|is a folder|null"):
            read(Path(tmp_path, name))


def test_text_is_named_by_what_it_was_given_for():
    assert parse_yaml("2", "--set a") == 2
    with refused(r"^--set a: not YAML: "):
        parse_yaml("[", "--set a")


@pytest.mark.parametrize(
    "content",
    [
        b"? " + b"0x" + b"f" * 5000 + b"\n: 1",
        b"a: " + b"{b: " * 200 + b"}" * 200,
        b'"\\ud800": 1',
        b"? [1]\n",
    ],
)
def test_odd_yaml_is_content_or_one_short_line(content):
    try:
        parse_yaml(content, "--set a")
    except ConfigError as error:
        assert str(error).startswith("--set a: not YAML: ")
        assert len(str(error)) < 300


def test_lines_come_without_one_that_was_cut_off(tmp_path):
    path = tmp_path / "rows.jsonl"
    assert list(read_lines(path)) == []
    path.write_bytes(b"a\nb\nc")
    assert list(read_lines(path)) == [
        (f"{path}, line 1", "a"),
        (f"{path}, line 2", "b"),
    ]


@pytest.mark.parametrize(
    "content, complaint",
    [
        (b"a\n\xff\n", ", line 2: not JSON: 'utf-8' codec can't decode"),
        (b"a\n" + b"x" * (LONGEST_LINE_BYTES + 1), ", line 2: more than the allowed "),
    ],
    ids=["encoding", "length"],
)
def test_lines_that_are_none_are_named(tmp_path, content, complaint):
    path = tmp_path / "rows.jsonl"
    path.write_bytes(content)
    with refused(f"^{path}{complaint}"):
        list(read_lines(path))
