"""A planner in a process of its own that goes wrong: plain rclpy, no suite.

Usage: ros_planner.py KIND FOLDER, where FOLDER may be written to.
"""

import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

GOOD_CYCLES = 10
KIND, FOLDER = sys.argv[1], Path(sys.argv[2])

if KIND == "import":
    import a_package_that_is_not_there  # type: ignore[import-not-found]  # noqa: F401
if KIND == "exits-early":
    sys.exit(0)
if KIND == "never-ready":
    time.sleep(600)

import rclpy  # noqa: E402
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.node import Node  # noqa: E402
from sensor_msgs.msg import LaserScan  # noqa: E402

SLEEP = [sys.executable, "-c", "import time; time.sleep(600)"]


def note(*pids: int) -> None:
    """Leave the ids of processes."""
    with (FOLDER / "pids").open("a") as file:
        file.write("".join(f"{pid}\n" for pid in pids))


def parents() -> list[int]:
    """Return the process ids of this one's ancestors, the guard first."""
    found, pid = [], os.getpid()
    while pid > 1:
        pid = int(Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[1])
        found.append(pid)
    return found


def siblings() -> None:
    """Kill every simulator that belongs to this run: the children of the guards of the same supervisor."""
    supervisor = next(pid for pid in parents() if b"guard.py" not in Path(f"/proc/{pid}/cmdline").read_bytes())
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and b"barn_sim.ros.simulator" in (entry / "cmdline").read_bytes():
            ancestors, pid = [], int(entry.name)
            while pid > 1:
                pid = int(Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[1])
                ancestors.append(pid)
            if supervisor in ancestors:
                os.kill(int(entry.name), signal.SIGKILL)


def escape() -> None:
    """Start a daemon as daemons are started: forked twice, in a session of its own, with an empty environment."""
    if os.fork() == 0:
        os.setsid()
        if os.fork() == 0:
            note(os.getpid())
            os.execve(sys.executable, SLEEP, {})
        os._exit(0)
    os.wait()


def loud() -> None:
    """Print 1 GB."""
    block = ("x" * 99 + "\n") * 10_000
    for _ in range(1000):
        sys.stdout.write(block)


def eat() -> None:
    """Take memory without end."""
    eaten = []
    while True:
        eaten.append(bytearray(50_000_000))


def loop() -> None:
    """Loop without end."""
    while True:
        pass


DEEDS: dict[str, Callable[[], object]] = {
    "first-scan": lambda: sys.exit("cannot read a scan"),
    "segfault": lambda: ctypes.string_at(0),
    "sleeps": lambda: time.sleep(600),
    "loops": loop,
    "stops-itself": lambda: os.kill(os.getpid(), signal.SIGSTOP),
    "loud": loud,
    "eats": eat,
    "shuts-down": rclpy.try_shutdown,
    "closes-files": lambda: os.closerange(3, 256),
    "kills-its-guard": lambda: os.kill(os.getppid(), signal.SIGKILL),
    "kills-the-simulator": siblings,
    "escapes": escape,
    "has-children": lambda: note(*(subprocess.Popen(SLEEP, start_new_session=True).pid for _ in range(3))),
    "kills-its-group": lambda: os.killpg(0, signal.SIGKILL),
}


class RosPlanner(Node):
    """Drives ahead at 0.5 m/s, and does its deed at a scan."""

    def __init__(self) -> None:
        super().__init__("ros_planner")
        self.cycles = 0
        stamped = KIND == "stale"
        topic = "command_velocity" if KIND == "wrong-topic" else "cmd_vel"
        self.commands = self.create_publisher(TwistStamped if stamped else Twist, topic, 10)
        self.seconds = [self.create_publisher(Twist, topic, 10)] if KIND == "two-publishers" else []
        self.create_subscription(LaserScan, "scan", self.answer, 10)
        if KIND != "no-odometry":
            self.create_subscription(Odometry, "odom", lambda _: None, 10)
        self.create_subscription(PoseStamped, "goal_pose", lambda _: None, 10)
        if KIND == "thousand-hertz":
            self.create_timer(0.001, lambda: self.commands.publish(self.command()))

    def command(self) -> "Twist | TwistStamped":
        """Return what is commanded."""
        twist = Twist()
        twist.linear.x = {"too-fast": 200.0, "huge": 1e300, "inf": float("inf")}.get(KIND, 0.5)
        if KIND == "stale":
            stamped = TwistStamped(twist=twist)
            stamped.header.stamp.sec = 1
            return stamped
        return twist

    def answer(self, _: LaserScan) -> None:
        """Answer a scan."""
        self.cycles += 1
        again = KIND == "kills-the-simulator" and self.cycles % GOOD_CYCLES == 0
        if KIND in DEEDS and (again or self.cycles == (1 if KIND == "first-scan" else GOOD_CYCLES)):
            DEEDS[KIND]()
        if KIND == "crashes" and self.cycles == GOOD_CYCLES:
            raise RuntimeError("out of ideas")
        self.commands.publish(self.command())
        for second in self.seconds:
            second.publish(self.command())


if __name__ == "__main__":
    if KIND == "ignores-signals":
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
            signal.signal(number, signal.SIG_IGN)
        rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    else:
        rclpy.init()
    if KIND == "start":
        raise RuntimeError("no such parameter: speed")
    rclpy.spin(RosPlanner())
