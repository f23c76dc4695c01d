from xml.etree.ElementTree import fromstring

import numpy as np
import pytest

from barn_sim.body.model import WHEELS, fixed_frames, model_of, robot_description
from barn_sim.config import LidarConfig
from barn_worlds.robots.files import STANDARD

MODEL = model_of(STANDARD.chassis)


def test_the_body_is_that_of_the_jackal() -> None:
    assert MODEL.mass_kg == pytest.approx(16.523 + 4 * 0.477)
    assert MODEL.track_m == pytest.approx(0.37559)
    assert np.ptp(MODEL.wheels[:, 0]) == pytest.approx(0.262)
    assert MODEL.wheel_radius_m == 0.098
    # the wheels stand on the ground when base_footprint does
    assert MODEL.wheels[:, 2] - MODEL.wheel_radius_m == pytest.approx(np.full(4, MODEL.footing[2]))


def test_centre_of_mass_and_inertia_are_those_of_chassis_and_wheels_together() -> None:
    chassis, wheel = 16.523, 0.477
    height = (chassis * 0.067 + 4 * wheel * 0.0345) / MODEL.mass_kg
    forward = chassis * 0.012 / MODEL.mass_kg
    assert MODEL.centre_of_mass[2] == pytest.approx(height)
    assert MODEL.centre_of_mass[0] == pytest.approx(forward)
    left = chassis * 0.002 / MODEL.mass_kg
    spin = 0.4485 + chassis * ((0.012 - forward) ** 2 + (0.002 - left) ** 2)
    spin += 4 * (0.0013 + wheel * (0.131**2 + 0.187795**2 + forward**2 + left**2))
    assert MODEL.inertia[2] == pytest.approx(spin)


def test_the_extent_is_that_of_wheels_and_chassis() -> None:
    assert MODEL.extent == pytest.approx([-0.229, -0.207795, 0.229, 0.207795])


def test_the_shapes_of_the_jackal_are_those_of_its_urdf() -> None:
    root = fromstring(robot_description(LidarConfig(), STANDARD.chassis))
    (box,) = root.iterfind("link/collision/geometry/box")
    body, *wheels = MODEL.shapes
    assert (2.0 * body.half_sizes).tolist() == pytest.approx([float(size) for size in box.attrib["size"].split()])
    height = root.find("link[@name='chassis_link']/collision/origin").attrib["xyz"]
    assert body.centre.tolist() == pytest.approx([float(number) for number in height.split()])
    cylinders = [cylinder.attrib for cylinder in root.iterfind("link/collision/geometry/cylinder")]
    assert [(wheel.radius_m, 2.0 * wheel.half_sizes[1]) for wheel in wheels] == [
        (float(cylinder["radius"]), float(cylinder["length"])) for cylinder in cylinders
    ]


def test_the_description_names_every_joint_and_mounts_the_lidar() -> None:
    config = LidarConfig(mount_x_m=0.12, mount_z_m=0.333)
    root = fromstring(robot_description(config, STANDARD.chassis))
    joints = {joint.get("name") for joint in root.iter("joint")}
    assert {f"{wheel}_joint" for wheel in WHEELS} <= joints
    assert fixed_frames(config, STANDARD.chassis)["lidar_link"] == (0.12, 0.0, 0.333)
    assert fixed_frames(config, STANDARD.chassis)["base_footprint"] == (0.0, 0.0, -0.0635)
    links = [link.get("name") for link in root.iter("link")]
    children = [child.get("link") for child in root.iter("child")]
    assert sorted(links) == sorted(["base_link", *children])  # one tree
