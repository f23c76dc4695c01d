"""Figures of moving obstacles, against worlds in which they can be counted by hand."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from motion_statistics import by_class, main, mean_statistics, motion_statistics
from refusals import refused

from barn_worlds.base.errors import WorldError
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.datasets.generate_motion import (
    build_arena,
    generate_arenas,
    motion_class,
)
from barn_worlds.formats.dataset_file import write_dataset_file
from barn_worlds.moving.motion import Motion, MovingObstacle


def cylinder(name, period_s, *keys):
    return MovingObstacle(name, radius_m=0.5, motion=Motion("linear", period_s, keys))


def crossing(x, period_s):
    """Return a cylinder that goes to and fro between -5 m and 5 m at x.

    It crosses the drive.
    """
    return cylinder(
        "a", period_s, (0.0, x, -5.0), (period_s / 2, x, 5.0), (period_s, x, -5.0)
    )


def test_an_obstacle_that_goes_to_and_fro_crosses_twice_a_period():
    statistics = motion_statistics(build_arena("one", [crossing(0.0, 20.0)]))
    assert statistics.crossings_per_min == pytest.approx(6.0)
    assert statistics.mean_speed_mps == pytest.approx(1.0, rel=1e-3)
    assert (statistics.obstacles, statistics.period_s) == (1, 20.0)
    # it is within 0.5 m of the line for 2 s of 20, and covers there 2 sqrt(0.25 - d^2),
    # 0.785 m in the mean, of 20 m
    # counted in steps of 0.1 m
    assert statistics.occupied_share == pytest.approx(0.1 * 0.7854 / 20.0, rel=0.1)


def test_jumping_over_a_line_or_passing_its_ends_is_no_crossing():
    jump = cylinder("jump", 10.0, (0.0, 0.0, 1.0), (10.0, 0.0, 3.0))
    below = cylinder("below", 10.0, (0.0, 0.0, -3.0), (5.0, 0.0, -1.0))
    over = cylinder("over", 10.0, (0.0, 0.0, -1.0), (9.9, 0.0, -0.6))
    jumps = motion_statistics(build_arena("jumps", [jump, below, over]))
    assert jumps.crossings_per_min == 0.0
    beyond = motion_statistics(build_arena("beyond", [crossing(11.5, 20.0)]))
    assert beyond.crossings_per_min == 0.0
    moving = cylinder("a", 10.0, (0.0, 0.0, -5.0), (10.0, 0.0, 5.0))
    once = motion_statistics(build_arena("once", [moving]))
    # once a period: the jump back is none
    assert once.crossings_per_min == pytest.approx(6.0)


def test_means_are_over_worlds_and_extremes_over_all():
    slow = build_arena("slow", [crossing(0.0, 40.0)])
    fast = build_arena("fast", [crossing(0.0, 10.0)])
    statistics = mean_statistics([slow, fast])
    assert statistics.slowest_mps == pytest.approx(0.5, rel=1e-3)
    assert statistics.fastest_mps == pytest.approx(2.0, rel=1e-3)
    assert statistics.mean_speed_mps == pytest.approx(1.25, rel=1e-3)


def test_worlds_are_counted_by_their_class(tmp_path):
    easy, hard = (
        list(generate_arenas(motion_class(name), 2, 5)) for name in ("easy", "hard")
    )
    own = str(tmp_path / "own.npz")
    write_dataset_file(Path(own), "own", dict(enumerate(easy + hard)), {"seed": 5})
    worlds_by_class = by_class(own)
    counts = {name: len(worlds) for name, worlds in worlds_by_class.items()}
    assert counts == {"easy": 2, "hard": 2}
    mean = (len(easy[0].moving) + len(easy[1].moving)) / 2
    assert mean_statistics(worlds_by_class["easy"]).obstacles == mean
    result = CliRunner().invoke(main, [own])
    (row,) = (line for line in result.output.splitlines() if "easy" in line)
    assert f"{mean:.3f}" in row


def test_a_world_without_motion_is_refused():
    with refused("world_3: nothing moves in it", WorldError):
        motion_statistics(open_dataset("barn300").load(3))


def test_dynabarn_has_the_speeds_and_periods_that_were_published():
    dataset = open_dataset("dynabarn60")
    for first, speeds, periods in (
        (0, (0.50, 0.90), (12, 85)),
        (40, (1.52, 1.90), (16, 70)),
    ):
        worlds = map(dataset.load, range(first, first + 20))
        motions = [obstacle.motion for world in worlds for obstacle in world.moving]
        mean = []
        for motion in motions:
            keys = np.array(motion.keys)
            steps = np.diff(keys[:, 1:], axis=0)
            mean.append(np.hypot(*steps.T).sum() / keys[-1, 0])
        assert (min(mean), max(mean)) == pytest.approx(speeds, abs=0.005)
        for motion in motions:
            assert periods[0] - 0.5 <= motion.period_s <= periods[1] + 0.5
