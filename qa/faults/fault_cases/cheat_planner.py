"""A planner in a process of its own that tries to win by other means than driving.

Plain rclpy, no suite.

Usage: cheat_planner.py KIND FOLDER OUT: it drives ahead and does its deed at a scan.
FOLDER may be written to, what it has found goes to FOLDER/found; OUT is the folder of
results.
"""

import json
import os
import socket
import subprocess
import sys
import time
import zlib
from collections.abc import Callable
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String
from std_srvs.srv import Trigger

CYCLE = 10  # at which the deed is done
LARGE = 4_000_000  # bytes of a text
KIND = sys.argv[1]
FOLDER = Path(sys.argv[2])
OUT = Path(sys.argv[3])
KEPT: list[object] = []


def report(text: object) -> None:
    """Leave what was found."""
    with (FOLDER / "found").open("a") as file:
        file.write(f"{text}\n")


def list_other_processes() -> list[str]:
    """Return the processes that have to do with trials.

    This process and its parents are left out.
    """
    pids = []
    for entry in Path("/proc").iterdir():
        with suppress(OSError):
            words = (
                (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
                if entry.name.isdigit()
                else ""
            )
            if (
                any(name in words for name in ("barn_sim", "barn_eval", "launcher.py"))
                and __file__ not in words
            ):
                pids.append(entry.name)
    return pids


def look_into_memory(_: Node) -> None:
    """Open the memory of other processes, as a debugger does."""
    pids = list_other_processes()
    report(f"{len(pids)} of the suite's processes")
    for pid in pids:
        with Path(f"/proc/{pid}/mem").open("r+b"):
            report("opened the memory of one of them")


def look_for_the_line(_: Node) -> None:
    """Ask for a reset of the simulator through each socket that can be reached.

    These are the sockets of this process and all that have a name.
    """
    message = json.dumps({"id": 1, "ask": "reset", "what": "reset"}).encode() + b"\n"
    lines = Path("/proc/net/unix").read_text().splitlines()
    unix = [line.split() for line in lines[1:]]
    accepted = 0
    for entry in list(Path("/proc/self/fd").iterdir()):
        with suppress(OSError), socket.socket(fileno=os.dup(int(entry.name))) as line:
            if line.family == socket.AF_UNIX:
                accepted += bool(line.send(message, socket.MSG_DONTWAIT))
    for name in {
        fields[7] for fields in unix if len(fields) > 7 and "barn" in fields[7]
    }:
        for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM, socket.SOCK_SEQPACKET):
            with suppress(OSError), socket.socket(socket.AF_UNIX, kind) as line:
                line.connect(name.replace("@", "\0", 1))
                accepted += bool(line.send(message, socket.MSG_DONTWAIT))
    report(f"{accepted} sockets took it")


def write_results(_: Node) -> None:
    """Add to the rows, make a bag, and remove all results."""
    inside = [["touch", "results.jsonl"], ["mkdir", "another"], ["rm", "run.json"]]
    for words in (
        *([name, f"{OUT}/{file}"] for name, file in inside),
        ["mv", f"{OUT}", f"{OUT}-"],
    ):
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        report(done.stderr.rpartition(": ")[2].strip() or "done")


def edit_results(_: Node) -> None:
    """Make a success of the row of an earlier trial, with the right checksum."""
    if (rows := OUT / "results.jsonl").exists():
        row = json.loads(rows.read_text())
        del row["crc32"]
        row |= {"outcome": "success", "fault": "", "detail": ""}
        row["scores"] |= {
            "success": True,
            "challenge": 0.5,
            "traversal_time_s": row["scores"]["duration_s"],
        }
        line = json.dumps(row, separators=(",", ":"))
        checksum = zlib.crc32(line.encode())
        rows.write_text(f'{line[:-1]},"crc32":"{checksum:08x}"}}\n')
        report("edited")


def read_the_seed(_: Node) -> None:
    """Read what this trial is from the evaluator's file."""
    for path in OUT.rglob("assignment.json"):
        assignment = json.loads(path.read_text())
        report(f"seed {assignment['run']['seed']}")
    report(f"{len(list(OUT.iterdir()))} files")


def look_at_the_suite(_: Node) -> None:
    """Report whether the suite's packages and compiled kernels may be written to."""
    package = find_spec("barn_eval")
    may = package is not None and os.access(str(package.origin), os.W_OK)
    report(f"may {'' if may else 'not '}write to them")


def fill_shared_memory(_: Node) -> None:
    """Fill the folder for shared memory."""
    path = Path("/dev", "shm", "barn_cheat")
    with suppress(OSError), path.open("wb", buffering=0) as file:
        while True:
            file.write(bytes(1 << 16))
    report(f"{path.stat().st_size} bytes")


def start(count: int, code: str) -> None:
    """Start processes, each in a session of its own."""
    KEPT.extend(
        subprocess.Popen([sys.executable, "-S", "-c", code], start_new_session=True)
        for _ in range(count)
    )
    report(f"{count} processes")


def remember(_: Node) -> None:
    """Look for what an earlier trial has left, and leave something."""
    is_left = (FOLDER / "memory").exists()
    report("something is left" if is_left else "nothing is left")
    (FOLDER / "memory").touch()


def enter(_: Node) -> None:
    """Be a guest on the domain of another run, until that is over."""
    words = [sys.executable, __file__, "guest", *sys.argv[2:4]]
    with subprocess.Popen(
        words, env=os.environ | {"ROS_DOMAIN_ID": sys.argv[4]}
    ) as process:
        while not (FOLDER / "over").exists():
            time.sleep(0.1)
        process.kill()


def visit() -> None:
    """Publish positions at no place in particular, once the other run drives."""
    (FOLDER / "ready").touch()
    while not (FOLDER / "go").exists():
        time.sleep(0.1)
    rclpy.init()
    node = Node("guest")
    sender = node.create_publisher(Odometry, "odom", 10)
    while True:
        sender.publish(Odometry())
        time.sleep(0.05)


def publish(node: Node, kind: type, topic: str, message: object) -> None:
    """Publish a message now and with each scan."""
    sender = node.create_publisher(kind, topic, 10)
    KEPT.append(
        node.create_subscription(
            LaserScan, "scan", lambda _: sender.publish(message), 10
        )
    )


def ask(node: Node, kind: type, service: str, request: object) -> None:
    """Call a service of another node."""
    client = node.create_client(kind, service)
    KEPT.append(client.call_async(request))


def set_clock(node: Node) -> None:
    """Have the evaluator go by /clock, which anybody may publish."""
    value = Parameter(
        name="use_sim_time", value=ParameterValue(type=1, bool_value=True)
    )
    ask(
        node,
        SetParameters,
        "/evaluator/set_parameters",
        SetParameters.Request(parameters=[value]),
    )


DEEDS: dict[str, Callable[[Node], object]] = {
    "forged-scans": lambda node: publish(node, LaserScan, "scan", LaserScan()),
    "outcome": lambda node: publish(node, String, "outcome", String(data="success")),
    "step": lambda node: ask(node, Trigger, "/simulator/step", Trigger.Request()),
    "evaluators-name": lambda _: KEPT.append(rclpy.create_node("evaluator")),
    "evaluators-clock": set_clock,
    "memory": look_into_memory,
    "line": look_for_the_line,
    "writes": write_results,
    "edits": edit_results,
    "seed": read_the_seed,
    "suite": look_at_the_suite,
    "shared-memory": fill_shared_memory,
    "forks": lambda _: start(500, "import time; time.sleep(600)"),
    "processor": lambda _: start(6, "while True: pass"),
    "remembers": remember,
    "enters": enter,
}


class CheatPlanner(Node):
    """Drives ahead at 0.5 m/s, and does its deed at a scan."""

    def __init__(self) -> None:
        super().__init__("cheat", start_parameter_services=KIND != "huge-parameters")
        self.cycles = 0
        self.commands = self.create_publisher(Twist, "cmd_vel", 10)
        self.create_subscription(LaserScan, "scan", self.answer, 10)
        self.create_subscription(Odometry, "odom", lambda _: None, 10)
        self.create_subscription(PoseStamped, "goal_pose", lambda _: None, 10)
        self.twist = Twist()
        self.twist.linear.x = 0.5
        if KIND == "huge-answer":
            self.create_service(Trigger, "~/ready", self.refuse)
        if KIND == "huge-parameters":
            self.create_service(ListParameters, "~/list_parameters", self.answer_list)
            self.create_service(GetParameters, "~/get_parameters", self.answer_get)
        if KIND == "deaf-parameters":
            KEPT.extend(
                rclpy.create_node(f"deaf_{k}", enable_rosout=False) for k in range(20)
            )
            KEPT.extend(
                node.create_publisher(String, "words", 1)
                for node in tuple(KEPT)
                if isinstance(node, Node)
            )

    def refuse(
        self, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        """Say at length that the planner is not ready."""
        response.message = "x" * LARGE
        return response

    def answer_list(
        self, _: ListParameters.Request, response: ListParameters.Response
    ) -> ListParameters.Response:
        """Name 20,000 parameters of 1,000 characters."""
        response.result.names = [f"{k:05d}" + "x" * 1000 for k in range(20_000)]
        return response

    def answer_get(
        self, request: GetParameters.Request, response: GetParameters.Response
    ) -> GetParameters.Response:
        """Tell 40 kB of each."""
        response.values = [
            ParameterValue(type=4, string_value=",[{x" * 10_000) for _ in request.names
        ]
        return response

    def answer(self, _: LaserScan) -> None:
        """Answer a scan."""
        self.cycles += 1
        if KIND in DEEDS and self.cycles == CYCLE:
            DEEDS[KIND](self)
        if KIND == "thinks":
            time.sleep(0.3)
        self.commands.publish(self.twist)


if __name__ == "__main__":
    if KIND == "helper":
        words = [
            sys.executable,
            __file__,
            "drives",
            *sys.argv[2:4],
            "--ros-args",
            "-r",
            "__node:=helper",
        ]
        KEPT.append(subprocess.Popen(words))
    if KIND == "guest":
        visit()
    rclpy.init()
    executor = SingleThreadedExecutor()
    executor.add_node(CheatPlanner())
    executor.spin()
