"""Features of what moves, against worlds in which they can be worked out, and models of difficulty made of them."""

from dataclasses import replace

import numpy as np
import pytest
from test_metrics_motion import crossing

from barn_metrics.model.motion import RIVAL, judge_motion
from barn_metrics.model.trials import Trials
from barn_metrics.motion_features import FEATURES, motion_features
from barn_worlds.base.errors import ModelError, WorldError
from barn_worlds.moving.arena import arena_world
from barn_worlds.moving.motion import Motion, MovingObstacle
from barn_worlds.robots.files import load_robot
from barn_worlds.worlds.dataset import open_dataset


def standing(x, y, name="a"):
    return MovingObstacle(name, radius_m=0.5, motion=Motion("linear", 10.0, ((0.0, x, y), (10.0, x, y))))


def test_an_obstacle_that_goes_to_and_fro():
    found = motion_features(arena_world("one", [crossing("a", 0.0, 20.0), crossing("b", 4.0, 10.0)]))
    assert found.obstacles == 2 and found.reach_m == 0.5
    assert (found.mean_speed_mps, found.fastest_mps) == pytest.approx((1.5, 2.0), rel=1e-3)
    assert found.count_times_speed == pytest.approx(3.0, rel=1e-3)
    assert found.crossings_per_s == pytest.approx(0.1 + 0.2, rel=0.05)
    assert found.appearing_per_s == 0.0
    # a disc of 0.5 m and half a robot cuts pi 0.715^2 out of the 10 m it sweeps, of a line of 20 m
    assert found.corridor_share == pytest.approx(2.0 * np.pi * 0.715**2 / 10.0 / 20.0, rel=0.05)


def test_a_robot_that_looks_at_nothing_is_touched_where_something_stands_in_its_way():
    """It sets out at x = 11 m; its front is at 0.5 m from the centre of what stands at x = 1 m after 9.246 m."""
    found = motion_features(arena_world("wall", [standing(1.0, 0.0)]))
    assert (found.straight_hits, found.straight_share) == (1.0, pytest.approx(9.246 / 20.0, abs=0.003))
    assert (found.crossings_per_s, found.mean_speed_mps) == (0.0, 0.0)
    aside = motion_features(arena_world("aside", [standing(1.0, 0.8)]))
    assert (aside.straight_hits, aside.straight_share, aside.corridor_share) == (0.0, 1.0, 0.0)


def test_features_are_those_of_the_robot():
    """Something at x = 1 m is 10 m from the start: a robot meets it 0.5 m and the reach of its front earlier."""
    wall = arena_world("wall", [standing(1.0, 0.0)])
    for name, front_m in (("jackal", 0.254), ("husky", 0.495), ("turtlebot4", 0.171), ("racecar", 0.4551)):
        found = motion_features(wall, load_robot(name))
        assert found.straight_share == pytest.approx((10.0 - 0.5 - front_m) / 20.0, abs=0.003), name
        width_m = load_robot(name).width_m
        assert found.corridor_share == pytest.approx((1.0 + width_m) / 20.0, abs=0.1 / 20.0), name  # places 0.1 m apart
    aside = arena_world("aside", [standing(1.0, 0.8)])
    assert motion_features(aside, load_robot("husky")).straight_hits == 1.0
    assert motion_features(aside) == motion_features(aside, load_robot("jackal"))


def test_what_jumps_to_the_line_appears_there_once_a_period():
    jumping = Motion("linear", 8.0, ((0.0, 0.0, 0.5), (8.0, 0.0, 5.0)))
    found = motion_features(arena_world("jump", [MovingObstacle("a", radius_m=0.5, motion=jumping)]))
    assert found.appearing_per_s == pytest.approx(1.0 / 8.0, rel=0.1)
    assert found.crossings_per_s == 0.0


def test_features_do_not_depend_on_the_phase_of_all_obstacles_together():
    there = [crossing("a", 0.0, 20.0), crossing("b", 4.0, 10.0)]
    later = [replace(one, phase_s=5.0) for one in there]
    one, other = (motion_features(arena_world("a", some)) for some in (there, later))
    for name in FEATURES:
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=0.1), name


def test_a_world_without_motion_is_refused():
    with pytest.raises(WorldError, match="world_3: nothing moves in it"):
        motion_features(open_dataset("barn300").load(3))


@pytest.fixture(scope="module")
def worlds():
    """24 worlds: as many obstacles at as much speed in each, but more of them across the line from world to world."""
    made = {}
    for number in range(24):
        across = [crossing(f"a{k}", 1.0 * k - 6.0, 20.0, phase_s=0.1 * number) for k in range(number % 12)]
        beside = [crossing(f"b{k}", 11.9, 20.0, phase_s=0.1 * number) for k in range(12 - number % 12)]
        made[number] = arena_world(f"w{number}", [*across, *beside])
    return made


def trials_of(worlds, planners=("gap",)):
    numbers = np.repeat(sorted(worlds), len(planners))
    times = 2.0 + 0.2 * (numbers % 12)
    return Trials(numbers, planners * len(worlds), times, np.ones(len(numbers), np.bool_))


def test_features_beat_the_rival_where_difficulty_is_made_of_them(worlds):
    training = {number: world for number, world in worlds.items() if number < 12}
    others = {number: world for number, world in worlds.items() if number >= 12}
    found = judge_motion((training, trials_of(training, ("gap", "dwa"))), (others, trials_of(others)))
    features, rival = found.models
    assert found.better and found.gain.low > 0.1
    assert features.spearman.estimate > 0.95 and features.mse.estimate < 0.05 < rival.mse.estimate
    assert found.planners == ("gap",) and found.worlds == tuple(range(12, 24))
    assert (found.training_worlds, found.training_trials, found.trials) == (12, 12, 12)
    assert set(found.weights) == set(FEATURES) and RIVAL in FEATURES
    assert max(features.predictions) <= 4.2 + 1e-9 and min(features.predictions) >= 2.0 - 1e-9


def test_worlds_that_were_trained_on_do_not_judge_and_planners_must_meet(worlds):
    whole = worlds, trials_of(worlds)
    with pytest.raises(ModelError, match="24 worlds are trained on and judged on as well"):
        judge_motion(whole, whole)
    with pytest.raises(ModelError, match="trained on trials of gap, judged on trials of dwa: no planner is in both"):
        judge_motion(whole, (worlds, trials_of(worlds, ("dwa",))))
