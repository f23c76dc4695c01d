"""What a trial ran in: the suite's own simulator, or one or a robot that it observes."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from barn_worlds.base.config import Checked, from_dict, quantity

SUITE_NAME = "barn"
NO_CONTACT = "none"  # nobody reports contacts
OPERATOR = "operator"  # who stands beside the robot reports them


@dataclass(frozen=True)
class System(Checked):
    """What trials run in and what is known of them; by default the suite's simulator.

    It is part of the task: results of two systems are never compared as one.
    """

    name: str = quantity(
        SUITE_NAME, "name of the simulator or robot; barn is the suite's simulator"
    )
    kind: str = quantity(
        "simulator", "kind of system", choices=("simulator", "robot", "table")
    )
    pose: str = quantity(
        "truth",
        "source of poses: a topic without its namespace, such as /odom, or frames of"
        " tf, such as /tf:odom.base_link; truth means the suite's simulator",
    )
    frame: str = quantity(
        "world",
        "frame of poses: world, or odom with an arbitrary origin",
        choices=("world", "odom", "unknown"),
    )
    clock: str = quantity(
        "simulation",
        "source of times: the suite's simulation, stamps of messages, or the log",
        choices=("simulation", "stamps", "log", "unknown"),
    )
    contact: str = quantity(
        "simulation", "source of contacts: a topic, operator, or none"
    )

    def check_rules(self) -> None:
        """Raise ConfigError for a bad value, or the suite's name for another system."""
        is_name = self.name.strip() != "" and self.name.isprintable()
        self.require(is_name, "name", "must be printable text")
        for item in fields(self):
            self.require(
                self.is_observed or getattr(self, item.name) == item.default,
                "name",
                "must not be that of the suite's own simulator, whose"
                f" {item.name} is {item.default}",
            )

    @property
    def is_observed(self) -> bool:
        """Whether somebody else runs it, so that no trial can be driven again."""
        return self.name != SUITE_NAME

    @property
    def label(self) -> str:
        """Kind, name and sources of pose, clock and contacts as text; "" for the suite."""
        if not self.is_observed:
            return ""
        if self.kind == "table":
            return self.name
        return (
            f"{self.kind} {self.name} (pose {self.pose} in frame {self.frame}, clock"
            f" {self.clock}, contact {self.contact})"
        )

    @property
    def reports_contacts(self) -> bool:
        """Whether contacts are known; if not, rows have None for them, not zero."""
        return self.contact != NO_CONTACT


SUITE = System()


def system_in(config: Mapping[str, Any]) -> System:
    """Return the system in a plain configuration or task; the suite's if none is named.

    Raises:
        ConfigError: The system cannot be read.
    """
    return from_dict(System, config.get("system") or {}, "system")


@dataclass(frozen=True)
class ObservedTrial:
    """What a row says of a trial that was observed and not driven by the suite."""

    system: str
    pose_source: str
    clock: str
    contact_source: str
    clearance_by: str  # "world", "scans", or empty where clearances are unknown
    time_uncertainty_s: float | None  # how far times may be off, None if unknown

    @classmethod
    def of(
        cls, system: System, clearance_by: str, time_uncertainty_s: float | None
    ) -> "ObservedTrial | None":
        """Return what a row says of a trial of the system; None for the suite's own.

        Args:
            system: What the trial ran in.
            clearance_by: Source of clearances: "world", "scans" or "".
            time_uncertainty_s: How far times may be off, in s.
        """
        if not system.is_observed:
            return None
        return cls(
            system.name,
            system.pose,
            system.clock,
            system.contact,
            clearance_by,
            time_uncertainty_s,
        )
