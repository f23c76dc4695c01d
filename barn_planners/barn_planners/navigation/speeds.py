"""Limits of speed that several planners have."""

from dataclasses import dataclass

from barn_worlds.base.config import Checked, quantity


@dataclass(frozen=True)
class SpeedConfig(Checked):
    """Limits of the speeds that a planner commands."""

    max_speed_mps: float = quantity(0.5, "highest forward speed", "m/s", 0.0, 5.0)
    min_speed_mps: float = quantity(
        0.1, "lowest forward speed while driving", "m/s", 0.0, 5.0
    )
    max_turn_radps: float = quantity(1.57, "highest yaw rate", "rad/s", 0.0, 10.0)

    def check_rules(self) -> None:
        """Raise ConfigError if `min_speed_mps` exceeds `max_speed_mps`."""
        self.require_order("min_speed_mps", "at most", "max_speed_mps")
