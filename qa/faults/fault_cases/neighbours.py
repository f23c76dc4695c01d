"""Runs over ROS beside each other, and strangers on their domain."""

import signal
import sys

from barn_worlds.base.errors import ExitCode
from fault_cases.kit import Lab, Skipped, case, hold, repeatable
from fault_cases.processes import FAMILY, run_undisturbed, same, start_driving, words
from fault_cases.system import kill


@case(FAMILY)
def two_runs_in_one_folder(lab: Lab) -> str:
    """Two equal runs are started at once in one folder.

    One of them runs; the other is refused in one line, and touches nothing.
    """
    both = [lab.start(*words(lab)) for _ in range(2)]
    ended = [lab.finish(run, None) for run in both]
    hold(
        sorted(session.code for session in ended) == [0, ExitCode.REFUSED],
        [session.text[-300:] for session in ended],
    )
    refusal = next(session.error for session in ended if session.code)
    hold("another process is working in this folder" in refusal, refusal)
    same(lab)
    return refusal


@case(FAMILY)
def two_runs_in_two_folders(lab: Lab) -> str:
    """Two equal runs are started at once in two folders.

    They do not hear each other: both rows are the undisturbed one.
    """
    first_words = words(lab)
    second_words = words(lab)
    second_words[second_words.index("--out") + 1] = lab.folder / "other"
    both = [lab.start(*first_words), lab.start(*second_words)]
    for run in both:
        lab.finish(run)
    rows = [repeatable(lab.rows(folder)) for folder in (lab.out, lab.folder / "other")]
    hold(rows[0] == rows[1] == run_undisturbed(), "the rows differ")
    return "both rows as undisturbed"


@case(FAMILY)
def domain_in_use(lab: Lab) -> str:
    """A run is told to use the ROS_DOMAIN_ID of another one, which is driving and
    stands still meanwhile (SIGSTOP).

    Refused in one line that names the domain; the other run goes on to the undisturbed
    row, but for a command that may be lost.
    """
    domain = {"ROS_DOMAIN_ID": "77"}
    run = start_driving(lab, environment=domain)
    first = lab.processes()
    kill(first, signal.SIGSTOP)
    second = "run --mode ros --worlds 0 --out"
    refusal = lab.expect_refusal(
        *second.split(),
        lab.folder / "second",
        environment=domain,
        code=ExitCode.NOT_SCORED,
    )
    hold("ROS_DOMAIN_ID 77" in refusal, refusal)
    kill(first, signal.SIGCONT)
    lab.finish(run)
    same(lab, lost=1)
    return refusal


@case(FAMILY)
def domain_that_is_none(lab: Lab) -> str:
    """ROS_DOMAIN_ID is 4000.

    Refused in one line that names it and what is allowed.
    """
    nowhere = {"ROS_DOMAIN_ID": "4000"}
    refusal = lab.expect_refusal(
        *words(lab), environment=nowhere, code=ExitCode.NOT_SCORED
    )
    hold("ROS_DOMAIN_ID must be from 0 to 232, got '4000'" in refusal, refusal)
    return refusal


_CHATTER = """
import sys
import rclpy
from geometry_msgs.msg import Twist
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("chatter")
words, commands = node.create_publisher(String, "chatter", 10), node.create_publisher(Twist, "other/cmd_vel", 10)
node.create_timer(0.01, lambda: (words.publish(String(data="x" * 1000)), commands.publish(Twist())))
rclpy.spin(node)
"""


@case(FAMILY)
def strangers_on_the_domain(lab: Lab) -> str:
    """Three nodes of nobody's talk on the domain of a run, on topics of their own.

    The row is the undisturbed one, without a remark.
    """
    run_undisturbed()
    near = {"ROS_DOMAIN_ID": "78", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    strangers = [
        lab.start_program([sys.executable, "-c", _CHATTER], near) for _ in range(3)
    ]
    lab.barn(*words(lab), environment=near)
    for stranger in strangers:
        hold(stranger.poll() is None, "a stranger has ended")
        stranger.kill()
        stranger.wait()
    return same(lab)


@case(FAMILY)
def simulators_of_strangers(lab: Lab) -> str:
    """A second simulator publishes /clock, /odom and /scan on the domain that a run is
    told to use.

    Refused in one line that names the domain, the node and a topic, before the planner
    is started.
    """
    near = {"ROS_DOMAIN_ID": "79", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    other = lab.start_program(
        [
            sys.executable,
            "-m",
            "barn_sim.ros.simulator",
            "--ros-args",
            "-r",
            "__node:=other",
        ],
        near,
    )
    if other.poll() is not None:
        raise Skipped("no second simulator")
    refusal = lab.expect_refusal(
        *words(lab), environment=near, code=ExitCode.NOT_SCORED
    )
    other.kill()
    other.wait()
    hold("ROS_DOMAIN_ID 79: /other publishes" in refusal, refusal)
    return refusal
