"""A robot that is only numbers, with a driver to the goal: for tests of live trials.

It has no /clock, its odometry begins anywhere and is two seconds off. Each call of its
reset is the next of the faults in its arguments. For a fault named simulator, services
of simulation_interfaces reset it and put it somewhere.
"""

import sys
import time
from math import atan2, cos, hypot, sin

import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

PERIOD_S = 0.02
CLOCK_S = -2.0


class Robot(Node):
    """Integrates commands; publishes odometry, scans and contacts in real time."""

    def __init__(self, faults):
        super().__init__("robot")
        self.faults = faults
        self.fault = ""
        self.pose = (3.2, -7.5, 2.1)
        self.driven_m = 0.0
        self.command = Twist()
        self.odometry = self.create_publisher(Odometry, "robot/odom", 10)
        self.scans = self.create_publisher(LaserScan, "robot/scan", 10)
        self.contacts = self.create_publisher(Bool, "robot/bumper", 10)
        self.create_subscription(Twist, "robot/cmd_vel", self.on_command, 10)
        self.create_service(Trigger, "robot/reset", self.on_reset)
        self.create_timer(PERIOD_S, self.step)

    def offer_interfaces(self):
        """Offer two services of simulation_interfaces, where the package is."""
        from simulation_interfaces.srv import (  # noqa: PLC0415
            ResetSimulation,
            SetEntityState,
        )

        reset = "robot/reset_simulation"
        self.create_service(ResetSimulation, reset, self.on_reset_simulation)
        place = "robot/set_entity_state"
        self.create_service(SetEntityState, place, self.on_place)

    def on_reset_simulation(self, request, response):
        self.on_reset(request, Trigger.Response())
        self.pose = (0.0, 0.0, 0.0)
        # Resets of state only.
        response.result.result = 1 if request.scope == 2 else 0
        return response

    def on_place(self, request, response):
        response.result.result = 1
        if request.entity != "jackal":
            response.result.result = 2
            response.result.error_message = f"no entity {request.entity}"
        pose = request.state.pose
        yaw = 2.0 * atan2(pose.orientation.z, pose.orientation.w)
        self.pose = (pose.position.x, pose.position.y, yaw)
        return response

    def on_command(self, message):
        self.command = message

    def on_reset(self, _, response):
        self.fault = self.faults.pop(0)
        self.driven_m = 0.0
        self.command = Twist()
        response.success = True
        return response

    def step(self):
        x, y, yaw = self.pose
        way_m = self.command.linear.x * PERIOD_S
        self.driven_m += way_m
        yaw += self.command.angular.z * PERIOD_S
        self.pose = (x + way_m * cos(yaw), y + way_m * sin(yaw), yaw)
        half_way = self.driven_m > 4.0
        if self.fault == "gap" and 4.0 < self.driven_m < 6.0:
            return
        stamp_s = time.time() + CLOCK_S
        if self.fault == "clock" and half_way:
            stamp_s += 30.0
        if self.fault == "stamp" and 4.0 < self.driven_m < 4.2:
            stamp_s += 3e8
        message = Odometry()
        message.header.frame_id = "odom"
        message.header.stamp.sec = int(stamp_s)
        message.header.stamp.nanosec = int(stamp_s % 1.0 * 1e9)
        message.pose.pose.position.x, message.pose.pose.position.y, _ = self.pose
        message.pose.pose.orientation.z = sin(0.5 * yaw)
        message.pose.pose.orientation.w = cos(0.5 * yaw)
        message.twist.twist = self.command
        self.contacts.publish(Bool(data=self.fault == "contact" and half_way))
        self.odometry.publish(message)
        scan = LaserScan(
            header=message.header,
            angle_min=-2.0,
            angle_max=2.0,
            angle_increment=0.1,
            range_max=10.0,
            ranges=[float("inf")] * 41,
        )
        self.scans.publish(scan)


class Driver(Node):
    """Drives straight to the goal in the frame of the odometry."""

    def __init__(self):
        super().__init__("driver")
        self.goal = None
        self.commands = self.create_publisher(Twist, "robot/cmd_vel", 10)
        self.create_subscription(PoseStamped, "goal_pose", self.on_goal, 10)
        self.create_subscription(Odometry, "robot/odom", self.on_odometry, 10)
        self.create_subscription(LaserScan, "robot/scan", lambda _: None, 10)

    def on_goal(self, message):
        self.goal = message.pose.position

    def on_odometry(self, message):
        command = Twist()
        pose = message.pose.pose
        if self.goal:
            dx = self.goal.x - pose.position.x
            dy = self.goal.y - pose.position.y
            yaw = 2.0 * atan2(pose.orientation.z, pose.orientation.w)
            error = atan2(dy, dx) - yaw
            if hypot(dx, dy) > 0.9:
                command.linear.x = 5.0
                command.angular.z = 4.0 * atan2(sin(error), cos(error))
            else:
                self.goal = None
        self.commands.publish(command)


class Operator(Node):
    """Starts the trial of a robot, and tells of a contact on the way."""

    def __init__(self, robot):
        super().__init__("operator")
        self.robot = robot
        self.start = self.create_client(Trigger, "evaluator/start")
        self.contact = self.create_client(Trigger, "evaluator/contact")
        self.create_timer(0.2, self.look)

    def look(self):
        client = self.contact if self.robot.driven_m > 1.0 else self.start
        if client.service_is_ready() and self.robot.driven_m < 6.0:
            client.call_async(Trigger.Request())


if __name__ == "__main__":
    rclpy.init()
    executor = rclpy.executors.SingleThreadedExecutor()
    robot = Robot(sys.argv[1].split(","))
    executor.add_node(robot)
    executor.add_node(Driver())
    if sys.argv[1] == "simulator":
        robot.offer_interfaces()
    if sys.argv[1] == "operator":
        executor.add_node(Operator(robot))
    executor.spin()
