"""Protocols against the published facts, and files that describe others."""

from __future__ import annotations

import csv
import math

import numpy as np
import pytest

from barn_eval.trials.protocol import CHALLENGE, PAPER, PROTOCOLS, PoseRule, Protocol, load_protocol
from barn_worlds.dataset import open_dataset
from barn_worlds.errors import ConfigError


def test_courses_of_the_challenge_have_the_published_optimal_times(original):
    dataset = open_dataset(original)
    times = [CHALLENGE.course(dataset.load(index)).optimal_time_s for index in dataset.indices]
    assert len(times) == 50
    assert (round(min(times), 2), round(max(times), 2), round(float(np.mean(times)), 2)) == (5.14, 6.84, 5.78)


def test_path_lengths_are_those_of_the_published_trials(original):
    dataset = open_dataset(original)
    with (original / "trials.csv").open() as file:
        published = {int(row["world"]): float(row["path_length_m"]) for row in csv.DictReader(file)}
    for index in dataset.indices:
        assert PAPER.course(dataset.load(index)).path_length_m == pytest.approx(published[index], abs=1e-6)


def test_ends_of_the_papers_course(open_world):
    course = PAPER.course(open_world)
    assert (course.start.x, course.start.y) == pytest.approx((-4.575 + 0.15 * 15, 4.075))
    assert (course.goal.x, course.goal.y) == pytest.approx((-4.575 + 0.15 * 15, 9.725))
    assert course.start.yaw == course.goal.yaw == math.pi / 2


@pytest.mark.parametrize(("row", "x"), [(1, -3.9), (3, -3.9), (5, -3.825), (27, -0.525), (28, -0.5)])
def test_the_papers_start_stays_clear_of_the_side_walls(open_world, row, x):
    path = open_world.path.copy()
    path[:, 0] = row
    moved = type(open_world)("moved", open_world.grid, path)
    assert PAPER.course(moved).start.x == pytest.approx(x)


def test_ends_of_the_challenges_course(open_world):
    course = CHALLENGE.course(open_world)
    assert (course.start.x, course.start.y, course.start.yaw) == (-2.25, 3.0, 1.57)
    assert (course.goal.x, course.goal.y) == (-2.25, 13.0)


def test_the_two_protocols_differ_as_published():
    assert (PAPER.clock_start_distance_m, PAPER.goal_distance_m, PAPER.limit_s) == (0.316, 0.316, 50.0)
    assert (PAPER.failure_time_s, PAPER.timeout_time_s, PAPER.goal_period_s) == (30.0, 50.0, 0.1)
    assert (CHALLENGE.clock_start_distance_m, CHALLENGE.goal_distance_m, CHALLENGE.limit_s) == (0.1, 1.0, 100.0)
    assert (PAPER.map_given, PAPER.movable_obstacles, PAPER.collision_ends_trial) == (True, True, False)
    assert (CHALLENGE.map_given, CHALLENGE.movable_obstacles, CHALLENGE.collision_ends_trial) == (False, False, True)


def test_a_file_changes_its_base(tmp_path):
    path = tmp_path / "slow.yaml"
    path.write_text("schema_version: 1\nbase: challenge\nname: slow\nlimit_s: 200\nstart: {y_m: 2.5}\n")
    slow = load_protocol(str(path))
    assert (slow.name, slow.limit_s, slow.start.y_m, slow.start.x_m) == ("slow", 200.0, 2.5, -2.25)
    assert slow.collision_ends_trial


def test_a_file_may_stand_alone(tmp_path):
    path = tmp_path / "own.yml"
    path.write_text(
        "schema_version: 1\nname: own\nstart: {x_m: -2}\ngoal: {anchor_x: start, anchor_y: start, y_m: 5}\n"
    )
    assert load_protocol(str(path)) == Protocol(
        name="own", start=PoseRule(x_m=-2.0), goal=PoseRule(anchor_x="start", anchor_y="start", y_m=5.0)
    )


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("name: x\n", "schema_version must be 1, got None"),
        ("schema_version: 2\nbase: paper\n", "schema_version must be 1, got 2"),
        ("schema_version: 1\nbase: papre\n", "did you mean 'paper'"),
        ("schema_version: 1\nbase: paper\nlimt_s: 3\n", "'limt_s'; did you mean 'limit_s'"),
        ("schema_version: 1\nbase: paper\nlimit_s: -3\n", "limit_s must be from 0.1"),
        ("schema_version: 1\nbase: paper\nlimit_s: .nan\n", "limit_s must be from 0.1"),
        ("schema_version: 1\nbase: paper\nlimit_s: long\n", "limit_s must be a number, got 'long'"),
        ("schema_version: 1\nbase: paper\nstart: {anchor_x: ma}\n", "anchor_x must be one of"),
        ("schema_version: 1\nbase: paper\nstart: 3\n", "start must be a mapping"),
        ("schema_version: 1\nbase: paper\nstart: {x_min_m: 1, x_max_m: 0}\n", "x_min_m must be at most"),
        ("schema_version: 1\nname: x\n", "missing key 'goal'"),
        ("- 1\n", "must be a mapping"),
        ("a: [\n", "not YAML"),
    ],
)
def test_what_is_wrong_with_a_file_is_told_in_one_line(tmp_path, text, complaint):
    path = tmp_path / "wrong.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"^.*wrong\.yaml: ") as caught:
        load_protocol(str(path))
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("name", "complaint"), [("papper", "did you mean 'paper'"), ("no.yaml", "No such file")])
def test_unknown_protocols(name, complaint):
    with pytest.raises(ConfigError, match=complaint):
        load_protocol(name)


def test_a_start_cannot_be_counted_from_itself(open_world):
    with pytest.raises(ConfigError, match="cannot be counted from 'start'"):
        Protocol(start=PoseRule(anchor_x="start")).course(open_world)


def test_names_lead_to_the_protocols():
    assert {name: load_protocol(name) for name in PROTOCOLS} == PROTOCOLS
