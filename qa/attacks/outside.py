"""Attacks from outside: bags, pages, a terminal, and conclusions; see `attacks.py`."""

import itertools
import math
import shutil
import sqlite3
import time
import tracemalloc
from contextlib import closing
from dataclasses import replace
from http import HTTPStatus
from http.client import HTTPConnection
from io import StringIO
from pathlib import Path
from typing import Any

from foreign_bags import edited, messages_of, write_bag
from inside import attack, drive
from planners import Steady, Straight, open_field, run_inline, spec_of
from rich.console import Console
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

import barn_eval as barn
from barn_eval.analysis.leaderboard import make_boards
from barn_eval.pages.live.server import PageServer
from barn_eval.results.bags.bagfile import BagFile
from barn_eval.running.direct import run_direct_trial
from barn_eval.running.judge import JudgeOptions, judge
from barn_eval.running.reporting import ConsoleReporter
from barn_eval.trials.protocol import CHALLENGE, Protocol
from barn_planners.interface import Decision, Observation, Planner, Task
from barn_worlds.base.types import Velocity2D
from barn_worlds.moving.motion import Motion, MovingObstacle
from barn_worlds.worlds.world import World

_SLOW_S = 0.2
_SLOW_CYCLES = 10
_TOPICS = 3000  # of one number, each with as many messages
_UNPACKED = 1 << 28


class Thinking(Planner):
    """Computes for long in every third trial, which may be the hard ones."""

    trials = itertools.count()

    def start(self, task: Task, seed: int) -> None:  # noqa: ARG002
        """Begin a trial."""
        self.cycles_left = 0
        if next(self.trials) % 3 == 0:
            self.cycles_left = _SLOW_CYCLES

    def step(self, observation: Observation) -> Decision:  # noqa: ARG002
        """Return the command of this cycle."""
        end_s = time.process_time() + _SLOW_S
        while self.cycles_left and time.process_time() < end_s:
            pass
        self.cycles_left = max(0, self.cycles_left - 1)
        return Decision(Velocity2D(0.5, 0.0))


class Shouting(Planner):
    """Fails with a text that steers the terminal."""

    def start(self, task: Task, seed: int) -> None:
        """Begin a trial."""

    def step(self, observation: Observation) -> Decision:  # noqa: ARG002
        """Raise an error."""
        raise RuntimeError("\x1b[2J\x1b[32mbetter than all \x9b1A\u202e")


def drive_to_win(world: World, protocol: Protocol, speed_mps: float) -> str:
    """Return why a trial of driving straight on has no efficiency above 1."""
    spec = spec_of(world, replace(protocol, name="own"), declared_mps=speed_mps)
    obstacles = replace(spec.simulator.obstacles, random_phase=False)
    spec = replace(spec, simulator=replace(spec.simulator, obstacles=obstacles))
    row = run_direct_trial(spec, planner=Steady(speed_mps)).result
    assert row.scores.success
    if row.scores.efficiency is None:
        return "no bound of time, and no efficiency"
    return f"{row.scores.efficiency:.3f}" if row.scores.efficiency <= 1.0 else ""


def find_note(folders: list[Path], words: str, **options: Any) -> str:
    """Return the note of a board with these words, empty if none has."""
    boards = make_boards(folders, **options)
    notes = [note for board in boards for note in board.notes]
    return next((note for note in notes if words in note), "")


@attack("bound/two-judges", "The truth starts the clock, and odometry ends the trial.")
def _(_folder: Path) -> str:
    judges = replace(
        CHALLENGE,
        clock_start_distance_m=0.5,
        clock_start_source="truth",
        goal_source="odometry",
    )
    return drive_to_win(open_field(), judges, 2.0)


@attack("bound/ram", "A moving obstacle pushes the robot to the goal.")
def _(_folder: Path) -> str:
    start = spec_of(open_field()).course.start
    keys = ((0.0, start.x, start.y - 2.0), (6.0, start.x, start.y + 16.0))
    motion = Motion(kind="linear", period_s=100.0, keys=keys)
    ram = MovingObstacle("ram", "box", size_x_m=2.0, size_y_m=0.5, motion=motion)
    unharmed = replace(CHALLENGE, collision_ends_trial=False)
    return drive_to_win(replace(open_field(), moving=(ram,)), unharmed, 0.5)


@attack("verdict/copies", "A rival is entered twice, so that tests are corrected for.")
def _(folder: Path) -> str:
    drive(folder / "a", Straight, "0")
    shutil.copytree(folder / "a", folder / "b")
    return find_note([folder / "a", folder / "b"], "equal commands")


@attack(
    "verdict/worlds", "A board has those worlds alone in which one's own planner won."
)
def _(folder: Path) -> str:
    drive(folder / "a", Straight, "0,30")
    return find_note([folder / "a"], "selected worlds", worlds="30")


@attack("computing/hard-worlds", "It computes for long in a third of its trials.")
def _(folder: Path) -> str:
    choices: Any = {"thinking": Thinking}
    run_inline("0,30,60", choices, out=folder / "a", seed=5)
    return find_note([folder / "a"], "times as fast")


@attack("terminal/escapes", "What a planner raises clears the screen and writes on it.")
def _(folder: Path) -> str:
    text = StringIO()
    console = Console(file=text, width=80)
    drive(folder / "a", Shouting, "0", progress=ConsoleReporter(console))
    texts = (text.getvalue(), barn.load(folder / "a").trials[0].detail)
    assert all("better than all" in words for words in texts)
    if any(not c.isprintable() and c != "\n" for words in texts for c in words):
        return ""
    return f"printed without them: {texts[1]}"


@attack("bag/join", "Many topics of one number multiply the messages of an SQLite bag.")
def _(folder: Path) -> str:
    path = folder / "bag.db3"
    with closing(sqlite3.connect(path)) as database:
        database.executescript(
            "CREATE TABLE topics(id INT, name, type, serialization_format);"
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data);"
        )
        topics = [(1, "/odom", "nav_msgs/msg/Odometry", "cdr")] * _TOPICS
        messages = [(1, number, b"") for number in range(_TOPICS)]
        database.executemany("INSERT INTO topics VALUES (?, ?, ?, ?)", topics)
        database.executemany("INSERT INTO messages VALUES (NULL, ?, ?, ?)", messages)
        database.commit()
    count = sum(1 for _ in BagFile(path).messages())
    return f"{count} messages" if count <= _TOPICS else ""


@attack("bag/bomb", "A chunk of a ROS 1 bag unpacks to a million times its size.")
def _(folder: Path) -> str:
    types = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer(folder / "bomb.bag")
    writer.set_compression(Writer.CompressionFormat.BZ2)
    with writer:
        topic = writer.add_connection("/text", "std_msgs/msg/String", typestore=types)
        writer.write(topic, 1, bytes(_UNPACKED))
    tracemalloc.start()
    try:
        messages = list(BagFile(folder / "bomb.bag").messages())
        seen = f"{len(messages)} messages"
    except barn.BarnError as error:
        seen = str(error)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return seen if peak < _UNPACKED // 4 else ""


@attack("bag/clock", "Stamps and twist of a robot's bag are those of a faster robot.")
def _(folder: Path) -> str:
    bag = drive(folder / "a", "gap", "0", bags="all") / "bags" / "gap_w0000_r00"

    def hasten(odometry: Any) -> None:
        stamp = odometry.header.stamp
        stamp_s = (stamp.sec + 1e-9 * stamp.nanosec) / 2.0
        stamp.sec = math.floor(stamp_s)
        stamp.nanosec = int(1e9 * (stamp_s - stamp.sec))
        odometry.twist.twist.linear.x *= 2.0

    messages = [
        edited(message, hasten) if message.topic == "/odom" else message
        for message in messages_of(bag)
        if message.topic in ("/odom", "/cmd_vel", "/goal_pose", "/collision")
    ]
    write_bag(folder / bag.name, messages)
    _, (row,) = judge([folder / bag.name], folder / "out", JudgeOptions())
    return row.remarks


@attack("server/origin", "A page of another site asks for the state of a run.")
def _(folder: Path) -> str:
    drive(folder / "a", Straight, "0")
    with PageServer(folder / "a", port=0) as server:
        _, _, place = server.url.strip("/").partition("//")
        connection = HTTPConnection(place, timeout=30.0)
        connection.request("GET", "/state", headers={"Origin": "http://evil.test"})
        answer = connection.getresponse()
        text = f"{answer.status}: {answer.read().decode()}"
        connection.close()
    return "" if answer.status == HTTPStatus.OK else text
