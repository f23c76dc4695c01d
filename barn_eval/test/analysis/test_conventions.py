"""How events count physical trials, from tables of outcomes."""

from dataclasses import replace

import pytest
from refusals import refused

from barn_eval.analysis.conventions import (
    CONVENTIONS,
    rank_by_convention,
    select_timely,
)
from barn_eval.results.table_files import read_table_file

LAB = """planner,world,repetition,outcome,time
fast,0,0,success,20
fast,0,1,collision,
fast,0,2,success,24
slow,0,0,success,30
slow,0,1,success,33
slow,0,2,success,36
slow,0,3,success,60
slow,1,0,collision,
teleop,0,0,success,18
teleop,0,1,success,15
"""


@pytest.fixture
def lab(tmp_path):
    path = tmp_path / "lab.csv"
    path.write_text(LAB, "utf-8")
    return path


def test_the_best_three_of_a_course_count_against_a_teleoperated_drive(lab):
    slow, fast = rank_by_convention([lab], CONVENTIONS["finals"])
    # More successes that count come before shorter times.
    assert (slow.planner, slow.courses, slow.attempts, slow.counted) == (
        "slow",
        2,
        5,
        3,
    )
    assert slow.time_s == pytest.approx((30 + 33 + 36) / 3)
    assert slow.over_reference == pytest.approx(33 / 15)
    assert (fast.counted, fast.time_s) == (2, 22.0)
    # A table does not say when attempts began.
    assert fast.late is None


def test_all_trials_count_by_the_papers_convention(lab):
    places = rank_by_convention([lab], CONVENTIONS["paper"])
    counts = {place.planner: place.counted for place in places}
    assert counts == {"slow": 5, "fast": 3, "teleop": 2}


def test_attempts_count_until_the_window_closes(lab):
    rows = []
    for minute, row in enumerate(read_table_file(lab)[:3]):
        started_at = f"2026-05-01T10:{minute:02}:00.000+00:00"
        clock = replace(row.wall_clock, started_at=started_at, duration_s=45.0)
        rows.append(replace(row, wall_clock=clock))
    assert select_timely(rows, 0.0) == rows
    # The second ends 105 s after the first began, the third 165 s.
    assert select_timely(rows, 105.0) == rows[:2]
    assert select_timely(rows, 104.0) == rows[:1]


def test_a_convention_needs_more_than_its_reference(tmp_path, rejected):
    path = tmp_path / "teleop.csv"
    path.write_text("planner,world,outcome,time\nteleop,0,success,15\n", "utf-8")
    with refused("has only trials of teleop"):
        rank_by_convention([path], CONVENTIONS["finals"])
    message = rejected(f"leaderboard {path} --convention finals --worlds 0", 2)
    assert "--convention cannot be used with --by" in message
