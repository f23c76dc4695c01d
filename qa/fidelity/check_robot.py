"""Drive a robot straight, in turns, arcs and stops, and compare it with theory.

The theory is the planar model of `planar.py`.

    python qa/fidelity/check_robot.py turtlebot4
    python qa/fidelity/check_robot.py mine.yaml --json

The exit code is 1 if a speed, a yaw rate or a distance is more than 3% off, or if the
file describes no robot.
"""

import json
import math
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace

import click
import numpy as np
from planar import Planar
from rich.console import Console
from rich.table import Table

from barn_sim.config import PRESETS, with_robot
from barn_sim.simulator import Simulator
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.base.types import STOP, Pose2D, Velocity2D
from barn_worlds.robots.files import load_robot
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.world import World

LARGEST_DEVIATION = 0.03
_START = Pose2D(200.0, 0.0, 0.3)  # far from everything in a world
_SETTLED_S = 1.0
_MEASURED_S = 1.0
_SLIPS_S = 4.0  # that a skid-steer robot takes for a steady arc
_SIDEWAYS = 0.3  # share of the friction that an arc may take
_LAGS = 6.0  # after so many time constants motors have followed
_LONGEST_S = 120.0  # that a robot may take until it goes as commanded


@dataclass(frozen=True)
class Measured:
    """One quantity of the drive: what theory says, what the simulator did.

    `asked`: of the robot, if anything was.
    """

    manoeuvre: str
    quantity: str
    unit: str
    asked: float | None
    theory: float
    simulated: float

    @property
    def deviation(self) -> float:
        """The simulated value's, relative to theory."""
        return self.simulated / self.theory - 1.0

    @property
    def passed(self) -> bool:
        """Whether it is within the allowed deviation."""
        return abs(self.deviation) <= LARGEST_DEVIATION


def self_test(robot: Robot) -> list[Measured]:
    """Drive a robot and return all that was measured.

    Raises:
        ConfigError: If it cannot be simulated, or does not get going.
    """
    for name in ("max_speed_m_s", "max_yaw_rate_rad_s"):
        if getattr(robot.drive, name) == 0.0:
            raise ConfigError(
                f"robot {robot.name}: drive.{name} must be above 0 to drive it, got 0"
            )
    drives = _SelfTest(robot)
    return [*drives.straight(), *drives.turn(), *drives.arcs()]


class _SelfTest:
    def __init__(self, robot: Robot) -> None:
        self._robot, self._theory = robot, Planar(robot)
        self._world = World(
            "self-test", np.zeros((3, 3), np.bool_), np.array([[1, 0], [1, 1], [1, 2]])
        )
        config = with_robot(PRESETS["default"], robot)
        self._config = replace(
            config, lidar=replace(config.lidar, beams=1)
        )  # scans that take no time

    def straight(self) -> Iterator[Measured]:
        speed = self._robot.drive.max_speed_m_s
        simulator = self._simulator()
        start = simulator.sense().truth.pose
        settling_s = self._settling_s(speed)
        reached, covered = self._theory.go(speed, settling_s)
        self._drive(simulator, Velocity2D(speed, 0.0), settling_s)
        gone = simulator.sense().truth.pose.distance(start)
        yield Measured(
            "straight", f"distance in {settling_s:.1f} s", "m", None, covered, gone
        )
        steady = self._drive(simulator, Velocity2D(speed, 0.0), _MEASURED_S)[0]
        yield Measured("straight", "speed", "m/s", speed, reached, steady)
        before = simulator.sense().truth.pose
        self._drive(simulator, STOP, settling_s)
        stopped = simulator.sense().truth.pose.distance(before)
        yield Measured(
            "stop", "distance", "m", None, self._theory.stopping_m(speed), stopped
        )

    def turn(self) -> Iterator[Measured]:
        simulator = self._simulator()
        turn = 0.5 * self._robot.drive.max_yaw_rate_rad_s
        command = Velocity2D(0.0, turn)
        self._drive(simulator, command, self._settling_s(0.0, turn))
        rate = self._drive(simulator, command, _MEASURED_S)[1]
        yield Measured(
            "turn in place",
            "yaw rate",
            "rad/s",
            turn,
            self._theory.arc(0.0, turn)[1],
            rate,
        )
        if self._robot.chassis.kind == "differential":
            before = simulator.sense().truth.pose.yaw
            self._drive(simulator, STOP, self._settling_s(0.0, turn))
            turned = (simulator.sense().truth.pose.yaw - before) % (2.0 * math.pi)
            yield Measured(
                "stop turning",
                "angle",
                "rad",
                None,
                self._theory.stopping_rad(turn),
                turned,
            )

    def arcs(self) -> Iterator[Measured]:
        drive = self._robot.drive
        speed = 0.5 * drive.max_speed_m_s
        turn = min(
            0.5 * drive.max_yaw_rate_rad_s,
            _SIDEWAYS * self._theory.friction_m_s2 / max(speed, 1e-6),
        )
        yield from self._steady("arc to the left", speed, turn)
        yield from self._steady("arc to the right", speed, -0.5 * turn)

    def _steady(self, manoeuvre: str, speed: float, turn: float) -> Iterator[Measured]:
        simulator = self._simulator()
        command = Velocity2D(speed, turn)
        slips_s = _SLIPS_S if self._robot.chassis.kind == "skid_steer" else 0.0
        self._drive(simulator, command, self._settling_s(speed, turn) + slips_s)
        driven = self._drive(simulator, command, _MEASURED_S)
        expected = self._theory.arc(speed, turn)
        yield Measured(manoeuvre, "speed", "m/s", speed, expected[0], driven[0])
        yield Measured(manoeuvre, "yaw rate", "rad/s", turn, expected[1], driven[1])

    def _simulator(self) -> Simulator:
        return Simulator(self._world, self._config, _START, 0)

    def _settling_s(self, speed: float, turn: float = 0.0) -> float:
        """Return the time until the robot follows a command, in control periods."""
        drive = self._robot.drive
        grip = min(self._theory.grip_m_s2(1), self._theory.grip_m_s2(-1))
        gain = max(min(drive.max_acceleration_m_s2, grip), 1e-9)
        ramp = max(speed / gain, abs(turn) / drive.max_yaw_acceleration_rad_s2)
        needed_s = (
            ramp + _LAGS * drive.motor_lag_s + drive.command_latency_s + _SETTLED_S
        )
        if needed_s > _LONGEST_S:
            requirement = f"must let it reach its speeds within {_LONGEST_S:g} s, it takes {needed_s:.3g} s"
            raise ConfigError(
                f"robot {self._robot.name}: its accelerations and wheel_friction {requirement}"
            )
        period = self._config.control_period_s
        return period * math.ceil(needed_s / period)

    def _drive(
        self, simulator: Simulator, command: Velocity2D, duration_s: float
    ) -> tuple[float, float]:
        """Return the mean forward speed and yaw rate while driving so long."""
        sensed = [
            simulator.step(command)
            for _ in range(round(duration_s / self._config.control_period_s))
        ]
        velocities = [sample.truth.velocity.numbers for sample in sensed]
        linear, angular = np.mean(velocities, axis=0).tolist()
        return linear, angular


def show(robot: Robot, driven: list[Measured]) -> None:
    """Print how a robot drove, and whether that is as theory says."""
    drive = robot.drive
    chassis = robot.chassis
    size = f"{robot.length_m:.3g} x {robot.width_m:.3g} x {chassis.body_height_m:.3g} m, {chassis.mass_kg:.4g} kg"
    limits = f"{drive.max_speed_m_s:g} m/s, {drive.max_yaw_rate_rad_s:g} rad/s"
    click.echo(f"{robot.name}: {chassis.kind}, {size}, up to {limits}")
    table = Table("manoeuvre", "quantity", "asked", "theory", "simulated", "deviation")
    for measurement in driven:
        demand = "" if measurement.asked is None else f"{measurement.asked:.3f}"
        deviation = (
            f"{100 * measurement.deviation:+.1f}%{'' if measurement.passed else ' !'}"
        )
        numbers = (
            demand,
            f"{measurement.theory:.3f}",
            f"{measurement.simulated:.3f}",
            deviation,
        )
        table.add_row(
            measurement.manoeuvre,
            f"{measurement.quantity} ({measurement.unit})",
            *numbers,
        )
    Console().print(table)
    beyond = sum(not measurement.passed for measurement in driven)
    worst = max(abs(measurement.deviation) for measurement in driven)
    verdict = (
        f"does not drive as theory says in {beyond} respects"
        if beyond
        else "drives as theory says"
    )
    click.echo(
        f"{robot.name} {verdict}: at most {100 * worst:.1f}% off, {100 * LARGEST_DEVIATION:g}% allowed"
    )


@click.command()
@click.argument("robot")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
def main(robot: str, as_json: bool) -> None:
    """Check a robot: a name or a YAML file."""
    try:
        loaded = load_robot(robot)
        driven = self_test(loaded)
    except BarnError as error:
        raise click.ClickException(str(error)) from None
    passed = all(measurement.passed for measurement in driven)
    if as_json:
        measured = [
            {
                **asdict(measurement),
                "deviation": measurement.deviation,
                "passed": measurement.passed,
            }
            for measurement in driven
        ]
        click.echo(
            json.dumps(
                {"robot": loaded.name, "passed": passed, "self_test": measured},
                indent=1,
            )
        )
    else:
        show(loaded, driven)
    sys.exit(int(not passed))


if __name__ == "__main__":
    main()
