"""What is configured, and the body that the simulator makes of it."""

from xml.etree.ElementTree import fromstring

import numpy as np
import pytest
import yaml
from refusals import refused

from barn_sim.body.model import model_of, robot_description
from barn_sim.config import (
    LidarConfig,
    OdometryConfig,
    PhysicsConfig,
    SimulatorConfig,
    chassis_in,
)
from barn_worlds.base.config import replace_dotted
from barn_worlds.robots.files import STANDARD_ROBOT, load_robot

REFUSALS = """
- - control_period_s: 0.052
  - control_period_s must give a period of whole physics steps of 0.005 s
- - odometry.rate_hz: 30.0
  - odometry.rate_hz must give a period of whole physics steps
- - lidar.rate_hz: 60.0
  - lidar.rate_hz must give a period of whole physics steps
- - lidar.angle_max_rad: -3.0
  - angle_max_rad must be above angle_min_rad
- - lidar.range_max_m: 0.1
  - range_max_m must be above range_min_m
"""


@pytest.mark.parametrize("changes, reason", yaml.safe_load(REFUSALS))
def test_what_is_not_allowed_is_refused_in_one_line(changes, reason):
    with refused(reason):
        replace_dotted(SimulatorConfig(), changes, "--sim")


def test_periods_are_whole_numbers_of_ticks():
    config = SimulatorConfig(
        physics=PhysicsConfig(tick_s=0.001),
        lidar=LidarConfig(rate_hz=40.0),
        odometry=OdometryConfig(rate_hz=100.0),
    )
    assert config.tick_ns == 1_000_000
    periods_s = (config.control_period_s, 0.025, 0.01)
    assert [config.ticks(period_s) for period_s in periods_s] == [50, 25, 10]


def test_robot_of_plain_data():
    assert chassis_in({}) == chassis_in(None) == load_robot("jackal").chassis
    with refused(r"simulator\.chassis"):
        chassis_in({"chassis": {"name": "x"}})


MODEL = model_of(STANDARD_ROBOT.chassis)


def test_the_body_is_that_of_the_jackal():
    assert MODEL.mass_kg == pytest.approx(16.523 + 4 * 0.477)
    assert STANDARD_ROBOT.chassis.track_m == pytest.approx(0.37559)
    assert np.ptp(MODEL.wheels[:, 0]) == pytest.approx(0.262)
    assert MODEL.wheel_radius_m == 0.098
    # the wheels stand on the ground when base_footprint does
    lowest = MODEL.wheels[:, 2] - MODEL.wheel_radius_m
    ground = -STANDARD_ROBOT.chassis.base_height_m
    assert lowest == pytest.approx(np.full(4, ground))


def test_center_of_mass_and_inertia_include_the_wheels():
    chassis = 16.523
    wheel = 0.477
    height = (chassis * 0.067 + 4 * wheel * 0.0345) / MODEL.mass_kg
    forward = chassis * 0.012 / MODEL.mass_kg
    left = chassis * 0.002 / MODEL.mass_kg
    assert MODEL.center_of_mass == pytest.approx([forward, left, height])
    away = 0.131**2 + 0.187795**2 + forward**2 + left**2
    spin = 0.4485 + chassis * ((0.012 - forward) ** 2 + (0.002 - left) ** 2)
    spin += 4 * (0.0013 + wheel * away)
    assert MODEL.inertia[2] == pytest.approx(spin)


def test_the_shapes_of_the_jackal_are_those_of_its_urdf():
    root = fromstring(robot_description(LidarConfig(), STANDARD_ROBOT.chassis))
    (box,) = root.iterfind("link/collision/geometry/box")
    body, *wheels = MODEL.shapes
    sizes = np.array(box.attrib["size"].split(), float)
    assert 2.0 * body.half_sizes == pytest.approx(sizes)
    origin = root.find("link[@name='chassis_link']/collision/origin")
    assert body.center == pytest.approx(np.array(origin.attrib["xyz"].split(), float))
    cylinders = list(root.iterfind("link/collision/geometry/cylinder"))
    for wheel, cylinder in zip(wheels, cylinders, strict=True):
        assert wheel.radius_m == float(cylinder.attrib["radius"])
        assert 2.0 * wheel.half_sizes[1] == float(cylinder.attrib["length"])
