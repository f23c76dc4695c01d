"""One trial of the simulator node: a simulator, the start of its time, and counters."""

from dataclasses import dataclass

from barn_sim.config import RunConfig, SimulatorNodeConfig
from barn_sim.messages import SimulatorMessages
from barn_sim.simulator import Simulator
from barn_worlds.base.types import NANOSECONDS, Velocity2D
from barn_worlds.worlds.dataset import open_dataset


@dataclass
class SimulatedTrial:
    """A simulator whose time 0 is `origin_ns` of the clock, and its messages.

    answer: the command for the last published instant; last: the latest command, for single steps; missed: how often
    lockstep got no command in time; extra: commands that arrived when none was expected.
    """

    config: RunConfig
    simulator: Simulator
    messages: SimulatorMessages
    origin_ns: int
    world_name: str
    published: bool = False
    answer: Velocity2D | None = None
    last: Velocity2D | None = None
    commands: int = 0
    missed: int = 0
    extra: int = 0
    _invalid_seen: bool = False

    @property
    def now_ns(self) -> int:
        """The time on the clock."""
        return self.origin_ns + self.simulator.stamp_ns

    def is_first_invalid(self, velocity: Velocity2D) -> bool:
        """Tell whether a command is the first of the trial that is not finite."""
        first = not velocity.is_finite() and not self._invalid_seen
        self._invalid_seen = self._invalid_seen or first
        return first

    def take(self, velocity: Velocity2D) -> None:
        """Store a command for the next step; an extra one replaces the one before."""
        self.commands += 1
        self.extra += self.answer is not None
        self.answer = self.last = velocity

    def counts(self) -> dict[str, int]:
        """Return the counters by name."""
        return {
            "commands": self.commands,
            "missed_commands": self.missed,
            "invalid_commands": self.simulator.invalid_commands,
            "extra_commands": self.extra,
        }

    def summary(self) -> str:
        """Return the counts in one line."""
        counts = ", ".join(f"{number} {name.replace('_', ' ')}" for name, number in self.counts().items())
        return f"{self.simulator.stamp_ns / NANOSECONDS:.2f} s simulated, {counts}"

    def close(self) -> None:
        """Release the simulator."""
        self.simulator.close()


def begin(config: RunConfig, node: SimulatorNodeConfig, origin_ns: int) -> SimulatedTrial:
    """Return a new trial; BarnError if its world or its robot cannot be read."""
    config = config.with_chassis()
    world = open_dataset(config.dataset).load(config.world)
    simulator = Simulator(world, config, config.start, config.seed)
    scan_period_s = config.control_period_s if node.lockstep else 1.0 / config.lidar.rate_hz
    messages = SimulatorMessages(config, node.frames, scan_period_s, config.start)
    return SimulatedTrial(config, simulator, messages, origin_ns, world.name)


def next_origin(now_ns: int) -> int:
    """Return the next whole second."""
    return (now_ns // NANOSECONDS + 1) * NANOSECONDS
