from xml.etree.ElementTree import fromstring

import numpy as np
import pytest

from barn_sim.body.model import WHEELS, fixed_frames, jackal, robot_description
from barn_sim.config import LidarConfig


def test_the_body_is_that_of_the_jackal() -> None:
    model = jackal()
    assert model.mass_kg == pytest.approx(16.523 + 4 * 0.477)
    assert model.track_m == pytest.approx(0.37559)
    assert np.ptp(model.wheels[:, 0]) == pytest.approx(0.262)
    assert model.wheel_radius_m == 0.098
    # the wheels stand on the ground when base_footprint does
    assert model.wheels[:, 2] - model.wheel_radius_m == pytest.approx(np.full(4, model.footing[2]))


def test_centre_of_mass_and_inertia_are_those_of_chassis_and_wheels_together() -> None:
    model = jackal()
    chassis, wheel = 16.523, 0.477
    height = (chassis * 0.067 + 4 * wheel * 0.0345) / model.mass_kg
    forward = chassis * 0.012 / model.mass_kg
    assert model.centre_of_mass[2] == pytest.approx(height)
    assert model.centre_of_mass[0] == pytest.approx(forward)
    left = chassis * 0.002 / model.mass_kg
    spin = 0.4485 + chassis * ((0.012 - forward) ** 2 + (0.002 - left) ** 2)
    spin += 4 * (0.0013 + wheel * (0.131**2 + 0.187795**2 + forward**2 + left**2))
    assert model.inertia[2] == pytest.approx(spin)


def test_the_extent_is_that_of_wheels_and_chassis() -> None:
    assert jackal().extent() == pytest.approx([-0.229, -0.207795, 0.229, 0.207795])


def test_the_description_names_every_joint_and_mounts_the_lidar() -> None:
    config = LidarConfig(mount_x_m=0.12, mount_z_m=0.333)
    root = fromstring(robot_description(config))
    joints = {joint.get("name") for joint in root.iter("joint")}
    assert {f"{wheel}_joint" for wheel in WHEELS} <= joints
    assert fixed_frames(config)["lidar_link"] == (0.12, 0.0, 0.333)
    assert fixed_frames(config)["base_footprint"] == (0.0, 0.0, -0.0635)
    links = [link.get("name") for link in root.iter("link")]
    children = [child.get("link") for child in root.iter("child")]
    assert sorted(links) == sorted(["base_link", *children])  # one tree
