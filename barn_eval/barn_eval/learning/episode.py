"""One episode: a trial as the benchmark runs it, a command at a time."""

from barn_eval.trials.outcome import Outcome, Verdict
from barn_eval.trials.referee import Reading, Referee
from barn_eval.trials.scores import Scores, score
from barn_eval.trials.spec import TrialSpec
from barn_planners.interface import Observation
from barn_sim.bullet import PhysicsClient
from barn_sim.simulator import Simulator
from barn_worlds.types import Velocity2D

# What ends a trial by what was done; anything else ends it by the time or a fault.
TERMINAL = (Outcome.SUCCESS, Outcome.COLLISION, Outcome.INVALID_COMMAND)


class Episode:
    """Simulator and referee of one trial, in step as in a direct trial; `sensors` are the readings of this instant."""

    def __init__(self, spec: TrialSpec, client: PhysicsClient) -> None:
        """Begin; whatever used the physics client before is over."""
        self.spec = spec
        self.goal = spec.goal  # in the planning frame
        self._simulator = Simulator(spec.world, spec.simulator, spec.course.start, spec.simulator_seed, client)
        self._referee = Referee(spec.protocol, spec.course)
        self.sensors = self._simulator.sense()
        self._judge()

    @property
    def verdict(self) -> Verdict | None:
        """The verdict, None while the episode runs."""
        return self._referee.verdict

    def step(self, command: Velocity2D) -> Verdict | None:
        """Give a command and return the verdict a control period later, if there is one."""
        if self._referee.command(command) is None:
            self.sensors = self._simulator.step(command)
            self._judge()
        return self.verdict

    def observation(self) -> Observation:
        """Return what a planner is told of this instant."""
        sensors = self.sensors
        pose = sensors.localisation if self.spec.protocol.map_given else sensors.odometry.pose
        return Observation(sensors.stamp_ns, sensors.odometry, sensors.scan, pose)

    def scores(self) -> Scores | None:
        """Return the scores of an episode that has ended."""
        return score(self.verdict, self.spec.course, self.spec.protocol) if self.verdict is not None else None

    def _judge(self) -> None:
        sensors = self.sensors
        self._referee.observe(Reading(sensors.stamp_ns, sensors.odometry.pose, sensors.truth.pose, sensors.collision))
