"""IR-SIM as a ROS 2 node that the evaluator judges: worlds of the suite, in IR-SIM.

    pip install ir-sim
    python examples/ir_sim/bridge.py &
    barn run --system examples/ir_sim/ir_sim.yaml --worlds 0:300:60 --planner gap

Parameters name world and start; ~/reset builds them. Odometry is exact, in the frame of
the world. Time passes at up to `pace` times real time; a step waits for a command, but
no longer than `command_wait_s`.
"""

import math
import tempfile
import time
from pathlib import Path

import irsim
import numpy as np
import rclpy
import yaml
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.robots.files import load_robot
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.world import World

STEP_S = 0.05
BEAMS = 181
SIDES = 8  # of a cylinder
MARGIN_M = 12.0  # of IR-SIM's world around the obstacles, for goals beyond them
PARAMETERS = {
    "dataset": "barn300",
    "world": 0,
    "robot": "jackal",
    "seed": 0,
    "start_x_m": -2.25,
    "start_y_m": 3.0,
    "start_yaw_rad": 1.57,
    "pace": 1.0,
    "command_wait_s": 0.5,
}


def ir_sim_world(world: World, robot: Robot, start: list[float]) -> dict:
    """Return the content of an IR-SIM file: a world's cylinders and a robot in it."""
    low_x, low_y, high_x, high_y = world.bounds_m
    lidar = robot.lidar
    # IR-SIM casts each beam against each side, so circles would take seconds a scan.
    # The polygons are around the circles: between any inside them, beams would pass.
    radius_m = world.cylinder_radius_m / math.cos(math.pi / SIDES)
    corners = []
    for angle in (2.0 * math.pi * (np.arange(SIDES) + 0.5) / SIDES).tolist():
        x, y = math.cos(angle), math.sin(angle)
        corners.append([radius_m * x, radius_m * y])
    return {
        "world": {
            "width": high_x - low_x + 2.0 * MARGIN_M,
            "height": high_y - low_y + 2.0 * MARGIN_M,
            "offset": [low_x - MARGIN_M, low_y - MARGIN_M],
            "step_time": STEP_S,
            "collision_mode": "stop",
        },
        "robot": [
            {
                "kinematics": {"name": "diff"},
                "shape": {
                    "name": "rectangle",
                    "length": robot.length_m,
                    "width": robot.width_m,
                },
                "state": start,
                "goal": [1e3, 1e3, 0.0],
                "vel_min": [
                    -robot.drive.max_speed_m_s,
                    -robot.drive.max_yaw_rate_rad_s,
                ],
                "vel_max": [robot.drive.max_speed_m_s, robot.drive.max_yaw_rate_rad_s],
                "acce": [
                    robot.drive.max_acceleration_m_s2,
                    robot.drive.max_yaw_acceleration_rad_s2,
                ],
                "sensors": [
                    {
                        "name": "lidar2d",
                        "range_min": lidar.range_min_m,
                        "range_max": lidar.range_max_m,
                        "angle_range": lidar.angle_max_rad - lidar.angle_min_rad,
                        "number": BEAMS,
                        "offset": [lidar.mount_x_m, 0.0, 0.0],
                    }
                ],
            }
        ],
        "obstacle": [
            {
                "number": len(world.cylinders_m),
                "distribution": {"name": "manual"},
                "shape": [{"name": "polygon", "vertices": corners}],
                "state": [[x, y, 0.0] for x, y in world.cylinders_m.tolist()],
            }
        ],
    }


class Bridge(Node):
    """Steps IR-SIM and publishes what its robot measures."""

    def __init__(self) -> None:
        """Offer ~/reset; nothing moves before its first call."""
        super().__init__("ir_sim")
        for name, value in PARAMETERS.items():
            self.declare_parameter(name, value)
        self.environment = None
        self.steps = 0
        self.stepped_s = 0.0
        self.is_answered = False
        self.command = Twist()
        self.clock = self.create_publisher(Clock, "/clock", 10)
        self.odometry = self.create_publisher(Odometry, "odom", 10)
        self.scans = self.create_publisher(LaserScan, "scan", 10)
        self.contacts = self.create_publisher(Bool, "collision", 10)
        self.create_subscription(Twist, "cmd_vel", self.take_command, 10)
        self.create_service(Trigger, "~/reset", self.reset)
        self.timer = self.create_timer(STEP_S, self.step)

    def value(self, name: str):
        """Return the value of a parameter."""
        return self.get_parameter(name).value

    def take_command(self, message: Twist) -> None:
        """Keep a command until the next one."""
        self.command = message
        self.is_answered = True

    def reset(self, _: Trigger.Request, response: Trigger.Response):
        """Build the world of the parameters, with the robot at its start."""
        robot = load_robot(self.value("robot"))
        world = open_dataset(self.value("dataset")).load(self.value("world"))
        start = [self.value(f"start_{name}") for name in ("x_m", "y_m", "yaw_rad")]
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "world.yaml")
            file.write_text(yaml.safe_dump(ir_sim_world(world, robot, start)), "utf-8")
            self.environment = irsim.make(
                str(file), headless=True, log_level="ERROR", seed=self.value("seed")
            )
        self.command = Twist()
        self.timer.timer_period_ns = int(1e9 * STEP_S / self.value("pace"))
        response.success = True
        response.message = f"{world.name}, ir-sim {irsim.__version__}"
        return response

    def step(self) -> None:
        """Advance by a step, and publish clock, contact, odometry and scan."""
        if self.environment is None:
            return
        # A busy machine would otherwise hand the planner old scans.
        waited_s = time.monotonic() - self.stepped_s
        if not self.is_answered and waited_s < self.value("command_wait_s"):
            return
        self.is_answered = False
        self.stepped_s = time.monotonic()
        velocity = [self.command.linear.x, self.command.angular.z]
        self.environment.step(velocity)
        self.steps += 1
        stamp = rclpy.time.Time(nanoseconds=round(1e9 * STEP_S) * self.steps).to_msg()
        self.clock.publish(Clock(clock=stamp))
        robot = self.environment.robot
        self.contacts.publish(Bool(data=bool(robot.collision_flag)))
        self.odometry.publish(self.odometry_message(robot, stamp))
        self.scans.publish(self.scan_message(stamp))

    def odometry_message(self, robot, stamp) -> Odometry:
        """Return pose and twist of IR-SIM's robot."""
        x, y, yaw = robot.state[:3, 0].tolist()
        message = Odometry()
        message.header.stamp = stamp
        message.header.frame_id = "odom"
        message.child_frame_id = "base_link"
        message.pose.pose.position.x = x
        message.pose.pose.position.y = y
        message.pose.pose.orientation.z = math.sin(0.5 * yaw)
        message.pose.pose.orientation.w = math.cos(0.5 * yaw)
        linear, angular = robot.velocity[:2, 0].tolist()
        message.twist.twist.linear.x = linear
        message.twist.twist.angular.z = angular
        return message

    def scan_message(self, stamp) -> LaserScan:
        """Return the lidar's scan; beams that hit nothing are infinite (REP-117)."""
        scan = self.environment.get_lidar_scan()
        farthest = float(scan["range_max"])
        ranges = []
        for distance in map(float, scan["ranges"]):
            ranges.append(distance if distance < farthest else math.inf)
        message = LaserScan(ranges=ranges, range_max=farthest)
        message.header.stamp = stamp
        message.header.frame_id = "lidar_link"
        message.angle_min = float(scan["angle_min"])
        message.angle_max = float(scan["angle_max"])
        message.angle_increment = float(scan["angle_increment"])
        message.range_min = float(scan["range_min"])
        return message


if __name__ == "__main__":
    rclpy.init()
    try:
        rclpy.spin(Bridge())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except rclpy_implementation.RCLError:
        # Ctrl-C may come in the middle of a step, which then cannot publish.
        if rclpy.ok():
            raise
