"""The self-test drive: all robots of the suite pass.

It detects a robot that does not drive as it should.
"""

import json
import re
from dataclasses import replace

import pytest
from check_robot import LARGEST_DEVIATION, main, self_test
from click.testing import CliRunner
from planar import GRAVITY_M_S2, Planar
from refusals import refused
from repository import ROOT

from barn_worlds.robots.files import ROBOTS, find_robot_files, load_robot

PAGE = ROOT / "docs/robots.md"


def change_robot(name, part, **values):
    robot = load_robot(name)
    return replace(robot, **{part: replace(getattr(robot, part), **values)})


@pytest.mark.parametrize("name", list(ROBOTS))
def test_robots_drive_as_theory_says(name):
    """The page's cells hold deviations in % in the order in which they are measured.

    There are one or two for a robot.
    """
    driven = self_test(load_robot(name))
    assert len(driven) >= 8
    for measurement in driven:
        assert measurement.passed, measurement
    assert LARGEST_DEVIATION == 0.03
    rows = re.findall(rf"(?m)^\| `{name}` \|(.*)\|$", PAGE.read_text("utf-8"))
    (cells,) = (row for row in rows if row.count("|") == 6)
    words = re.split(r"[;|]", cells)
    printed = [float(word) for word in words if word.strip() != "none"]
    deviations = [100.0 * measurement.deviation for measurement in driven]
    expected = deviations[:-4] + deviations[-4::2] + deviations[-3::2]
    assert printed == pytest.approx(expected, abs=0.06)


def test_what_it_prints(tmp_path):
    text = find_robot_files()["turtlebot4"].read_text("utf-8")
    mine = tmp_path / "mine.yaml"
    late = tmp_path / "late.yaml"
    mine.write_text(text, "utf-8")
    # shorter than a control period
    late.write_text(text.replace("command_timeout_s: 0.5", "command_timeout_s: 0.01"))

    def output(code, *words):
        ended = CliRunner().invoke(main, list(map(str, words)))
        assert ended.exit_code == code
        return ended.output

    passed = output(0, mine)
    first, *_, last = passed.splitlines()
    size = "0.342 x 0.342 x 0.351 m, 3.945 kg"
    assert first == f"turtlebot4: differential, {size}, up to 0.46 m/s, 1.9 rad/s"
    assert "stop turning" in passed and "arc to the right" in passed
    verdict = r"turtlebot4 drives as theory says: at most \d\.\d% off, 3% allowed"
    assert re.fullmatch(verdict, last)
    failed = output(1, late)
    assert "% !" in failed and "does not drive as theory says in" in failed
    assert json.loads(output(0, mine, "--json"))["passed"] is True
    assert json.loads(output(1, late, "--json"))["passed"] is False
    assert "none.yaml: No such file" in CliRunner().invoke(main, ["none.yaml"]).output


@pytest.mark.parametrize("name", ["turtlebot4", "turtlebot3_waffle"])
def test_with_lag_and_little_grip_too(name):
    robot = change_robot(name, "drive", motor_lag_s=0.15, max_acceleration_m_s2=3.0)
    driven = self_test(replace(robot, wheel_friction=0.3))
    assert all(measurement.passed for measurement in driven)


@pytest.mark.parametrize("name", ["max_speed_m_s", "max_yaw_rate_rad_s"])
def test_a_robot_that_may_not_drive_is_refused(name):
    with refused(f"^robot turtlebot4: drive.{name} must be above 0"):
        self_test(change_robot("turtlebot4", "drive", **{name: 0.0}))


@pytest.mark.parametrize("friction", [0.0, 1e-4])
def test_a_robot_that_does_not_get_going_is_refused(friction):
    with refused(
        r"^robot husky: its accelerations and wheel_friction .* within 120 s, it takes"
    ):
        self_test(replace(load_robot("husky"), wheel_friction=friction))


def test_a_stop_is_latency_ramp_and_lag():
    robot = change_robot("turtlebot4", "drive", motor_lag_s=0.2, command_latency_s=0.1)
    speed = 0.46
    ramp = robot.drive.max_acceleration_m_s2
    by_hand = speed * (0.1 + 0.2) + 0.5 * speed**2 / ramp
    assert Planar(robot).stopping_m(speed) == pytest.approx(by_hand, rel=0.002)
    assert Planar(robot).go(speed, 5.0)[1] == pytest.approx(
        speed * 5.0 - by_hand, rel=0.002
    )


def test_grip_is_what_the_driven_wheels_carry():
    assert Planar(load_robot("jackal")).grip_m_s2(-1) == pytest.approx(
        0.5 * GRAVITY_M_S2
    )
    robot = load_robot("turtlebot4")
    ((caster_m, _),) = robot.chassis.casters_m
    level = replace(robot.chassis, centre_of_mass_m=(0.5 * caster_m, 0.0, 1e-6))
    grip_m_s2 = Planar(replace(robot, chassis=level)).grip_m_s2(1)
    # half of the weight is on the driven axle, none moves
    weight_m_s2 = robot.wheel_friction * GRAVITY_M_S2
    assert grip_m_s2 / weight_m_s2 == pytest.approx(0.5, rel=1e-3)
    # the caster is in front
    assert Planar(robot).grip_m_s2(1) > Planar(robot).grip_m_s2(-1)


def test_a_skid_steer_robot_of_no_length_turns_as_its_wheels_say():
    robot = load_robot("scout_mini")
    short = replace(
        robot,
        chassis=replace(robot.chassis, wheelbase_m=0.01),
        drive=replace(robot.drive, wheel_separation_multiplier=1.0),
    )
    assert Planar(short).arc(0.0, 1.0) == pytest.approx((0.0, 1.0), abs=2e-3)
    long = Planar(robot).arc(0.0, 1.0)[1]
    slip = 1.0 + (robot.chassis.wheelbase_m / robot.chassis.track_m) ** 2
    assert long == pytest.approx(
        robot.drive.wheel_separation_multiplier / slip, rel=2e-3
    )
