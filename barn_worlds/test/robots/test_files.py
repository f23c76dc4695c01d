"""Robots as data: what comes with the suite, and what a file must and must not say."""

import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from refusals import refused

from barn_worlds.base.config import as_dict
from barn_worlds.geometry.polygon import area, contains, convex_hull, regular_polygon
from barn_worlds.robots.files import ROBOTS, find_robot_files, load_robot, robot_yaml
from barn_worlds.robots.parts import DriveConfig, LidarConfig, OdometryConfig
from barn_worlds.robots.urdf import LARGEST_URDF_BYTES, read_chassis

BURGER = find_robot_files()["turtlebot3_burger"]
JACKAL = find_robot_files()["jackal"]
HUSKY = find_robot_files()["husky"]


@pytest.fixture
def changed(tmp_path):
    """Write a robot's file with changes by dotted key (None removes one) and return its path."""

    def write(changes, source=HUSKY):
        content = yaml.safe_load(source.read_text("utf-8"))
        for name, value in changes.items():
            section, _, key = name.rpartition(".")
            place = content[section] if section else content
            place[key] = value
            if value is None:
                del place[key]
        path = tmp_path / "mine.yaml"
        path.write_text(yaml.safe_dump(content), "utf-8")
        return path

    return write


@pytest.mark.parametrize("name", list(ROBOTS))
def test_robots_of_the_suite_say_where_their_numbers_are_from(name):
    robot = load_robot(name)
    assert robot.name == name
    assert robot.summary
    assert {"chassis", "drive", "lidar", "odometry", "wheel_friction"} == set(
        robot.sources
    )


# Length and width in m, and the footprint's width in cells.
SIZES = """
husky: [0.990, 0.670, 7]
jackal: [0.508, 0.430, 5]
jackal_measured: [0.508, 0.430, 5]
scout_mini: [0.612, 0.580, 5]
turtlebot3_burger: [0.138, 0.178, 3]
turtlebot3_waffle: [0.281, 0.306, 3]
turtlebot4: [0.342, 0.342, 3]
"""


def test_the_sizes_are_those_of_the_data_sheets():
    sizes = yaml.safe_load(SIZES)
    assert list(ROBOTS) == list(sizes)
    for name, size in sizes.items():
        robot = ROBOTS[name]
        cells = robot.footprint_cells(0.15)
        assert [round(robot.length_m, 9), round(robot.width_m, 9), cells] == size


def test_the_jackal_has_the_defaults_and_the_body_of_its_urdf():
    robot = load_robot("jackal")
    parts = (robot.drive, robot.lidar, robot.odometry)
    assert parts == (DriveConfig(), LidarConfig(), OdometryConfig())
    chassis = robot.chassis
    assert chassis.mass_kg == pytest.approx(16.523 + 4 * 0.477)
    assert chassis.wheels_m[0] == (0.131, 0.187795, 0.0345)
    assert (chassis.wheel_radius_m, chassis.base_height_m) == (0.098, 0.0635)


def test_the_measured_jackal_has_the_published_errors_and_nothing_else():
    jackal = load_robot("jackal")
    measured = load_robot("jackal_measured")
    # Firmware 1.3.0; standard deviation of the UST-10LX; 95 mm against 98 mm.
    drive = replace(jackal.drive, turn_deadband_rad_s=0.5, command_latency_s=0.08)
    assert measured.drive == drive
    assert measured.lidar == replace(jackal.lidar, noise_m=0.03)
    assert measured.odometry == replace(jackal.odometry, wheel_radius_error=0.03)
    assert measured.wheel_friction == jackal.wheel_friction


def test_new_keys_of_drive_and_lidar_are_left_out_while_unused():
    assert not {"motor_lag_s", "max_reverse_m_s"} & {*as_dict(DriveConfig())}
    assert not {"mount_y_m", "mount_yaw_rad"} & {*as_dict(LidarConfig())}


@pytest.mark.parametrize(
    "name, message",
    [
        ("husk", "did you mean 'husky'"),
        ("", "known: husky, jackal"),
        ("a/b", "name a file"),
    ],
)
def test_an_unknown_robot_is_answered_with_the_near_one(name, message):
    with refused("^unknown robot .*" + message):
        load_robot(name)


WRONG = yaml.safe_load(r"""
clockwise: [{chassis.footprint_m: [[1, -1], [-1, -1], [-1, 1], [1, 1]]}, footprint_m must run counter-clockwise]
two corners: [{chassis.footprint_m: [[1, 1], [-1, 1]]}, footprint_m must have 3 to 64 corners]
not around base_link: [{chassis.footprint_m: [[3, 1], [2, 1], [2, 0.5]]}, 'must have base_link, the origin, inside']
no number: [{chassis.footprint_m: [[.nan, 1], [-1, 1], [-1, -1]]}, footprint_m must be within 20 m]
not a list: [{chassis.footprint_m: 3}, chassis.footprint_m]
round and not: [{chassis.footprint_radius_m: 0.3}, one of footprint_m and footprint_radius_m must be given]
neither: [{chassis.footprint_m: null}, one of footprint_m and footprint_radius_m must be given]
negative mass: [{chassis.mass_kg: -5.0}, 'chassis.mass_kg must be from 0.01 to 10000 kg, got -5.0']
inertia of no body: [{chassis.inertia_kg_m2: [1.0, 1.0, 2.1]}, none larger than the other two together]
two moments: [{chassis.inertia_kg_m2: [1.0, 1.0]}, chassis.inertia_kg_m2]
falls over: [{chassis.centre_of_mass_m: [0.3, 0.0, 0.1]}, or the robot falls over]
mass in the ground: [{chassis.centre_of_mass_m: [0.0, 0.0, -0.2]}, centre_of_mass_m must be above the ground]
wheels in the air: [{chassis.wheel_radius_m: 0.1}, 'wheel_z_m must let the wheels touch the ground, \+0.065 m away']
wheels outside: [{chassis.wheel_width_m: 0.12}, footprint_m must enclose the wheels]
upside down: [{chassis.body_height_m: 0.1}, body_height_m must be above ground_clearance_m = 0.13]
one axle: [{chassis.wheelbase_m: 0.0}, 'above 0 for skid_steer; kind is skid_steer, got 0.0']
casters: [{chassis.casters_m: [[0.1, 0.1]]}, casters_m must say where .*; skid_steer has none]
lidar in the ground:
  [{lidar.mount_z_m: -0.2}, 'lidar.mount_z_m must be above the ground, -0.13228 m in base_link, got -0.2']
unknown key: [{chassis.mass: 5.0}, unknown key 'chassis.mass'; did you mean 'chassis.mass_kg']
unknown key of the drive: [{drive.max_sped_m_s: 1.0}, did you mean 'drive.max_speed_m_s']
unknown section: [{engine: {}}, unknown key 'engine']
unknown kind: [{chassis.kind: ackermann}, 'chassis.kind must be one of skid_steer, differential, got']
no mass: [{chassis.mass_kg: null}, missing key 'chassis.mass_kg']
no speed: [{drive.max_speed_m_s: null}, missing key 'drive.max_speed_m_s']
no lidar: [{lidar: null}, missing key 'lidar']
no multiplier: [{drive.wheel_separation_multiplier: null}, missing key 'drive.wheel_separation_multiplier']
no name: [{name: null}, name must be the name of the robot]
two lidars: [{lidar: [{}, {}]}, lidar must be a mapping]
no chassis: [{chassis: 3}, chassis must be a mapping]
version: [{schema_version: 2}, 'schema_version must be 1, got 2']
URDF elsewhere: [{urdf: ../jackal.urdf}, urdf must name a file beside it]
no caster: [{chassis.casters_m: null}, casters_m must say where the casters, turtlebot3_burger]
two axles: [{chassis.wheelbase_m: 0.2}, wheelbase_m must be 0 for a differential drive, turtlebot3_burger]
falls forward: [{chassis.centre_of_mass_m: [0.01, 0.0, 0.07]}, or the robot falls over, turtlebot3_burger]
on the edge: [{chassis.centre_of_mass_m: [0.0, 0.0, 0.07]}, by 1 mm at least, turtlebot3_burger]
no URDF: [{urdf: none.urdf}, 'none\.urdf: No such file']
""")


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_file_is_answered_in_one_line(changed, what):
    changes, message, *names = WRONG[what]
    path = changed(changes, *[find_robot_files()[name] for name in names])
    with refused(f"^{path.parent}.*{message}"):
        load_robot(path)


def test_keys_in_the_yaml_win_over_the_urdf(changed, tmp_path):
    shutil.copy(JACKAL.with_suffix(".urdf"), tmp_path / "mine.urdf")
    changes = {"urdf": "mine.urdf", "chassis.mass_kg": 30.0}
    jackal = load_robot("jackal")
    heavy = replace(jackal.chassis, mass_kg=30.0)
    assert load_robot(changed(changes, JACKAL)) == replace(jackal, chassis=heavy)


TURNED = """<robot name="r">
  <link name="base_footprint"/><link name="base_link"/>
  <joint name="a" type="fixed"><parent link="base_footprint"/><child link="base_link"/><origin xyz="0 0 0.2"/></joint>
  <link name="bar"><inertial><origin xyz="0 1 0"/><mass value="2"/>
    <inertia ixx="1" iyy="2" izz="2.5" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="b" type="fixed"><parent link="base_link"/><child link="bar"/>
    <origin xyz="1 0 0" rpy="0 0 1.5707963267948966"/></joint>
  <link name="wheel_left"><collision><geometry><cylinder radius="0.1" length="0.02"/></geometry></collision></link>
  <joint name="c" type="continuous"><parent link="base_link"/><child link="wheel_left"/>
    <axis xyz="0 0 1"/><origin xyz="0.3 0.2 -0.1" rpy="-1.57 0 0"/></joint>
  <link name="wheel_right"/>
  <joint name="d" type="continuous"><parent link="base_link"/><child link="wheel_right"/>
    <axis xyz="0 1 0"/><origin xyz="0.3 -0.2 -0.1"/></joint>
</robot>"""

AXLE = '<joint name="d" type="continuous"><parent link="base_link"/>'
HINGE = """<link name="hinge"/><joint name="e" type="revolute">
<parent link="base_link"/><child link="hinge"/><axis xyz="0 0 2"/></joint>
<joint name="d" type="continuous"><parent link="hinge"/>"""
# As AgileX Hunter 2 has it: the axis is wrong.
STEERED = HINGE.replace("0 0 2", "0 1 0").replace("hinge", "steer_right")
BALL = """<link name="wheel_right"><collision><geometry><sphere radius="0.11"/></geometry>
</collision></link>"""


@pytest.mark.parametrize(
    "change, message",
    [
        (("cylinder radius", "mesh filename"), "gives mass_kg, .*; no size of the wheels"),
        (('cylinder radius="0.1" length="0.02"', 'sphere radius="0.1"'), "'chassis.wheel_width_m'; .*; no width of"),
        (("continuous", "revolute"), "no wheels: no continuous joint turns wheel_left, wheel_right"),
        (('"wheel_', '"roller_'), "no link has wheel, tire or tyre in its name"),
        (('"wheel_left"', '"swivel_wheel"'), "wheel 'wheel_right' has no partner on the other side"),
        (("</robot>", "<x:y xmlns:x='http://ros.org/wiki/xacro'/></robot>"), "needs xacro, which is not installed"),
        (('-0.2 -0.1"/>', '-0.2 -0.1" rpy="0 0 1"/><axis xyz="0 1 0"/>'), "turns about .*0.54, 0.0], not about y"),
        ((AXLE, HINGE), "'wheel_right' is steered, by the joint of 'hinge'"),
        ((AXLE, STEERED), "'wheel_right' is steered, by the joint of 'steer_right'"),
        (('<link name="wheel_right"/>', BALL), r"wheel_left, .* have radius \[0.1, 0.11\] m"),
        (('"base_link"', '"my_base_link"'), "must have a link base_link, .*; did you mean 'my_base_link'"),
    ],
)  # fmt: skip
def test_what_a_urdf_gives_and_lacks_is_said(changed, change, message, monkeypatch):
    monkeypatch.setenv("PATH", "")
    keys = (
        "mass_kg",
        "centre_of_mass_m",
        "inertia_kg_m2",
        "wheel_radius_m",
        "wheel_width_m",
        "track_m",
        "wheel_z_m",
    )
    path = changed(
        {"urdf": "r.urdf"} | {f"chassis.{key}": None for key in keys}, BURGER
    )
    (path.parent / "r.urdf").write_text(TURNED.replace(*change), "utf-8")
    with refused(f"^{path.parent}.*{message}"):
        load_robot(path)


def test_wheels_are_known_in_any_case_and_as_tires_or_mecanum(tmp_path, caplog):
    path = tmp_path / "r.urdf"
    # xacro keeps comments, which may hold its tags.
    text = TURNED.replace("<link", "<!-- <xacro:x> --><link", 1)
    path.write_text(text.replace('"wheel_', '"Mecanum_tire_'), "utf-8")
    assert read_chassis(path)[0]["track_m"] == 0.4
    assert "has 'Mecanum' in it; its wheels are taken for plain" in caplog.text


HUB = '<collision><geometry><sphere radius="0.02"/></geometry></collision>'


def test_a_wheel_is_where_its_collision_is_not_where_its_joint_is(tmp_path):
    # As AgileX LIMO has it. The hub is no tire.
    path = tmp_path / "r.urdf"
    text = TURNED.replace("rpy=", "x=").replace("0 0 1", "0 1 0")
    text = text.replace("-0.2 -0.1", "-0.23 -0.1")
    tire = HUB + '<collision><origin xyz="0 0.03 0"/>'
    path.write_text(text.replace("<collision>", tire), "utf-8")
    wheels = read_chassis(path)[0]
    assert wheels["track_m"] == pytest.approx(0.46)
    assert wheels["wheel_radius_m"] == 0.1


def test_xacro_runs_where_it_is_installed(tmp_path, monkeypatch):
    path = tmp_path / "r.urdf.xacro"
    path.write_text(TURNED, "utf-8")
    program = tmp_path / "xacro"
    program.write_text('#!/bin/sh\n/bin/cat "$1"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert read_chassis(path)[0]["mass_kg"] == 2.0
    program.write_text("#!/bin/sh\necho no such macro >&2\nexit 2\n")
    with refused(f"^{path}: .*xacro failed: no such macro"):
        read_chassis(path)
    lines = "warning: old error: no package 'x'\nwhen processing file: y"
    program.write_text(f"#!/bin/sh\necho {lines!r} >&2\nexit 2\n")
    with refused(
        "xacro failed: no package 'x'; .*run `xacro r.urdf.xacro > robot.urdf`"
    ):
        read_chassis(path)


def test_links_of_a_urdf_are_placed_and_turned_by_their_joints(tmp_path):
    path = tmp_path / "r.urdf"
    path.write_text(TURNED, "utf-8")
    chassis, lack = read_chassis(path)
    assert lack == ""
    assert chassis["mass_kg"] == 2.0
    middle = pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    assert chassis["centre_of_mass_m"] == middle  # 1 ahead, 1 back
    assert chassis["inertia_kg_m2"] == pytest.approx((2.0, 1.0, 2.5))
    lengths_m = {
        "base_height_m": 0.2,
        "track_m": 0.4,
        "wheelbase_m": 0.0,
        "axle_x_m": 0.3,
        "wheel_radius_m": 0.1,
        "wheel_width_m": 0.02,
        "wheel_z_m": -0.1,
    }
    assert {name: chassis[name] for name in lengths_m} == pytest.approx(lengths_m)


@pytest.mark.parametrize(
    "text, message",
    [
        ("<robot><link/></robot>", "missing or wrong: 'name'"),
        ("<robot", "unclosed token"),
        (
            '<!DOCTYPE r [<!ENTITY a "b">]><robot>&a;</robot>',
            "entities are not allowed",
        ),
        ("<robot name='r'><link name='x'/></robot>", "must have a link base_link"),
        ("<robot name='r'><link name='base_link'/></robot>", "no link has a mass"),
        (TURNED + " " * LARGEST_URDF_BYTES, "more than the allowed"),
    ],
)
def test_a_wrong_urdf_is_answered_in_one_line(tmp_path, text, message):
    path = tmp_path / "r.urdf"
    path.write_text(text, "utf-8")
    with refused(f"^{path}.*{message}"):
        read_chassis(path)


MISTAKES = """
- ['"bar"', '"wheel_left"', link 'wheel_left' must occur once]
- [child link="bar", child link="wheel_left", on at most one joint]
- [value="2", value="inf", "value of <mass> must be a finite number, got 'inf'"]
- [value="2", value="-2", a mass is below 0]
- [radius=", radius="1_, radius of <cylinder> must be a finite number]
- [length=", length="1_, length of <cylinder> must be a finite number]
- [ixx=", ixx="1_, ixx of <inertia> must be a finite number]
- [ixz=, other=, "ixz of <inertia> must be a finite number, got None"]
- [origin xyz="0 1 0", origin xyz="0 1", xyz of <origin> must be 3 finite numbers]
- [<axis xyz="0 1 0"/>, "", "'wheel_right' turns about .1"]
- [axis xyz="0 1 0", axis xyz="0 0 0", "'wheel_right' turns about .0"]
- ['"base_footprint"/><child', '"footprint"/><child', no link 'footprint']
- [child link="bar", child link="rod", "no link 'rod'; known"]
- [<link, <link name="x"/><link, "one tree, but x, base_footprint have"]
- [<mass value="2"/>, "", without <mass>]
- [</robot>, <joint><child link="x"/></joint></robot>, without <parent>]
- [<parent link="base_footprint"/>, <parent link="bar"/>, joints make a ring]
"""


@pytest.mark.parametrize("correct, wrong, message", yaml.safe_load(MISTAKES))
def test_a_mistake_in_a_urdf_is_named(tmp_path, correct, wrong, message):
    path = tmp_path / "r.urdf"
    path.write_text(TURNED.replace(correct, wrong, 1), "utf-8")
    with refused(f"^{path}.*{message}"):
        read_chassis(path)


def test_axles_are_where_the_kind_of_drive_has_them():
    husky, burger = (
        load_robot(name).chassis for name in ("husky", "turtlebot3_burger")
    )
    axles_m = [x for x, _, _ in husky.wheels_m]
    assert axles_m == pytest.approx([0.256, 0.256, -0.256, -0.256])
    assert [x for x, _, _ in burger.wheels_m] == [0.0, 0.0]
    assert replace(husky, axle_x_m=0.01).wheels_m[0][0] == pytest.approx(0.266)


def test_a_round_robot_is_a_polygon_around_its_circle():
    corners = load_robot("turtlebot4").chassis.hull_m
    assert len(corners) == 16
    assert max(x for x, _ in corners) == pytest.approx(0.171)
    assert all(math.hypot(*corner) >= 0.171 for corner in corners)


def test_the_hull_of_an_l_shape_leaves_out_its_dent():
    corners = (
        (1.0, 1.0),
        (-1.0, 1.0),
        (-1.0, -1.0),
        (0.2, -1.0),
        (0.2, 0.2),
        (1.0, 0.2),
    )
    shape = replace(load_robot("husky").chassis, footprint_m=corners)
    assert set(shape.hull_m) == set(corners) - {(0.2, 0.2)}
    assert shape.extent_m == (-1.0, -1.0, 1.0, 1.0)


def test_polygons():
    square = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))
    assert area(square) == 4.0
    assert area(square[::-1]) == -4.0
    assert contains(square, (1.0, 0.5))
    assert not contains(square, (1.1, 0.5))
    rng = np.random.default_rng(5)
    points = list(map(tuple, rng.normal(size=(60, 2)).tolist()))
    around = convex_hull(points)
    assert area(around) > 0.0
    assert set(around) <= set(points)
    assert all(contains(around, point) for point in points)
    assert area(regular_polygon(1.0, 400)) == pytest.approx(math.pi, rel=1e-4)


def test_a_path_and_its_text_name_the_same_robot(changed):
    path = changed({"name": "mine"})
    assert load_robot(path) == load_robot(str(path))
    assert load_robot(Path(path)).name == "mine"


@pytest.mark.parametrize("name", list(ROBOTS))
def test_a_robot_that_is_written_is_read_as_the_same(tmp_path, name):
    file = tmp_path / "robot.yaml"
    file.write_text(robot_yaml(ROBOTS[name]), "utf-8")
    assert load_robot(file) == ROBOTS[name]
