"""Protocols against the published facts, and files that describe others."""

import csv
import math
import re
from dataclasses import replace

import numpy as np
import pytest
import yaml
from refusals import refused
from text_tables import answers_of, rows_of

from barn_eval.trials import identity
from barn_eval.trials.protocol import (
    CHALLENGE,
    CHALLENGE_2022,
    CHALLENGE_2022_03,
    DYNABARN,
    DYNABARN_CLEAR,
    KNOWN_MAP,
    PAPER_2020,
    PROTOCOLS,
    PoseRule,
    Protocol,
    load_protocol,
)
from barn_eval.trials.spec import simulator_config
from barn_sim.seeds import phase_s, time_until_hit
from barn_worlds.base.config import as_dict
from barn_worlds.base.types import Pose2D
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.robots.contact import contact_footprint
from barn_worlds.robots.files import STANDARD_ROBOT, load_robot
from barn_worlds.worlds.world import World

HUSKY = load_robot("husky").chassis


def test_challenge_courses_have_the_published_optimal_times(original_folder):
    dataset = open_dataset(original_folder)
    times = [
        CHALLENGE.course(dataset.load(index)).optimal_time_s
        for index in dataset.world_numbers
    ]
    assert len(times) == 50
    figures = (min(times), max(times), np.mean(times))
    assert [f"{figure:.2f}" for figure in figures] == ["5.14", "6.84", "5.78"]


def test_path_lengths_are_those_of_the_published_trials(original_folder):
    dataset = open_dataset(original_folder)
    with (original_folder / "trials.csv").open() as file:
        rows = {int(row["world"]): row for row in csv.DictReader(file)}
    for index in dataset.world_numbers:
        course = PAPER_2020.course(dataset.load(index))
        published_m = float(rows[index]["path_length_m"])
        assert course.path_length_m == pytest.approx(published_m, abs=1e-6)


def test_courses_of_dynabarn_are_longer_challenge_courses():
    """The challenge's runner computes -31 m, by which every success scores 1/8."""
    for index in (0, 59):
        world = open_dataset("dynabarn60").load(index)
        course = DYNABARN.course(world)
        assert course.start == Pose2D(11.0, 0.0, math.pi)
        assert course.goal == Pose2D(-9.0, 0.0, math.pi)
        assert course.reference_length_m == course.path_length_m == 20.0
        assert course.optimal_time_s == 10.0
        distances = "goal_distance_m clock_start_distance_m"
        for name in f"limit_s {distances} collision_ends_trial map_given".split():
            assert getattr(DYNABARN, name) == getattr(CHALLENGE, name)
        with refused(
            "is an arena, so protocol challenge does not fit it; use dynabarn"
        ):
            CHALLENGE.course(world)


def test_dynabarn_is_no_protocol_for_worlds_that_are_no_arenas(open_world):
    with refused(
        "is not an arena, so protocol dynabarn does not fit it; use challenge"
    ):
        DYNABARN.course(open_world)


def test_the_phase_belongs_to_protocol_and_fingerprint(tmp_path):
    """Protocols from before there was one have the fingerprints that they had."""
    assert "random_phase" not in as_dict(CHALLENGE) and "arena" not in as_dict(
        CHALLENGE
    )
    file = tmp_path / "zero.yaml"
    file.write_text(
        "schema_version: 1\nbase: dynabarn\nname: dynabarn_from_zero\nrandom_phase: false\n"
    )
    zero = load_protocol(str(file))
    assert zero == replace(DYNABARN, name="dynabarn_from_zero", random_phase=False)
    fingerprints = set()
    for protocol in (zero, DYNABARN):
        simulator = simulator_config(protocol)
        assert simulator.obstacles.random_phase == (protocol is DYNABARN)
        content = identity.task_content(protocol, simulator)
        fingerprints.add(identity.fingerprint(content))
    assert len(fingerprints) == 2
    with refused(r"'obstacles\.random_phase' is set by protocol dynabarn"):
        simulator_config(DYNABARN, {"obstacles.random_phase": False})


def test_an_arena_has_an_edge_and_other_worlds_have_none(open_world):
    arena = open_dataset("dynabarn60").load(0)
    assert DYNABARN.course(arena).bounds_m == (-13.25, -13.25, 15.25, 13.25)
    assert min(map(abs, CHALLENGE.course(open_world).bounds_m)) > 900.0


def test_a_phase_that_clears_the_start_lets_a_robot_wait_there():
    world = open_dataset("dynabarn60").load(49)
    outline = contact_footprint(load_robot("jackal").chassis)
    start = DYNABARN.course(world).start
    hit_s = {}
    for protocol in (DYNABARN, DYNABARN_CLEAR):
        config = simulator_config(protocol)
        phases = [phase_s(world, config, start, seed) for seed in range(20)]
        hit_s[protocol.name] = [
            time_until_hit(world, outline, start, phase, 30.0) for phase in phases
        ]
    assert np.isfinite(hit_s["dynabarn"]).sum() > 5
    assert np.isinf(hit_s["dynabarn_clear"]).all()

    always = replace(simulator_config(DYNABARN).obstacles, clear_start_s=1000.0)
    config = replace(simulator_config(DYNABARN), obstacles=always)
    with refused("an obstacle reaches the start within 1000 s"):
        phase_s(world, config, start, 0)


@pytest.mark.parametrize(
    "row, x", [(1, -3.9), (3, -3.9), (5, -3.825), (27, -0.525), (28, -0.5)]
)
def test_the_papers_start_stays_clear_of_the_side_walls(open_world, row, x):
    path = open_world.path.copy()
    path[:, 0] = row
    assert PAPER_2020.course(replace(open_world, path=path)).start.x == pytest.approx(x)


def test_ends_of_the_challenges_course(open_world):
    course = CHALLENGE.course(open_world)
    assert course.start == Pose2D(-2.25, 3.0, 1.57)
    assert course.goal == Pose2D(-2.25, 13.0, 1.57)


def bent(open_world, columns=30):
    """Return the open world with a path that goes aslant over three columns and then
    straight on.
    """
    rows = [10, 11, 12, *[13] * 27]
    path = np.stack([rows, np.arange(30)], axis=1)
    return World("bent", open_world.grid, path[:columns])


def test_the_papers_start_and_goal_follow_the_path(open_world):
    course = PAPER_2020.course(bent(open_world))
    assert course.start.x == pytest.approx(-4.575 + 0.15 * 10)
    assert course.start.y == pytest.approx(4.075)
    assert course.goal.x == pytest.approx(-4.575 + 0.15 * 13)
    assert course.goal.y == pytest.approx(9.725)
    assert course.start.yaw == course.goal.yaw == math.pi / 2


def test_the_reference_length_is_along_the_path(open_world):
    course = PAPER_2020.course(bent(open_world))
    aslant_m = 3 * 0.15 * math.sqrt(2.0)
    straight_m = 26 * 0.15
    path_m = aslant_m + straight_m
    assert course.path_length_m == pytest.approx(path_m)
    # the path begins 1 m before the start and ends 0.30 m before the goal; both stand
    # beside their ends of it
    assert course.reference_length_m == pytest.approx(1.0 + path_m + 0.30)
    beside = CHALLENGE.course(bent(open_world))
    # from (-2.25, 3) to the first cell at (-3.075, 5.075); from the last at (-2.625,
    # 9.425) to (-2.25, 13)
    to_path_m = math.hypot(0.825, 2.075)
    from_path_m = math.hypot(0.375, 3.575)
    assert beside.reference_length_m == pytest.approx(to_path_m + path_m + from_path_m)
    assert beside.optimal_time_s == pytest.approx(beside.reference_length_m / 2.0)


def test_a_course_needs_two_cells_of_path(open_world):
    assert PAPER_2020.course(bent(open_world, 2)).path_length_m == pytest.approx(
        0.15 * math.sqrt(2.0)
    )
    with refused(r"^world bent: protocol paper2020 needs a path of at least 2 cells$"):
        PAPER_2020.course(bent(open_world, 1))


def ended(open_world, y_m):
    """Return the bent world with a start and a goal of its own, 7 m and so far along
    it.
    """
    return replace(
        bent(open_world), start=Pose2D(-2.5, 7.0, 1.0), goal=Pose2D(-2.5, y_m, 2.0)
    )


def test_a_course_of_the_worlds_own_is_along_its_true_path(open_world):
    world = ended(open_world, 11.0)
    course = KNOWN_MAP.course(world)
    assert (course.start, course.goal) == (world.start, world.goal)
    assert course.path_length_m == world.path_length_m
    # from (-2.5, 7) to the first cell at (-2.925, 5.175); from the last at (-2.475,
    # 9.525) to (-2.5, 11)
    to_path_m = math.hypot(0.425, 1.825)
    from_path_m = math.hypot(0.025, 1.475)
    length_m = to_path_m + world.path_length_m + from_path_m
    assert course.reference_length_m == pytest.approx(length_m)


def test_a_worlds_course_exceeds_the_arrival_distance(open_world):
    with refused(
        r"^world bent: start and goal are 1\.00 m apart, which counts as arrival under"
    ):
        KNOWN_MAP.course(ended(open_world, 8.0))
    assert KNOWN_MAP.course(ended(open_world, 8.001)).goal.y == 8.001


def test_a_course_of_the_worlds_own_is_not_for_maps_that_are_off(open_world):
    with refused(r"^world bent: has its own start and goal, but protocol paper2020"):
        PAPER_2020.course(ended(open_world, 11.0))


@pytest.mark.parametrize(
    "rule, expected",
    [
        (
            PoseRule(x_m=-2.0, x_min_m=-3.0, y_m=3.0),
            PoseRule(x_m=-4.0, x_min_m=-6.0, y_m=6.0 + 2.0 * (3.0 - 5.1)),
        ),
        (
            PoseRule(x_max_m=4.0, anchor_y="start", y_m=10.0),
            PoseRule(x_max_m=8.0, anchor_y="start", y_m=20.0),
        ),
    ],
)
def test_a_rule_in_larger_cells_counts_from_its_anchor(rule, expected):
    assert rule.scaled_to(2.0, 6.0) == expected


def test_distances_for_another_robot_are_in_its_cells(open_world):
    world = replace(open_world, resolution_m=0.2)
    rules = CHALLENGE_2022_03.scaled_to(world, HUSKY)
    # the first column is at 5.2 m
    ((_, y_m),) = world.cell_centers_m(np.array([[0, 0]]))
    assert y_m == pytest.approx(5.2 + 0.1)
    assert rules.start.x_m == pytest.approx(-8.0 / 3.0)
    assert rules.start.y_m == pytest.approx(2.4)
    assert rules.goal.x_m == pytest.approx(0.0)
    assert rules.goal.y_m == pytest.approx(40.0 / 3.0)
    assert rules.clock_start_distance_m == pytest.approx(0.4 / 3.0)
    assert rules.goal_distance_m == pytest.approx(2.0 / 3.0)
    assert rules.reference_speed_mps == pytest.approx(8.0 / 3.0)
    assert rules.limit_s == CHALLENGE_2022_03.limit_s


@pytest.mark.parametrize("protocol", PROTOCOLS.values(), ids=PROTOCOLS)
@pytest.mark.parametrize(
    "chassis, changes",
    [
        (STANDARD_ROBOT.chassis, {"resolution_m": 0.2}),
        (HUSKY, {}),
        (HUSKY, {"resolution_m": 0.2, "corner_m": (0.0, 0.0)}),
    ],
    ids=["jackal", "standard cells", "arena"],
)
def test_rules_are_in_meters_unless_cells_are_larger(
    open_world, protocol, chassis, changes
):
    assert protocol.scaled_to(replace(open_world, **changes), chassis) is protocol


def test_another_robot_starts_clear_of_the_back_wall(open_world):
    """With the rear 0.5 m behind its start, at 5.25 m - 4.5 m, it touches the wall of
    one cell.
    """
    world = replace(open_world, resolution_m=0.25)
    corners = ((-0.5, -0.4), (0.5, -0.4), (0.5, 0.4), (-0.5, 0.4))
    robot = replace(HUSKY, footprint_m=corners)
    near = replace(CHALLENGE, start=PoseRule(y_m=2.4))
    assert near.scaled_to(world, robot).start.y_m == 0.75
    with refused(
        r"^world open: robot husky does not fit between .*, 5\.2 m, at the start of"
    ):
        replace(near, start=PoseRule(y_m=2.39)).scaled_to(world, robot)


def test_only_a_map_that_is_given_can_be_off(open_world):
    assert PAPER_2020.map_offset_m() == -0.15
    for protocol in (
        replace(PAPER_2020, historical_map=False),
        replace(PAPER_2020, map_given=False),
        CHALLENGE,
    ):
        assert protocol.map_offset_m() == 0.0


# A key, and its value under paper2020 and challenge.
PUBLISHED = """
clock_start_distance_m | 0.31622776601683794 | 0.1
goal_distance_m        | 0.31622776601683794 | 1.0
failure_time_s         | 30.0                | 100.0
timeout_time_s         | 30.0                | 100.0
limit_s                | 50.0                | 100.0
goal_period_s          | 0.1                 | 0.0
map_given              | true                | false
movable_obstacles      | true                | false
collision_ends_trial   | false               | true
clock_start_source     | odometry            | truth
goal_source            | odometry            | truth
simulator              | paper2020           | default
planner_preset         | paper2020           | challenge
first_motion_limit_s   | 30.0                | 30.0
control_period_s       | 0.05                | 0.05
"""


@pytest.mark.parametrize("key, paper, challenge", rows_of(PUBLISHED))
def test_the_two_protocols_differ_as_published(key, paper, challenge):
    assert getattr(PAPER_2020, key) == yaml.safe_load(paper)
    assert getattr(CHALLENGE, key) == yaml.safe_load(challenge)


def test_a_protocol_without_a_base_follows_the_paper():
    protocol = Protocol(name="own", start=PoseRule(x_m=-2.0), goal=PoseRule(y_m=5.0))
    ends = {"start": protocol.start, "goal": protocol.goal}
    assert protocol == replace(PAPER_2020, name="own", historical_map=False, **ends)
    assert (protocol.clipped, protocol.look_period_s) == (True, 0.0)


def test_a_pose_counts_from_the_map_and_heads_along_y():
    assert PoseRule().resolve({"map": (0.0, 0.0)}) == Pose2D(0.0, 0.0, math.pi / 2)
    for x_m in (-1000.0, 1000.0):
        assert PoseRule(x_m=x_m).resolve({"map": (0.0, 0.0)}).x == x_m


LIMITS = """
x_m | -1000.0 | 1000.0
x_min_m | -1000.0 | 1000.0
x_max_m | -1000.0 | 1000.0
y_m | -1000.0 | 1000.0
yaw_rad | -3.141592653589793 | 3.141592653589793
clock_start_distance_m | 0.0 | 100.0
goal_distance_m | 0.01 | 100.0
limit_s | 0.1 | 100000.0
first_motion_limit_s | 0.1 | 100000.0
goal_period_s | 0.0 | 1000.0
control_period_s | 0.001 | 10.0
failure_time_s | 0.0 | inf
timeout_time_s | 0.0 | inf
reference_speed_mps | 0.01 | 100.0
look_period_s | 0.0 | 10.0
edge_m | 0.0 | 1000.0
clear_start_s | 0.0 | 1000.0
"""


@pytest.mark.parametrize("name, lowest, highest", rows_of(LIMITS))
def test_numbers_that_a_protocol_may_hold(name, lowest, highest):
    lowest, highest = map(float, (lowest, highest))
    base = PoseRule() if hasattr(PoseRule(), name) else PAPER_2020
    for value in (lowest, min(highest, 1e300)):
        assert getattr(replace(base, **{name: value}), name) == value
    for value in (
        math.nextafter(lowest, -math.inf),
        math.nextafter(highest, math.inf),
        math.nan,
    ):
        with refused(f"^{name} must be (from|at least) "):
            replace(base, **{name: value})


def test_a_pose_may_be_held_at_one_x():
    rule = PoseRule(x_m=5.0, x_min_m=1.0, x_max_m=1.0)
    assert rule.resolve({"map": (0.0, 0.0)}).x == 1.0


def test_a_file_changes_only_the_start_and_goal_it_names(tmp_path):
    path = tmp_path / "near.yaml"
    path.write_text(
        "schema_version: 1\nbase: paper2020\nname: near\nstart: {x_m: 0.1}\ngoal: {y_m: -0.5}\n"
    )
    near = load_protocol(str(path))
    start = replace(PAPER_2020.start, x_m=0.1)
    goal = replace(PAPER_2020.goal, y_m=-0.5)
    assert near == replace(PAPER_2020, name="near", start=start, goal=goal)


def test_a_file_may_stand_alone(tmp_path):
    path = tmp_path / "own.yml"
    path.write_text(
        "schema_version: 1\nname: own\nstart: {x_m: -2}\ngoal: {anchor_x: start, anchor_y: start, y_m: 5}\n"
    )
    assert load_protocol(str(path)) == Protocol(
        name="own",
        start=PoseRule(x_m=-2.0),
        goal=PoseRule(anchor_x="start", anchor_y="start", y_m=5.0),
    )


MISTAKES = r"""
{schema_version: 2, base: paper2020}
    schema_version must be 1, got 2
{schema_version: 1, name: x, base: papre2020}
    did you mean 'paper2020'
{schema_version: 1, name: x, base: paper2020, limt_s: 3}
    'limt_s'; did you mean 'limit_s'
{schema_version: 1, name: x, base: paper2020, limit_s: -3}
    limit_s must be from 0.1
{schema_version: 1, name: x, base: paper2020, limit_s: .nan}
    limit_s must be from 0.1
{schema_version: 1, name: x, base: paper2020, limit_s: long}
    limit_s must be a number, got 'long'
{schema_version: 1, name: x, base: paper2020, start: {anchor_x: ma}}
    anchor_x must be one of
{schema_version: 1, name: x, base: paper2020, start: 3}
    start must be a mapping
{schema_version: 1, name: x, base: paper2020, start: {x_min_m: 1, x_max_m: 0}}
    x_min_m must be at most
{schema_version: 1, base: paper2020, limit_s: 3}
    missing key 'name'
{schema_version: 1, base: challenge, name: challenge, limit_s: 3}
    is built in with another limit_s;
{schema_version: 1, base: challenge, name: paper2020}
    'paper2020' is built in with another start; choose
{schema_version: 1, name: x}
    missing key 'goal' (or a base: challenge, dynabarn, dynabarn_clock, dynabarn_clear, known_map
{schema_version: 1, name: x, goal: {}}
    missing key 'start'
{schema_version: 1, name: x, base: [a]}
    unknown base
{schema_version: 1, name: x, base: {a: 1}}
    unknown base
{schema_version: 1, name: x, base: 3}
    unknown base
{schema_version: 1, base: challenge, name: ' '}
    name must be printable text, got ' '
{schema_version: 1, base: challenge, name: "\0"}
    name must be printable text, got
"""


@pytest.mark.parametrize("text, complaint", answers_of(MISTAKES))
def test_what_is_wrong_with_a_file_is_told_in_one_line(tmp_path, text, complaint):
    path = tmp_path / "wrong.yaml"
    path.write_text(text)
    with refused(rf"^.*wrong\.yaml: .*{re.escape(complaint)}"):
        load_protocol(str(path))


@pytest.mark.parametrize(
    "name, complaint",
    [("papper", "did you mean 'paper2020'"), ("no.yaml", "No such file")],
)
def test_unknown_protocols(name, complaint):
    with refused(complaint):
        load_protocol(name)


@pytest.mark.parametrize("key", ["anchor_x", "anchor_y"])
def test_a_start_cannot_be_counted_from_itself(open_world, key):
    with refused(f"^{key}: a start cannot be relative to 'start'"):
        Protocol(start=PoseRule(**{key: "start"})).course(open_world)


def test_names_lead_to_the_protocols():
    assert {name: load_protocol(name) for name in PROTOCOLS} == PROTOCOLS


def test_the_challenge_by_its_years(open_world):
    years = (CHALLENGE, CHALLENGE_2022, CHALLENGE_2022_03)
    starts = [protocol.course(open_world).start.x for protocol in years]
    assert starts == [-2.25, -2.0, -2.0]
    assert [protocol.goal_distance_m for protocol in years] == [1.0, 1.0, 0.5]
    metrics = [protocol.metric for protocol in years]
    assert metrics == ["challenge", "challenge_2022", "challenge"]
    assert [protocol.clipped for protocol in years] == [True, True, False]
    assert not {"clipped", "look_period_s"} & as_dict(CHALLENGE).keys()
