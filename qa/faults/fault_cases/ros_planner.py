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
from contextlib import suppress
from pathlib import Path
from threading import Thread

GOOD_CYCLES = 10
MARK = "BARN_TOOL_SESSION"
# Processes of the suite by what their command lines have, and that of the planner has
# not.
SUITE = {
    "simulator": "barn_sim.ros.simulator:",
    "evaluator": "barn_eval.ros.evaluator:",
    "guard": "launcher.py",
    "worker": "running.worker",
    "run": "-m barn_eval run",
}
KIND = sys.argv[1]
FOLDER = Path(sys.argv[2])

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
from std_msgs.msg import String  # noqa: E402

KEPT: list[object] = []
STAMPS = {"stale": 1, "future": 2_000_000_000}
SLEEP = [sys.executable, "-c", "import time; time.sleep(600)"]


def note(*pids: int) -> None:
    """Leave the namespace and the ids of processes."""
    namespace = Path("/proc/self/ns/pid").readlink()
    with (FOLDER / "pids").open("a") as file:
        file.write("".join(f"{namespace} {pid}\n" for pid in pids))


def signal_suite(what: str, number: int) -> None:
    """Signal, once, all processes of this run, and of no other, that are called so."""
    if (FOLDER / "done").exists():
        return
    mark = f"{MARK}={os.environ[MARK]}".encode()
    for entry in Path("/proc").iterdir():
        with suppress(OSError):
            if entry.name.isdigit() and mark in (entry / "environ").read_bytes().split(
                b"\0"
            ):
                words = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
                if SUITE[what] in words and int(entry.name) != 1:
                    (FOLDER / "done").touch()
                    os.kill(int(entry.name), number)


def escape() -> None:
    """Start a daemon as daemons are started.

    Forked twice, in a session of its own, with an empty environment.
    """
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


def crowd(planner: Node) -> None:
    """Make 5,000 topics in the midst of a trial."""
    KEPT.extend(planner.create_publisher(Twist, f"crowd_{k}", 1) for k in range(5000))


def meet(_: Node) -> None:
    """Make 400 nodes in the midst of a trial."""
    KEPT.extend(
        rclpy.create_node(f"crowd_{k}", enable_rosout=False) for k in range(400)
    )


def flood(planner: Node, megabytes: int) -> None:
    """Publish messages of some megabytes at 50 Hz while the scans are answered."""
    sender = planner.create_publisher(String, "flood", 10)
    message = String(data=megabytes * 1_000_000 * "x")

    def send() -> None:
        while True:
            sender.publish(message)
            time.sleep(0.02)

    Thread(target=send, daemon=True).start()


# What is done by a node: its deed gets it.
NODE_DEEDS: dict[str, Callable[[Node], object]] = {
    "crowd": crowd,
    "meet": meet,
    "floods": lambda planner: flood(planner, 4),
    "floods-slowly": lambda planner: flood(planner, 1),
}
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
    "kills-its-parent": lambda: os.kill(os.getppid(), signal.SIGKILL),
    "signals": lambda: signal_suite(sys.argv[3], int(sys.argv[4])),
    "escapes": escape,
    "has-children": lambda: note(
        *(subprocess.Popen(SLEEP, start_new_session=True).pid for _ in range(3))
    ),
    "kills-its-group": lambda: os.killpg(0, signal.SIGKILL),
}


class RosPlanner(Node):
    """Drives ahead at 0.5 m/s, and does its deed at a scan."""

    def __init__(self) -> None:
        super().__init__("ros_planner")
        self.cycles = 0
        stamped = KIND in STAMPS
        topic = "command_velocity" if KIND == "wrong-topic" else "cmd_vel"
        self.commands = self.create_publisher(
            TwistStamped if stamped else Twist, topic, 10
        )
        self.seconds = (
            [self.create_publisher(Twist, topic, 10)]
            if KIND == "two-publishers"
            else []
        )
        self.create_subscription(LaserScan, "scan", self.answer, 10)
        if KIND != "no-odometry":
            self.create_subscription(Odometry, "odom", lambda _: None, 10)
        self.create_subscription(PoseStamped, "goal_pose", lambda _: None, 10)
        if KIND == "thousand-hertz":
            self.create_timer(0.001, lambda: self.commands.publish(self.command()))

    def command(self) -> "Twist | TwistStamped":
        """Return what is commanded."""
        twist = Twist()
        twist.linear.x = {"too-fast": 200.0, "huge": 1e300, "inf": float("inf")}.get(
            KIND, 0.5
        )
        if KIND in STAMPS:
            stamped = TwistStamped(twist=twist)
            stamped.header.stamp.sec = STAMPS[KIND]
            return stamped
        return twist

    def answer(self, _: LaserScan) -> None:
        """Answer a scan."""
        self.cycles += 1
        if KIND in DEEDS and self.cycles == (
            1 if KIND == "first-scan" else GOOD_CYCLES
        ):
            DEEDS[KIND]()
        if KIND in NODE_DEEDS and self.cycles == GOOD_CYCLES:
            NODE_DEEDS[KIND](self)
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
