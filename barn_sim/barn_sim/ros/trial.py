"""One trial of the simulator node: a simulator, its messages and its counters."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from barn_sim.config import RunConfig, SimulatorNodeConfig
from barn_sim.messages import SimulatorMessages
from barn_sim.ros.rhythm import Rhythm
from barn_sim.simulator import Simulator
from barn_worlds.base.compute import CycleTimer
from barn_worlds.base.types import NANOSECONDS_PER_SECOND, Velocity2D, nanoseconds
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.messages.topics import SCAN, OutgoingMessage
from barn_worlds.robots.files import load_robot


@dataclass
class SimulatedTrial:
    """A simulator and the state of its exchange with the planner."""

    config: RunConfig
    simulator: Simulator
    messages: SimulatorMessages

    origin_ns: int
    """Time on the clock at which the simulator starts."""

    world_name: str

    cycle_timer: CycleTimer
    """In lockstep, when the planner may answer and when its commands take effect."""

    rhythm: Rhythm
    """In lockstep, which instants the planner answers."""

    published: bool = False
    """Whether the readings of this instant have been published."""

    awaits_answer: bool = True
    """Whether the planner is to answer the readings of this instant."""

    answer: Velocity2D | None = None
    """The command that came for this instant."""

    last_command: Velocity2D | None = None

    commands: int = 0
    """How many commands came."""

    extra: int = 0
    """How many commands came when none was expected."""

    @property
    def now_ns(self) -> int:
        """Time on the node's clock, in ns, which goes on from trial to trial."""
        return self.origin_ns + self.simulator.stamp_ns

    def take(self, velocity: Velocity2D) -> None:
        """Store a command for the next step; counts as extra if it replaces one."""
        self.commands += 1
        # A second answer to one scan shows that somebody else publishes commands as
        # well.
        self.extra += self.answer is not None
        self.answer = velocity
        self.last_command = velocity

    def readings(self) -> Iterator[OutgoingMessage]:
        """Sense, set `published` and `awaits_answer`; yield the messages, scan last.

        The scan is left out while the planner still computes.
        """
        sensors = self.simulator.sense()
        has_scan = sensors.scan.stamp_ns == sensors.stamp_ns
        is_free = self.cycle_timer.is_free(sensors.stamp_ns)
        self.published = True
        self.awaits_answer = is_free and self.rhythm.expects(
            self.now_ns, has_scan=has_scan
        )
        for message in self.messages.sensors(sensors, self.now_ns):
            if is_free or message.topic is not SCAN:
                yield message

    def step(self) -> None:
        """Advance a period with the stored answer, clear it; TippedError if tipped."""
        # The planner's computing time in simulated time, as the protocol charges it.
        delay_ns = 0
        if self.awaits_answer:
            delay_ns = self.cycle_timer.start_cycle(self.simulator.stamp_ns)
        self.simulator.step(self.answer, delay_ns)
        self.simulator.require_upright()
        self.answer = None
        self.published = False

    def due_readings(self) -> Iterator[OutgoingMessage]:
        """Set `published`; yield the clock, then what is due now, the scan last."""
        self.published = True
        simulator = self.simulator
        messages = self.messages
        now_ns = self.now_ns
        is_scan_due = self._is_due(self.config.lidar.rate_hz)

        # The scan last: planners answer it, and need everything else before.
        odometry = simulator.read_odometry()
        yield messages.clock(now_ns)
        if is_scan_due:
            pose = simulator.read_localization(odometry.pose)
            yield messages.localization(pose, odometry.pose, now_ns)
        if self._is_due(self.config.odometry.rate_hz):
            yield messages.odometry(odometry, now_ns)
            yield messages.truth(simulator.read_truth(), now_ns)
            yield messages.transforms(odometry.pose, now_ns)
            yield messages.collision(simulator.read_collision())
            yield messages.joints(simulator.read_joints(), now_ns)
        if is_scan_due:
            yield messages.scan(simulator.read_scan(), now_ns)

    def _is_due(self, rate_hz: float) -> bool:
        """Tell whether a sensor of a rate in Hz has a reading at this instant."""
        return self.simulator.stamp_ns % nanoseconds(1.0 / rate_hz) == 0

    def counts(self) -> dict[str, int]:
        """Return the numbers of received, missed, invalid, extra commands by name."""
        return {
            "commands": self.commands,
            "missed_commands": self.rhythm.missed,
            "invalid_commands": self.simulator.invalid_commands,
            "extra_commands": self.extra,
        }

    def summary(self) -> str:
        """Return the simulated time in s and the counts as one line of text."""
        parts = [f"{self.simulator.stamp_ns / NANOSECONDS_PER_SECOND:.2f} s simulated"]
        for name, count in self.counts().items():
            parts.append(f"{count} {name.replace('_', ' ')}")
        return ", ".join(parts)


def begin_trial(
    config: RunConfig, node: SimulatorNodeConfig, rhythm: Rhythm, before_ns: int = 0
) -> SimulatedTrial:
    """Load world and robot, begin `rhythm`; return a trial from the next full second.

    Args:
        config: World, start pose, seed and robot of the trial.
        node: Frames and mode of the node.
        rhythm: Which instants the planner answers, as far as earlier trials show.
        before_ns: Last time on the clock.

    Raises:
        BarnError: If the world or the robot cannot be read.
    """
    # The body alone: parameters of drive and sensors keep what was set for the node.
    robot = load_robot(config.robot)
    config = replace(config, chassis=robot.chassis)
    world = open_dataset(config.dataset).load_scaled(config.world, robot)
    simulator = Simulator(world, config, config.start, config.seed)
    rhythm.begin_trial(nanoseconds(config.control_period_s), config.command_wait_s)
    scan_period_s = None
    if not node.lockstep:
        scan_period_s = 1.0 / config.lidar.rate_hz
    return SimulatedTrial(
        config=config,
        simulator=simulator,
        messages=SimulatorMessages(config, node.frames, scan_period_s, config.start),
        # Time never runs back from trial to trial: tf2 drops all transforms then.
        origin_ns=(before_ns // NANOSECONDS_PER_SECOND + 1) * NANOSECONDS_PER_SECOND,
        world_name=world.name,
        cycle_timer=CycleTimer(config.compute, config.compute_seed),
        rhythm=rhythm,
    )
