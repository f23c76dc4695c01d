"""What a robot in the plane should do, from textbooks.

The reference of the self-test, independent of the simulator.

Wheels of a differential drive roll without slipping (Siegwart, Nourbakhsh and
Scaramuzza 2011, ch. 3; Rajamani 2012, ch. 2) as long as friction holds them, which
limits how fast a robot gains and loses speed (ch. 4). A skid-steer robot turns by
slipping: its wheels are rigid, with Coulomb friction under loads from statics, and its
steady motion is where their forces balance (Kozlowski and Pazderski 2004).
"""

import math
from dataclasses import dataclass

from barn_worlds.robots.robot import Robot

GRAVITY_M_S2 = 9.81
_STEP_S = 1e-4  # along a line
# of a robot that slips, unless it is steady before
_TURN_STEP_S = 2e-4
_TURN_S = 10.0
_STEADY = 1e-4  # change in a second
_CREEP_M_S = 1e-3  # slip below which friction is viscous, so that it can be integrated
_STILL_M_S = 1e-4

Force = tuple[float, float]


@dataclass(frozen=True)
class Planar:
    """A robot in the plane."""

    robot: Robot

    @property
    def friction_m_s2(self) -> float:
        """Acceleration by the friction of all wheels if they carried all weight."""
        return self.robot.wheel_friction * GRAVITY_M_S2

    @property
    def height_m(self) -> float:
        """Height of the center of mass over the ground."""
        return self.robot.chassis.centre_of_mass_m[2] + self.robot.chassis.base_height_m

    def grip_m_s2(self, sense: int) -> float:
        """Return the largest acceleration (sense 1) or deceleration (-1) by friction.

        It is that of the driven wheels.

        With one driven axle, weight moves to the rear as the robot gains speed. Balance
        of forces and moments.
        """
        chassis = self.robot.chassis
        friction = self.robot.wheel_friction
        if chassis.kind == "skid_steer":
            return self.friction_m_s2
        driven = chassis.axle_x_m
        other = sum(x for x, _ in chassis.casters_m) / len(chassis.casters_m)
        carried = GRAVITY_M_S2 * (chassis.centre_of_mass_m[0] - other)
        lever = driven - other + sense * friction * self.height_m
        return friction * carried / lever if carried * lever > 0.0 else math.inf

    def stopping_m(self, speed_m_s: float) -> float:
        """Return how far a robot goes on from this speed after it was told to stop."""
        return self.go(0.0, math.inf, speed_m_s)[1]

    def go(
        self, target_m_s: float, duration_s: float, start_m_s: float = 0.0
    ) -> tuple[float, float]:
        """Return speed (m/s) and distance (m) some time after a step of the command.

        With latency, ramp of the controller, lag of the motors and friction.
        """
        drive = self.robot.drive
        grips = self.grip_m_s2(-1), self.grip_m_s2(1)
        command = rim = speed = start_m_s
        time_s = distance = 0.0
        while time_s < duration_s and (
            duration_s < math.inf
            or time_s <= drive.command_latency_s
            or max(abs(rim), abs(speed)) > _STILL_M_S
        ):
            if time_s >= drive.command_latency_s:
                most = drive.max_acceleration_m_s2 * _STEP_S
                command += max(-most, min(most, target_m_s - command))
            lag = drive.motor_lag_s
            rim = (
                command
                if lag == 0.0
                else rim + (command - rim) * min(_STEP_S / lag, 1.0)
            )
            speed += max(-grips[0] * _STEP_S, min(grips[1] * _STEP_S, rim - speed))
            distance += speed * _STEP_S
            time_s += _STEP_S
        return speed, distance

    def arc(self, speed_m_s: float, turn_rad_s: float) -> tuple[float, float]:
        """Return the steady forward speed (m/s) and yaw rate (rad/s) under a command.

        The command is within the limits.
        """
        chassis = self.robot.chassis
        drive = self.robot.drive
        half = 0.5 * chassis.track_m * drive.wheel_separation_multiplier
        lost = drive.turn_deadband_rad_s
        turn_rad_s -= max(-lost, min(lost, turn_rad_s))
        left = speed_m_s - turn_rad_s * half
        right = speed_m_s + turn_rad_s * half
        if chassis.kind == "differential":
            return speed_m_s, (right - left) / chassis.track_m
        return self._skid(left, right)

    def stopping_rad(self, turn_rad_s: float) -> float:
        """Return how far a differential drive turns on in place after a stop."""
        chassis = self.robot.chassis
        drive = self.robot.drive
        _, rate = self.arc(0.0, turn_rad_s)
        gain = rate / turn_rad_s
        ahead = chassis.centre_of_mass_m[0] - chassis.axle_x_m
        inertia = chassis.inertia_kg_m2[2] + chassis.mass_kg * ahead**2
        # Casters on the other side of the axle carry nothing.
        arms = [x - chassis.axle_x_m for x, _ in chassis.casters_m]
        arms = [arm for arm in arms if arm * ahead > 0.0]
        share = ahead * len(arms) / sum(arms) if arms else 0.0
        load = chassis.mass_kg * GRAVITY_M_S2 * (1.0 - share)
        grip = self.robot.wheel_friction * load * 0.5 * chassis.track_m / inertia
        slowing = min(drive.max_yaw_acceleration_rad_s2 * gain, grip)
        return (
            rate * (drive.command_latency_s + drive.motor_lag_s)
            + 0.5 * rate**2 / slowing
        )

    def _skid(self, left_m_s: float, right_m_s: float) -> tuple[float, float]:
        """Return the steady speed of base_link and yaw rate on four wheels that slip.

        The motion in the frame of the robot, integrated until it is steady.
        """
        chassis = self.robot.chassis
        mass = chassis.mass_kg
        spin_inertia = chassis.inertia_kg_m2[2]
        centre_x, centre_y, _ = chassis.centre_of_mass_m
        places = [(x - centre_x, y - centre_y) for x, y, _ in chassis.wheels_m]
        rims = [left_m_s if k % 2 == 0 else right_m_s for k in range(4)]
        vx = 0.5 * (left_m_s + right_m_s)
        vy = 0.0
        turn = (right_m_s - left_m_s) / chassis.track_m
        forces: list[Force] = [(0.0, 0.0)] * 4
        for _ in range(round(_TURN_S / _TURN_STEP_S)):
            loads = self._loads(
                places, sum(fx for fx, _ in forces), sum(fy for _, fy in forces)
            )
            forces = []
            for (x, y), rim, load in zip(places, rims, loads, strict=True):
                slip_x = vx - turn * y - rim
                slip_y = vy + turn * x
                push = (
                    -self.robot.wheel_friction
                    * load
                    / max(math.hypot(slip_x, slip_y), _CREEP_M_S)
                )
                forces.append((push * slip_x, push * slip_y))
            moment = sum(
                x * fy - y * fx for (x, y), (fx, fy) in zip(places, forces, strict=True)
            )
            ax = sum(fx for fx, _ in forces) / mass + turn * vy
            ay = sum(fy for _, fy in forces) / mass - turn * vx
            vx, vy, turn = (
                vx + _TURN_STEP_S * ax,
                vy + _TURN_STEP_S * ay,
                turn + _TURN_STEP_S * moment / spin_inertia,
            )
            if max(abs(ax), abs(ay), abs(moment / spin_inertia)) < _STEADY:
                break
        return vx + turn * centre_y, turn

    def _loads(
        self, places: list[tuple[float, float]], fx: float, fy: float
    ) -> list[float]:
        """Return the loads (N) of wheels at corners of a rectangle, on equal springs.

        The forces act at the ground.
        """
        mass = self.robot.chassis.mass_kg
        count = len(places)
        mean_x = sum(x for x, _ in places) / count
        mean_y = sum(y for _, y in places) / count
        spread_x = sum((x - mean_x) ** 2 for x, _ in places)
        spread_y = sum((y - mean_y) ** 2 for _, y in places)
        weight = mass * GRAVITY_M_S2
        # moments about the middle of the wheels, with the weight at the origin
        pitch = -weight * mean_x - self.height_m * fx
        roll = -weight * mean_y - self.height_m * fy
        return [
            weight / count
            + pitch * (x - mean_x) / spread_x
            + roll * (y - mean_y) / spread_y
            for x, y in places
        ]
