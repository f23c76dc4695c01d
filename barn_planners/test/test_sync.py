"""The synchroniser: which readings become an observation, and when."""

import itertools

import numpy as np
import pytest

from barn_planners.runtime.session import SyncConfig, Synchroniser
from barn_worlds.base.types import STOP, Odometry, Pose2D, Scan

MS = 1_000_000


def odometry(ms: int) -> Odometry:
    return Odometry(ms * MS, Pose2D(ms / 1000.0, 0.0, 0.0), STOP)


def scan(ms: int) -> Scan:
    return Scan(ms * MS, np.ones(3, np.float32), 0.0, 0.1, 0.1, 30.0)


def feed(sync: Synchroniser, *readings: tuple[str, int]):
    """Feed readings in order and return (index of the reading, scan ms, odometry ms, pose x) of each observation."""
    found = []
    for index, (kind, ms) in enumerate(readings):
        if kind == "odom":
            seen = [sync.add_odometry(odometry(ms))]
        elif kind == "pose":
            seen = [sync.add_pose(ms * MS, Pose2D(100.0 + ms / 1000.0, 0.0, 0.0))]
        else:
            seen = sync.add_scan(scan(ms))
        for each in seen:
            if each is not None:
                assert each.stamp_ns == each.scan.stamp_ns
                found.append((index, each.stamp_ns // MS, each.odometry.stamp_ns // MS, each.pose.x))
    return found


def test_in_lockstep_equal_stamps_meet_in_whatever_order_they_come():
    for order in itertools.permutations(["odom", "pose", "scan"]):
        sync = Synchroniser(SyncConfig(), use_pose=True)
        readings = [(kind, ms) for ms in (0, 50, 100) for kind in order]
        assert feed(sync, *readings) == [(2, 0, 0, 100.0), (5, 50, 50, 100.05), (8, 100, 100, 100.1)]


def test_without_a_map_the_pose_is_that_of_the_odometry():
    sync = Synchroniser(SyncConfig(), use_pose=False)
    assert feed(sync, ("scan", 50), ("odom", 50)) == [(1, 50, 50, 0.05)]


def test_odometry_at_other_times_is_taken_from_before_the_scan_once_it_is_overtaken():
    sync = Synchroniser(SyncConfig(), use_pose=False)
    assert feed(sync, ("odom", 35), ("scan", 50), ("odom", 55)) == [(2, 50, 35, 0.035)]
    later = feed(sync, ("scan", 100), ("odom", 95), ("scan", 150), ("odom", 155))
    assert [(stamp, used) for _, stamp, used, _ in later] == [(100, 55), (150, 95)], "no more waiting once let down"


def test_a_source_that_matches_again_is_waited_for_again():
    sync = Synchroniser(SyncConfig(), use_pose=False)
    feed(sync, ("odom", 35), ("scan", 50), ("odom", 55))
    assert [item[0] for item in feed(sync, ("odom", 100), ("scan", 100))] == [1]
    assert feed(sync, ("scan", 150), ("odom", 150)) == [(1, 150, 150, 0.15)]


def test_a_scan_whose_odometry_is_lost_is_used_when_the_next_one_comes():
    sync = Synchroniser(SyncConfig(), use_pose=False)
    assert feed(sync, ("odom", 0), ("scan", 0), ("scan", 50), ("scan", 100))[-2:] == [(3, 50, 0, 0.0), (3, 100, 0, 0.0)]


@pytest.mark.parametrize(("age", "count"), [(0.1, 2), (1.0, 4)])
def test_odometry_that_is_too_old_is_not_used(age, count):
    sync = Synchroniser(SyncConfig(odometry_age_s=age), use_pose=False)
    found = feed(sync, ("odom", 0), ("scan", 0), ("scan", 100), ("scan", 200), ("scan", 300), ("scan", 400))
    assert len(found) >= count
    assert max(stamp for _, stamp, _, _ in found) == (100 if age == 0.1 else 400)
    if age == 0.1:
        assert sync.missing == "no odometry of the last 0.1 s" and sync.skipped == 2


def test_seldom_localisation_is_carried_on_by_odometry():
    sync = Synchroniser(SyncConfig(), use_pose=True)
    found = feed(sync, ("odom", 0), ("pose", 0), ("scan", 0), ("odom", 50), ("scan", 50), ("odom", 100), ("scan", 100))
    assert found[0][1:] == (0, 0, 100.0)
    assert [stamp for _, stamp, _, _ in found] == [0, 50, 100]
    assert found[1][3] == pytest.approx(100.05) and found[2][3] == pytest.approx(100.1)


def test_what_is_missing_is_said():
    sync = Synchroniser(SyncConfig(), use_pose=True)
    assert sync.missing == "no scan yet"
    feed(sync, ("scan", 0))
    assert sync.missing == "no odometry yet"
    feed(sync, ("odom", 0))
    assert sync.missing == "no localisation yet"
    feed(sync, ("pose", 0))
    assert sync.missing == ""


def test_time_that_jumps_back_begins_anew_with_nothing_of_before():
    sync = Synchroniser(SyncConfig(), use_pose=False)
    feed(sync, ("odom", 5000), ("scan", 5000))
    assert not sync.restarted
    assert feed(sync, ("scan", 50)) == [] and sync.restarted
    assert feed(sync, ("odom", 50)) == [(0, 50, 50, 0.05)]


def test_no_observation_is_made_twice_and_memory_is_bounded():
    sync = Synchroniser(SyncConfig(), use_pose=False)
    readings = [(kind, ms) for ms in range(0, 20000, 20) for kind in ("odom", "scan")]
    stamps = [stamp for _, stamp, _, _ in feed(sync, *readings)]
    assert stamps == list(range(0, 20000, 20))
    assert len(sync._odometry._readings) <= 200
