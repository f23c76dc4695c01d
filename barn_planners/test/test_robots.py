"""Planners for robots other than the Jackal: the rules by which presets change, and footprints with corners."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused

from barn_planners.costmap import kernels
from barn_planners.costmap.config import (
    CostmapConfig,
    format_footprint,
    parse_footprint,
)
from barn_planners.costmap.costmap import RollingCostmap
from barn_planners.registry import planner_config, planner_entry, planner_names
from barn_planners.robots import fit_parameters, lidar_mount_changes, robot_scale
from barn_worlds.base.config import as_dict, fields_of
from barn_worlds.base.types import ORIGIN, Scan
from barn_worlds.geometry.polygon import nearest_side_m, offset
from barn_worlds.robots.files import load_robot

JACKAL, HUSKY, ROUND = (load_robot(name) for name in ("jackal", "husky", "turtlebot4"))
BURGER = load_robot("turtlebot3_burger")
BUILT_IN = ["dwa", "eband", "gap", "mppi", "policy"]
PENTAGON = ((0.5, 0.0), (0.2, 0.3), (-0.3, 0.2), (-0.3, -0.25), (0.1, -0.3))


def configured(name, robot, preset="", **overrides):
    preset = preset or next(iter(planner_entry(name).presets))
    return planner_config(name, preset, fit_parameters(name, preset, overrides, robot))


def changes(name, robot, preset):
    """Yield each key of a preset, its value there and for a robot."""
    fields = fields_of(planner_entry(name).presets[preset])
    fields_of_robot = fields_of(configured(name, robot, preset))
    for (key, _, before), (_, _, value) in zip(fields, fields_of_robot, strict=True):
        yield key, before, value


def approx(value):
    return pytest.approx(value, rel=1e-5)


def is_inside(corners, point):
    """Tell whether a point is left of every side of a polygon."""
    sides = np.roll(corners, -1, axis=0) - corners
    away = np.array(point) - corners
    return (sides[:, 0] * away[:, 1] > sides[:, 1] * away[:, 0]).all()


@pytest.mark.parametrize("name", BUILT_IN)
def test_nothing_changes_for_the_jackal(name):
    assert name in planner_names()
    for preset, config in planner_entry(name).presets.items():
        assert fit_parameters(name, preset, {}, JACKAL) == {}
        assert as_dict(configured(name, JACKAL, preset)) == as_dict(config)


@pytest.mark.parametrize("name", [name for name in BUILT_IN if name != "policy"])
def test_a_jackal_by_another_name_is_driven_as_the_jackal(name):
    """The rules themselves lead to the presets, but for figures of planners without a costmap and a quirk of DWA's."""
    other = replace(JACKAL, chassis=replace(JACKAL.chassis, name="other"))
    for preset in planner_entry(name).presets:
        for key, before, value in changes(name, other, preset):
            if key.endswith(("turning_radius_m", "dwa.obstacle_weight")):
                continue
            expected = approx(before) if isinstance(value, float) else before
            assert value == expected, key


@pytest.mark.parametrize("robot", [HUSKY, ROUND], ids=lambda robot: robot.name)
@pytest.mark.parametrize("name", [name for name in BUILT_IN if name != "policy"])
def test_sizes_speeds_and_limits_follow_the_robot(name, robot):
    scale = robot_scale(robot)
    drive = robot.drive
    lengths = (
        "look_ahead_m",
        "resolution_m",
        "xy_tolerance_m",
        "obstacle_range_m",
        "path_ahead_m",
    )
    for preset, config in planner_entry(name).presets.items():
        for key, before, value in changes(name, robot, preset):
            if key.endswith(("max_speed_mps", "escape_speed_mps")):
                scaled = scale * abs(before)
                assert abs(value) == approx(min(scaled, drive.max_speed_m_s))
            elif key.endswith("max_turn_radps"):
                assert value == approx(min(before, drive.max_yaw_rate_rad_s))
            elif key.endswith("_mps2"):
                assert value <= drive.max_acceleration_m_s2
            elif key.endswith(lengths):
                assert value == approx(scale * before)
            elif key.endswith("window_period_s"):
                wanted = scale * config.dwa.acceleration_mps2
                slower = max(1.0, wanted / drive.max_acceleration_m_s2)
                assert value == approx(slower * before)
            elif key.startswith(("guard.", "tracker.")) or key.endswith("_s"):
                assert value == before


@pytest.mark.parametrize("robot", [HUSKY, ROUND, BURGER], ids=lambda robot: robot.name)
@pytest.mark.parametrize("costmap", ["local_costmap", "global_costmap"])
def test_padded_mppi_footprints_hold_the_robot(robot, costmap):
    layer = getattr(configured("mppi", robot), costmap)
    assert layer.inscribed_m < layer.inflation_radius_m
    for point in robot.chassis.hull_m:
        assert is_inside(layer.padded_outline_m, point)
    assert bool(layer.footprint) == (robot is not HUSKY)


def test_what_the_user_sets_wins():
    config = configured("dwa", HUSKY, "challenge", **{"dwa.max_speed_mps": 0.3})
    assert config.dwa.max_speed_mps == 0.3
    half_length_m = config.local_costmap.footprint_half_length_m
    assert half_length_m == approx(0.21 * 0.495 / 0.254)


def test_the_shipped_policy_is_for_the_jackal_alone():
    message = r"^planner 'policy': the shipped policy was trained only for the Jackal"
    for name in ("", "moving"):
        with refused(message):
            configured("policy", HUSKY, policy_path=name)
    safety = configured("policy", HUSKY, policy_path="mine.npz").safety
    assert (safety.half_length_m, safety.half_width_m) == (0.495, 0.335)


def test_gap_inflates_between_inscribed_and_circumscribed():
    assert configured("gap", ROUND).robot_radius_m == pytest.approx(0.171)
    assert configured("gap", ROUND).turning_radius_m == pytest.approx(0.171)
    assert 0.335 < configured("gap", HUSKY).robot_radius_m < math.hypot(0.495, 0.335)


def test_lidar_is_where_the_robot_has_it():
    changes = lidar_mount_changes(planner_entry("gap").presets["default"], ROUND.lidar)
    assert changes == {"lidar_x_m": -0.04, "lidar_yaw_rad": 1.5708}
    assert (
        lidar_mount_changes(planner_entry("dwa").presets["challenge"], JACKAL.lidar)
        == {}
    )


def test_outlines_as_text():
    assert parse_footprint(format_footprint(PENTAGON)) == PENTAGON


@pytest.mark.parametrize(
    "text",
    [
        "",
        "x",
        "[[0, 1]]",
        "[[1, 1], [1, -1], [-1, 0]]",
        "[[1, 1], [2, 1], [1, 2]]",
        "[[1, 2, 3]]",
        "7",
    ],
)
def test_other_text_is_no_outline(text):
    assert parse_footprint(text) is None


@settings(max_examples=50, deadline=None)
@given(st.floats(0.05, 2.0), st.floats(0.05, 2.0), st.floats(0.0, 0.5))
def test_padding_moves_every_side_outwards(half_x, half_y, by_m):
    signs = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
    half = np.array([half_x, half_y])
    padded = offset(tuple(map(tuple, signs * half)), by_m)
    np.testing.assert_allclose(padded, signs * (half + by_m), atol=1e-12)
    away_m = nearest_side_m(offset(PENTAGON, by_m))
    assert away_m == pytest.approx(nearest_side_m(PENTAGON) + by_m)


def test_a_costmap_clears_and_checks_the_outline():
    footprint = format_footprint(PENTAGON)
    config = CostmapConfig(footprint=footprint, footprint_padding_m=0.0)
    costmap = RollingCostmap(config)
    assert config.inscribed_m == pytest.approx(nearest_side_m(PENTAGON))
    assert config.circumscribed_m == pytest.approx(0.5)
    here = ORIGIN
    ahead = Scan(0, np.full(9, 0.8, np.float32), -0.2, 0.05, 0.1, 30.0)
    costmap.update(here, ahead, here)
    cells = kernels.footprint_cells(costmap.outline, costmap.grid, costmap.costs.shape)
    columns = cells[:, 1]
    ends = np.array([columns.min(), columns.max() + 1])
    assert costmap.origin_x + 0.05 * ends == pytest.approx([-0.3, 0.5], abs=0.06)
    assert costmap.has_room(0.0, 0.0, 0.0)
    assert not costmap.has_room(0.3, 0.0, 0.0)  # its tip is in what was seen
    assert costmap.has_room(0.3, 0.0, math.pi)


def test_dwa_counts_edges_of_other_robots_by_distance():
    for preset, config in planner_entry("dwa").presets.items():
        counted = 0.0 if config.dwa.distances_in_metres else config.dwa.obstacle_weight
        assert configured("dwa", HUSKY, preset).dwa.obstacle_weight == counted
        assert configured("dwa", ROUND, preset).dwa.obstacle_weight == counted


@pytest.mark.parametrize("name", ["dwa", "eband", "mppi"])
def test_global_plans_keep_the_robots_side_distance(name):
    """base_link of a Burger is at its axle, near the front; the outline alone would give 0.071 m."""
    config = configured(name, BURGER)
    layer = config.global_costmap
    width_m = np.ptp(layer.padded_outline_m[:, 1])
    assert layer.inscribed_m == pytest.approx(width_m / 2.0, rel=1e-3)
    assert layer.inflation_radius_m > layer.inscribed_m
    local = config.local_costmap
    assert local.inscribed_m == pytest.approx(nearest_side_m(local.padded_outline_m))
    for robot in (HUSKY, ROUND):
        assert configured(name, robot).global_costmap.inscribed_radius_m == 0.0
