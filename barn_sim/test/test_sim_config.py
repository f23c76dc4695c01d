import pytest

from barn_sim.config import LidarConfig, OdometryConfig, PhysicsConfig, SimulatorConfig, chassis_in
from barn_worlds.base.config import replace_dotted
from barn_worlds.base.errors import ConfigError
from barn_worlds.robots.files import load_robot


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"lidar.beams": 0}, "beams must be from 1"),
        ({"localisation.mode": "amlc"}, "did you mean 'amcl'"),
        ({"lidar.beems": 3}, "did you mean 'lidar.beams'"),
        ({"drive.max_speed_m_s": float("nan")}, "max_speed_m_s"),
        ({"control_period_s": 0.052}, "control_period_s must give a period of whole physics steps of 0.005 s"),
        ({"odometry.rate_hz": 30.0}, "odometry.rate_hz must give a period of whole physics steps"),
        ({"lidar.rate_hz": 60.0}, "lidar.rate_hz must give a period of whole physics steps"),
        ({"lidar.angle_max_rad": -3.0}, "angle_max_rad must be above angle_min_rad"),
        ({"lidar.range_max_m": 0.1}, "range_max_m must be above range_min_m"),
    ],
)
def test_what_is_not_allowed_is_refused_in_one_line(changes: dict, reason: str) -> None:
    with pytest.raises(ConfigError) as error:
        replace_dotted(SimulatorConfig(), changes, "--sim")
    assert reason in str(error.value)
    assert "\n" not in str(error.value)


def test_periods_are_whole_numbers_of_ticks() -> None:
    config = SimulatorConfig(
        physics=PhysicsConfig(tick_s=0.001), lidar=LidarConfig(rate_hz=40.0), odometry=OdometryConfig(rate_hz=100.0)
    )
    assert config.tick_ns == 1_000_000
    assert (config.ticks(config.control_period_s), config.ticks(0.025), config.ticks(0.01)) == (50, 25, 10)


def test_robot_of_plain_data() -> None:
    assert chassis_in({}) == chassis_in(None) == load_robot("jackal").chassis
    with pytest.raises(ConfigError, match=r"simulator\.chassis"):
        chassis_in({"chassis": {"name": "x"}})
