"""The live view: what a trial records reaches whoever watches, message by message, and
costs the trial nothing.
"""

import re
import signal
import socket
import subprocess
import time
from contextlib import closing

import pytest
from live_client import LiveClient
from refusals import refused
from text_tables import rows_of
from waiting import barn_words

from barn_eval.pages.live import foxglove as live
from barn_eval.pages.live.gate import Gate
from barn_eval.results.bags.bagfile import TrialFollower
from barn_eval.results.bags.recorder import Recorder
from barn_eval.results.run_file import RunFile
from barn_eval.trials.run_config import RunConfig
from barn_worlds.base.errors import BagError
from barn_worlds.messages.encode import encode_number, encode_text
from barn_worlds.messages.topics import (
    CMD_VEL,
    COLLISION,
    OUTCOME,
    ROBOT_DESCRIPTION,
    SCORE,
    WORLD_PATH,
    OutgoingMessage,
)

SECOND = 10**9


@pytest.fixture
def view(tmp_path):
    pytest.importorskip(
        "foxglove", reason="foxglove-sdk, an optional extra, is not installed"
    )
    with closing(live.FoxgloveStream(tmp_path, host="127.0.0.1", port=0)) as view:
        yield view


def record(recorder, first, last):
    """Write a score each second, and a text that is latched in the first."""
    for topic in (SCORE, OUTCOME, ROBOT_DESCRIPTION):
        recorder.add_topic(topic.path, topic.type_name, topic.qos)
    if not first:
        recorder.write(ROBOT_DESCRIPTION.path, encode_text("a robot"), 0)
    for second in range(first, last):
        recorder.write(SCORE.path, encode_number(float(second)), second * SECOND)


def stamps(heard, topic=SCORE):
    return [
        message.stamp_ns // SECOND for message in heard if message.topic == topic.path
    ]


def test_a_bag_is_followed_by_the_next_trials_bag(tmp_path):
    follower = TrialFollower(tmp_path)
    assert follower.read() == (False, [])
    with Recorder(tmp_path / "bags" / "one") as recorder:
        record(recorder, 0, 4)
        another, heard = follower.read()
        assert (another, stamps(heard)) == (True, [0, 1, 2, 3])
        assert (heard[0].data, heard[0].type_name) == (
            encode_text("a robot"),
            ROBOT_DESCRIPTION.type_name,
        )
        assert follower.read() == (False, [])
        record(recorder, 4, 6)
        assert stamps(follower.read()[1]) == [4, 5]
        record(recorder, 6, 7)
        recorder.finish()
    assert stamps(follower.read()[1]) == [6]
    assert follower.read() == (False, [])  # it has ended, and there is no other
    with Recorder(tmp_path / "bags" / "two") as recorder:
        record(recorder, 0, 3)
        another, heard = follower.read()
        assert (another, stamps(heard)) == (True, [0, 1, 2])
        follower.close()


def test_a_trial_that_was_left_is_left_for_a_newer_one(tmp_path):
    follower = TrialFollower(tmp_path)
    with Recorder(tmp_path / "bags" / "left") as recorder:
        record(recorder, 0, 3)
    assert stamps(follower.read()[1]) == [0, 1, 2]
    time.sleep(0.02)  # so that the files differ in time
    with Recorder(tmp_path / "bags" / "new") as recorder:
        record(recorder, 5, 8)
        assert stamps(follower.read()[1]) == [5, 6, 7]
        follower.close()


@pytest.mark.parametrize(
    "size, words", [(1 << 40, "damaged: a record of"), (20, "damaged")]
)
def test_what_is_no_bag_is_refused(tmp_path, size, words):
    path = tmp_path / "bags" / "a.partial" / "a.mcap"
    path.parent.mkdir(parents=True)
    path.write_bytes(
        b"\x89MCAP0\r\n" + b"\x06" + size.to_bytes(8, "little") + bytes(20)
    )
    with refused(words, BagError):
        TrialFollower(tmp_path).read()


def test_without_the_sdk_one_line_says_so(rejected, monkeypatch):
    monkeypatch.setattr(live, "find_spec", lambda _: None)
    for line in (
        "watch . --live --port 0",
        "run --worlds 0 --bags all --view --out out",
    ):
        assert rejected(line) == f"error: {live.MISSING}\n"


def test_a_view_without_bags_is_refused(rejected):
    message = (
        "error: --view reads bags and needs --bags all or --bags failed, got none\n"
    )
    assert rejected("run --worlds 0 --view --out out") == message


@pytest.mark.parametrize("mode", ["direct", "ros"])
def test_viewers_get_messages_and_late_ones_latched_ones(tmp_path, view, mode):
    RunFile.for_run(tmp_path, RunConfig(mode=mode), ()).write()
    with Recorder(tmp_path / "bags" / "one") as recorder:
        recorder.record([OutgoingMessage(COLLISION, b"")], 0)
        record(recorder, 0, 3)
        with LiveClient(view.url) as client:
            channels = client.channels(len(live._TOPICS))
            score = channels[SCORE.path]
            collision = channels[COLLISION.path]
            kind = [score[key] for key in ("schemaName", "encoding", "schemaEncoding")]
            assert kind == [SCORE.type_name, "cdr", "ros2msg"]
            client.subscribe([score, collision])
            # A planner in a process of its own must not get the truth here.
            if mode == "direct":
                assert client.messages(1) == [(collision["id"], 0, b"")]
            expected = [
                (score["id"], second * SECOND, encode_number(float(second)))
                for second in range(3)
            ]
            assert client.messages(3) == expected
            with LiveClient(view.url) as late:
                robot = late.channels(len(live._TOPICS))[ROBOT_DESCRIPTION.path]
                late.subscribe([robot])
                assert late.messages(1) == [(robot["id"], 0, encode_text("a robot"))]
            record(recorder, 3, 5)
            assert [stamp // SECOND for _, stamp, _ in client.messages(2)] == [3, 4]
        with refused(r"live port \d+: cannot be served"):
            live.FoxgloveStream(
                tmp_path, host="127.0.0.1", port=int(view.url.split(":")[2])
            )


# Host, origin and whether a request of both passes.
REQUESTS = """
127.0.0.1:1 |                                   | yes
localhost   | http://localhost:8080             | yes
127.0.0.1   | https://app.foxglove.dev          | yes
127.0.0.1   | file://                           | yes
127.0.0.1   | https://example.com               |
127.0.0.1   | http://10.1.2.3                   |
127.0.0.1   | null                              |
127.0.0.1   | https://foxglove.dev.example.com  |
example.com |                                   |
[::1        |                                   |
"""


@pytest.mark.parametrize("host, origin, passes", rows_of(REQUESTS))
def test_no_page_of_another_site_passes_the_gate(host, origin, passes):
    with socket.create_server(("127.0.0.1", 0)) as inner:
        gate = Gate(("127.0.0.1", 0), inner.getsockname())
        with closing(gate), socket.create_connection(gate.server_address) as viewer:
            lines = ["GET / HTTP/1.1", f"Host: {host}"]
            lines += [f"Origin: {origin}"] if origin else []
            viewer.sendall("\r\n".join([*lines, "", ""]).encode())
            viewer.settimeout(60.0)
            if passes:
                server, _ = inner.accept()
                with server:
                    assert server.recv(1000).startswith(b"GET / HTTP/1.1\r\nHost: ")
                    server.sendall(b"hello")
            answer = viewer.recv(1000)
    assert answer.startswith(b"hello" if passes else b"HTTP/1.1 403")


def test_a_path_of_two_topics_has_the_first_type_and_is_latched_if_either_is(view):
    assert WORLD_PATH.path in live._LATCHED_PATHS
    assert CMD_VEL.path not in live._LATCHED_PATHS
    with LiveClient(view.url) as client:
        command = client.channels(len(live._TOPICS))[CMD_VEL.path]
        assert command["schemaName"] == "geometry_msgs/msg/Twist"


def test_a_run_is_watched_as_it_goes(tmp_path):
    pytest.importorskip(
        "foxglove", reason="foxglove-sdk, an optional extra, is not installed"
    )
    served = barn_words(f"watch {tmp_path}/out --live 0 --wait --port 0")
    with subprocess.Popen(served, stderr=subprocess.PIPE, text=True) as watch:
        url = re.search(r"ws://[\d.:]+", watch.stderr.readline())[0]
        with LiveClient(url) as client:
            channels = client.channels(len(live._TOPICS))
            client.subscribe([channels[OUTCOME.path]])
            options = f"--planner gap --bags all --out {tmp_path}/out"
            drive = barn_words(f"run --worlds 0 {options}")
            subprocess.run(drive, check=True, capture_output=True)
            texts = [client.messages(1)[0][2]]
            while b"success" not in texts[-1]:
                texts += [client.messages(1)[0][2]]
            assert texts[0] == encode_text("running")
            assert texts[-1] == encode_text("success")
        assert watch.stderr.readline().startswith("http://127.0.0.1:")
        watch.send_signal(signal.SIGINT)
        assert watch.wait(600) == 130
