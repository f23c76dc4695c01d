"""The file of results under kills, full disks and wrong content."""

import dataclasses
import errno
import json
import os
import resource
import signal
import time
import zlib
from contextlib import contextmanager
from multiprocessing import get_context

import pytest
from refusals import refused
from waiting import until

from barn_eval.results.rows import RowFile, seal_line
from barn_eval.trials.encounters import Encounters
from barn_eval.trials.result import (
    Outcome,
    Scores,
    TrialResult,
    format_trial_id,
    from_json_line,
    to_json_line,
)
from barn_eval.trials.trajectory import Measures
from barn_worlds.base.errors import StoreError
from barn_worlds.base.files import write_durably


def result(number=0):
    return TrialResult(
        trial_id=format_trial_id("dwa", number, 0),
        dataset="set",
        world=number,
        world_name=f"world_{number}",
        world_checksum=f"{number:02}",
        planner="dwa",
        preset="",
        protocol="paper2020",
        mode="direct",
        repetition=0,
        campaign_seed=0,
        simulator_seed=1,
        planner_seed=2,
        outcome=Outcome.SUCCESS,
        detail="",
        scores=Scores(
            True, 10.1, 10.1, 12.0, 5.0, 2.02, 3.0, 0.29, 0.25, 30.0, 5.05, 0.5
        ),
        measures=Measures(
            5.5,
            1.1,
            0.5,
            0.1,
            0.3,
            0.0,
            0,
            0.2,
            1.0,
            0,
            0.4,
            7.5,
            3.0,
            6.0,
            0.01,
            0.02,
            0.15,
        ),
    )


@pytest.fixture
def rows(tmp_path):
    return RowFile(tmp_path)


def test_rows_come_back_as_they_were(rows):
    assert rows.read() == []
    for number in range(3):
        rows.append(result(number))
    assert rows.read() == [result(number) for number in range(3)]
    assert from_json_line(to_json_line(result()), "line") == result()
    assert "motion" not in to_json_line(result())  # of worlds in which nothing moves
    moved = dataclasses.replace(
        result(), motion=Encounters(1.0, 0.5, None, 0.0, None, None)
    )
    assert from_json_line(to_json_line(moved), "line") == moved


def test_a_torn_line_is_left_out_and_cut_off_by_the_next_row(rows):
    rows.append(result(0))
    whole = rows.path.read_bytes()
    for length in (1, len(whole) // 2, len(whole) - 1):
        rows.path.write_bytes(whole + whole[:length])
        assert rows.read() == [result(0)]
        assert rows.path.stat().st_size == len(whole) + length, "reading must not write"
    rows.append(result(1))
    assert rows.read() == [result(0), result(1)]


LINE = to_json_line(result())
SEALED = f"{seal_line(LINE)}\n"


@pytest.mark.parametrize(
    "content, words",
    [
        (f"{SEALED}{seal_line('{}')}\n", "line 2: schema_version must be"),
        (SEALED * 2, "line 2: trial dwa_w0000_r00 is listed twice"),
        (SEALED.encode() + b"\xff\x00\n", "line 2: not JSON"),
        (f"{LINE}\n", "line 1: damaged or edited: no crc32"),
        (
            json.dumps(json.loads(SEALED) | {"planner": "other"}) + "\n",
            "line 1: damaged or edited: its crc32 is ",
        ),
    ],
    ids=["schema", "twice", "bytes", "no checksum", "edited"],
)
def test_wrong_rows_are_named_by_file_and_line(rows, content, words):
    rows.path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with refused(rf"results\.jsonl, {words}"):
        rows.read()


def test_kill_at_any_moment_loses_no_row_that_was_reported(tmp_path):
    # imports this module
    from child_work import append_rows  # noqa: PLC0415

    processes = get_context("spawn")
    reported = processes.Value("q", -1, lock=False)
    for _ in range(4):
        before = reported.value
        writer = processes.Process(
            target=append_rows, args=(tmp_path, reported), daemon=True
        )
        writer.start()
        until(lambda before=before: reported.value > before)
        time.sleep(0.05)
        writer.kill()
        writer.join()
        worlds = [row.world for row in RowFile(tmp_path).read()]
        assert worlds == list(range(len(worlds)))
        assert len(worlds) >= reported.value + 1
        reported.value = len(worlds) - 1


@contextmanager
def file_size_limit(size):
    """Let writes fail with EFBIG beyond a size, as a full disk does with ENOSPC.

    Those of pytest as well.
    """
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)


def test_a_write_that_fails_halfway_leaves_rows_unchanged(rows):
    rows.append(result(0))
    size = rows.path.stat().st_size
    failed = pytest.raises(
        StoreError,
        match=rf"results\.jsonl: cannot be written: {os.strerror(errno.EFBIG)}",
    )
    with file_size_limit(size + 100), failed:
        rows.append(result(1))
    assert rows.path.stat().st_size == size
    rows.append(result(1))
    assert rows.read() == [result(0), result(1)]


def test_a_table_is_replaced_as_a_whole_or_not_at_all(tmp_path):
    path = tmp_path / "table"
    write_durably(path, b"first")
    with (
        file_size_limit(100),
        refused("table: cannot be written", StoreError),
    ):
        write_durably(path, bytes(1000))
    assert path.read_bytes() == b"first"
    assert [entry.name for entry in tmp_path.iterdir()] == ["table"]


def test_wall_clock_is_no_part_of_what_repeats():
    slow = dataclasses.replace(
        result(), wall_clock=dataclasses.replace(result().wall_clock, duration_s=9.0)
    )
    assert slow != result()
    assert slow.repeatable() == result().repeatable()


def test_each_line_has_a_checksum_of_its_own_as_its_last_key(rows):
    rows.append(result(0))
    content = json.loads(rows.path.read_text())
    assert list(content)[-1] == "crc32"
    assert content["crc32"] == f"{zlib.crc32(to_json_line(result(0)).encode()):08x}"


def test_a_flipped_bit_anywhere_in_a_row_is_noticed(rows):
    rows.append(result(0))
    rows.append(result(1))
    whole = rows.path.read_bytes()
    first = whole.index(b"\n")
    for place in range(0, first, 7):
        damaged = bytearray(whole)
        damaged[place] ^= 1
        rows.path.write_bytes(damaged)
        with refused(r"results\.jsonl, line 1: "):
            rows.read()
