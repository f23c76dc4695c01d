"""The least time that a course could take, and the speed cap that it is computed for."""

import math
from dataclasses import dataclass, replace

import numpy as np
import planners
import pytest
from planners import Straight
from refusals import refused

from barn_eval.running.direct import run_direct_trial
from barn_eval.running.request import read_request
from barn_eval.trials.protocol import CHALLENGE, DYNABARN, PAPER_2020
from barn_eval.trials.result import Outcome
from barn_eval.trials.run_config import PlannerChoice, RunConfig
from barn_eval.trials.spec import WHEEL_SLIP
from barn_planners.interface import Decision
from barn_worlds.base.types import Velocity2D, wrap_angle
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.robots.files import load_robot

BARN300 = open_dataset("barn300")


def spec_of(world, protocol=CHALLENGE, declared_mps=0.5, **changes):
    return planners.spec_of(world, protocol, declared_mps=declared_mps, **changes)


@dataclass
class Swinging(Straight):
    """Drives at the goal as fast as it may, its nose swinging from side to side, by
    which base_link is fastest.
    """

    speed_mps: float
    swing_rad: float = 0.3
    cycle: int = 0

    def step(self, observation):
        self.cycle += 1
        pose = observation.pose
        bearing = math.atan2(self.goal.y - pose.y, self.goal.x - pose.x) - pose.yaw
        swung = wrap_angle(bearing + self.swing_rad * math.sin(0.6 * self.cycle))
        return Decision(Velocity2D(self.speed_mps, max(-2.0, min(2.0, 5.0 * swung))))


def test_straight_driving_takes_hardly_more_than_the_bound(open_world):
    scores = run_direct_trial(spec_of(open_world), planner=Straight()).result.scores
    assert 0.0 < scores.least_time_s <= scores.traversal_time_s
    assert scores.efficiency == scores.least_time_s / scores.traversal_time_s > 0.96


@pytest.mark.parametrize(
    "robot", ["jackal", "husky", "scout_mini", "turtlebot3_burger", "turtlebot4"]
)
@pytest.mark.parametrize("share", [0.3, 1.0])
def test_no_robot_beats_the_least_time_by_swinging(open_world, robot, share):
    loaded = load_robot(robot)
    speed_mps = share * loaded.drive.max_speed_m_s
    slow = replace(
        CHALLENGE,
        name="slow",
        start=replace(CHALLENGE.start, y_m=8.0),
        goal_distance_m=4.0,
    )
    spec = spec_of(open_world, slow, speed_mps, robot=loaded)
    scores = run_direct_trial(spec, planner=Swinging(speed_mps)).result.scores
    assert scores.success
    assert 0.8 < scores.efficiency <= 1.0


def test_where_the_bound_does_not_hold_none_is_computed(open_world):
    jackal = load_robot("jackal")
    shifted = replace(jackal, chassis=replace(jackal.chassis, axle_x_m=0.01))
    finished = run_direct_trial(spec_of(open_world, robot=shifted), planner=Straight())
    scores = finished.result.scores
    assert (scores.least_time_s, scores.efficiency) == (None, None)
    spec = spec_of(open_world)
    errors = replace(spec.simulator.odometry, wheel_radius_error=0.1)
    odd = replace(spec, simulator=replace(spec.simulator, odometry=errors))
    assert odd.least_time_s == spec.least_time_s
    # By two judges, the odometry may be ahead of the truth.
    by_two = replace(CHALLENGE, goal_source="odometry")
    assert spec_of(open_world, by_two).least_time_s is None
    by_odometry = replace(by_two, clock_start_source="odometry")
    assert replace(odd, protocol=by_odometry).least_time_s is None


def test_rare_looks_may_start_the_clock_late(open_world):
    seldom = replace(CHALLENGE, look_period_s=0.5)
    often_s = spec_of(open_world).least_time_s
    assert spec_of(open_world, seldom).least_time_s == pytest.approx(often_s - 0.45)


@pytest.mark.parametrize("planner", ["dwa", "eband", "gap", "mppi", "policy"])
def test_our_planners_keep_to_their_caps_and_to_the_least_time(planner):
    [spec] = RunConfig(planners=(PlannerChoice(planner),), worlds="15", seed=2).trials()
    finished = run_direct_trial(spec)
    assert np.nanmax(np.abs(finished.trajectory.command[:, 0])) <= spec.declared_mps
    assert (
        finished.result.speed_cap_mps
        == spec.declared_mps
        == (1.0 if planner == "policy" else 0.5)
    )
    assert finished.result.scores.success
    assert 0.0 < finished.result.scores.efficiency < 1.0


def test_a_failure_has_no_efficiency_but_its_least_time(open_world):
    scores = run_direct_trial(
        spec_of(open_world, replace(CHALLENGE, limit_s=2.0)), planner=Straight()
    ).result.scores
    assert (scores.success, scores.efficiency) == (False, 0.0)
    assert scores.least_time_s > 10.0


def test_a_command_above_the_declared_cap_ends_the_trial(open_world):
    result = run_direct_trial(
        spec_of(open_world, declared_mps=0.4), planner=Straight()
    ).result
    message = "command of 0.5 m/s is above the planner's declared speed cap of 0.4 m/s"
    assert (result.outcome, result.detail) == (Outcome.INVALID_COMMAND, message)


def test_who_declares_no_cap_is_measured_by_the_robots_limit(open_world):
    spec = spec_of(open_world, declared_mps=0.0, planner_config="abc")
    assert spec.speed_cap_mps == spec.simulator.drive.max_speed_m_s == 2.0
    assert spec_of(open_world, declared_mps=9.0).least_time_s == spec.least_time_s
    assert spec.least_time_s < 0.26 * spec_of(open_world, declared_mps=0.5).least_time_s


def test_obstacles_bound_the_time_where_contact_ends_trials():
    world = max(
        (BARN300.load(number) for number in range(0, 300, 30)),
        key=lambda candidate: spec_of(candidate).least_time_s,
    )
    period_s = CHALLENGE.control_period_s
    fastest = 0.5 * (1.0 + WHEEL_SLIP["skid_steer"])
    straight_s = (
        10.0 - CHALLENGE.goal_distance_m - CHALLENGE.clock_start_distance_m
    ) / fastest - period_s
    assert spec_of(world).least_time_s > straight_s + 0.3
    for changed in (
        {"collision_ends_trial": False},
        {"clock_start_source": "odometry", "goal_source": "odometry"},
    ):
        assert spec_of(
            world, replace(CHALLENGE, **changed)
        ).least_time_s == pytest.approx(straight_s)


def test_each_protocol_has_a_least_time():
    world = BARN300.load(3)
    course = PAPER_2020.course(world)
    driven_m = course.start.distance(course.goal) - 2.0 * math.sqrt(0.1)
    assert spec_of(world, PAPER_2020).least_time_s == pytest.approx(
        driven_m / 0.51 - 0.05
    )
    arena = open_dataset("dynabarn60").load(0)
    assert spec_of(arena, DYNABARN).least_time_s == pytest.approx(
        18.9 / 0.51 - 0.05, rel=0.01
    )


def test_a_planner_of_ones_own_declares_its_cap_as_a_setting():
    options = {
        "planners": "mine",
        "planner_command": "mine=run me",
        "mode": "ros",
        "worlds": "0",
    }
    settings = ({}, {"mine.max_speed_mps": 0.7}, {"max_speed_mps": 1})
    specs = [
        read_request(None, options | {"settings": setting}).config.trials()[0]
        for setting in settings
    ]
    assert [spec.declared_mps for spec in specs] == [0.0, 0.7, 1.0]
    assert len({spec.planner_config for spec in specs}) == 3
    with refused("planner 'mine': max_speed_mps must be a number, got 'fast'"):
        read_request(None, options | {"settings": {"max_speed_mps": "fast"}})
    with refused("planner 'dwa': its parameters set its speed cap"):
        PlannerChoice("dwa", max_speed_mps=0.5)


def test_the_cap_of_our_planners_follows_from_their_parameters():
    [spec] = RunConfig(
        planners=(PlannerChoice("dwa", overrides={"dwa.max_speed_mps": 0.3}),),
        worlds="0",
    ).trials()
    assert spec.declared_mps == 0.3
