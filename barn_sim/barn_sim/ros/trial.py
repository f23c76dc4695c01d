"""One trial of the simulator node: a simulator, the start of its time, its messages and counters."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from barn_sim.config import RunConfig, SimulatorNodeConfig
from barn_sim.messages import SimulatorMessages
from barn_sim.simulator import Simulator
from barn_worlds.base.compute import CycleTimer
from barn_worlds.base.types import NANOSECONDS_PER_SECOND, Velocity2D, nanoseconds
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.messages.topics import SCAN, Outgoing
from barn_worlds.robots.files import load_robot


@dataclass
class SimulatedTrial:
    """A simulator whose time 0 is `origin_ns` of the clock, and its messages.

    cycle_timer: when, in lockstep, the planner is asked and its commands take effect. published: whether the readings of
    this instant are; asked: whether the planner is to answer them. answer: the command for them; last: the last one
    that came; missed: how often lockstep got none in time; extra: commands that arrived when none was expected.
    """

    config: RunConfig
    simulator: Simulator
    messages: SimulatorMessages
    origin_ns: int
    world_name: str
    cycle_timer: CycleTimer
    published: bool = False
    asked: bool = True
    answer: Velocity2D | None = None
    last: Velocity2D | None = None
    commands: int = 0
    missed: int = 0
    extra: int = 0

    @property
    def now_ns(self) -> int:
        """The time on the clock."""
        return self.origin_ns + self.simulator.stamp_ns

    def take(self, velocity: Velocity2D) -> None:
        """Store a command for the next step; an extra one replaces the one before."""
        self.commands += 1
        self.extra += self.answer is not None
        self.answer = self.last = velocity

    def readings(self) -> Iterator[Outgoing]:
        """Yield all readings of this instant, the scan last; without the scan while the planner still computes."""
        sensors = self.simulator.sense()
        scanned = sensors.scan.stamp_ns == sensors.stamp_ns
        self.published, self.asked = (
            True,
            scanned and self.cycle_timer.is_free(self.simulator.stamp_ns),
        )
        found = self.messages.sensors(sensors, self.now_ns)
        return (one for one in found if self.asked or one.topic is not SCAN)

    def step(self) -> None:
        """Advance one control period with the answer to the readings, when that takes effect."""
        delay_ns = (
            self.cycle_timer.start_cycle(self.simulator.stamp_ns) if self.asked else 0
        )
        command, self.answer = self.answer, None
        self.simulator.step(command, delay_ns)
        self.published = False

    def due_readings(self) -> Iterator[Outgoing]:
        """Yield the time and those readings whose period ends now."""
        self.published = True
        simulator, messages, now_ns = self.simulator, self.messages, self.now_ns
        scanned = self._ends(self.config.lidar.rate_hz)
        odometry = simulator.read_odometry()
        yield messages.clock(now_ns)
        if scanned:
            yield messages.localization(
                simulator.read_localization(odometry.pose), odometry.pose, now_ns
            )
        if self._ends(self.config.odometry.rate_hz):
            yield messages.odometry(odometry, now_ns)
            yield messages.truth(simulator.read_truth(), now_ns)
            yield messages.transforms(odometry.pose, now_ns)
            yield messages.collision(simulator.read_collision())
            yield messages.joints(simulator.read_joints(), now_ns)
        if scanned:
            yield messages.scan(simulator.read_scan(), now_ns)

    def _ends(self, rate_hz: float) -> bool:
        return self.simulator.stamp_ns % nanoseconds(1.0 / rate_hz) == 0

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
        counts = ", ".join(
            f"{number} {name.replace('_', ' ')}"
            for name, number in self.counts().items()
        )
        return f"{self.simulator.stamp_ns / NANOSECONDS_PER_SECOND:.2f} s simulated, {counts}"


def begin(
    config: RunConfig, node: SimulatorNodeConfig, before_ns: int = 0
) -> SimulatedTrial:
    """Return a new trial from the next whole second on; BarnError if its world or its robot cannot be read."""
    config = replace(config, chassis=load_robot(config.robot).chassis)
    world = open_dataset(config.dataset).load(config.world)
    simulator = Simulator(world, config, config.start, config.seed)
    scan_period_s = None if node.lockstep else 1.0 / config.lidar.rate_hz
    messages = SimulatorMessages(config, node.frames, scan_period_s, config.start)
    origin_ns = (before_ns // NANOSECONDS_PER_SECOND + 1) * NANOSECONDS_PER_SECOND
    cycle_timer = CycleTimer(config.compute, config.compute_seed)
    return SimulatedTrial(
        config, simulator, messages, origin_ns, world.name, cycle_timer
    )
