"""The live view under clients that misbehave.

Runs over ROS with faults of network, clock and limits are here, too.
"""

import json
import os
import re
import resource
import shlex
import signal
import socket
import struct
import sys
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from shutil import which

from fault_cases.campaigns import shifted_clock
from fault_cases.direct import gap_run
from fault_cases.environment import FAMILY as MACHINE
from fault_cases.kit import Lab, Skipped, add_all, case, ending, hold
from fault_cases.planners import FOREIGN, by_command, judge, ros
from fault_cases.processes import run_undisturbed, same, words
from fault_cases.system import peak_memory_mb, succeeds

FAMILY = "live"
_HELLO = (
    "GET / HTTP/1.1\r\nHost: {0}:{1}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n"
)
_MOST_MB = 1000
Place = tuple[str, int]


def connect(place: Place, *frames: bytes, receive: int = 0) -> socket.socket:
    """Return a connection to the live view that has sent these frames.

    `receive`: bytes that it may have waiting.
    """
    connection = socket.socket()
    if receive:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive)
    connection.settimeout(20.0)
    connection.connect(place)
    connection.sendall(_HELLO.format(*place).encode())
    answer = b""
    while not answer.endswith(b"\r\n\r\n"):
        answer += connection.recv(1)
    with suppress(OSError):  # it may have closed the connection at an earlier one
        for frame in frames:
            connection.sendall(frame)
    return connection


def _text(content: bytes) -> bytes:
    size = (
        bytes([0x80 | len(content)])
        if len(content) < 126
        else b"\xff" + struct.pack(">Q", len(content))
    )
    return b"\x81" + size + bytes(4) + content


def _subscription(count: int) -> bytes:
    channels = [{"id": number, "channelId": number} for number in range(1, count + 1)]
    return _text(json.dumps({"op": "subscribe", "subscriptions": channels}).encode())


def _send_malformed(place: Place, connections: ExitStack) -> str:
    frames = (
        b"\x81\x05hello",  # without a mask
        b"\xff" * 1000,
        b"\x81\xff" + b"\x7f" + b"\xff" * 7 + bytes(4),  # of 2^63 bytes
        _text(b"\xff\xfe"),
        _text(b"{" * 100_000),
        _text(
            b'{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1e300}]}'
        ),
        _text(b'{"op": "no such", "x": "' + b"y" * 1_000_000 + b'"}'),
        _subscription(100_000),
        b"\x82\x80" + bytes(4),
        b"\x88\x82" + bytes(4) + b"\0\1",  # closes with a code that there is not
        b"\x89\xfe"
        + struct.pack(">H", 60_000)
        + bytes(4)
        + bytes(60_000),  # a ping that is too long
    )
    for frame in frames:
        connections.enter_context(connect(place, frame))
    for plain in (b"\0" * 10_000, b"GET / HTTP/1.1\r\n", b"GET " + b"/" * 1_000_000):
        connection = connections.enter_context(socket.create_connection(place))
        with suppress(OSError):
            connection.sendall(plain)
    return f"{len(frames) + 3} connections"


def _many(place: Place, connections: ExitStack) -> str:
    for number in range(400):
        connection = (
            socket.create_connection(place)
            if number % 2
            else connect(place, _subscription(40))
        )
        connections.enter_context(connection)
    return "400 connections"


def _slow(place: Place, connections: ExitStack) -> str:
    for _ in range(20):
        connections.enter_context(connect(place, _subscription(40), receive=4096))
    return "20 connections that read nothing"


def _watch_during(lab: Lab, trouble: Callable[[Place, ExitStack], str]) -> str:
    if find_spec("foxglove") is None:
        raise Skipped("foxglove-sdk is not installed")
    watch = lab.start("watch", lab.out, "--live", 0, "--wait", "--port", 0)
    error_file: Path = watch.stem.with_suffix(".err")  # type: ignore[attr-defined]
    ((host, port),) = lab.until(
        lambda: re.findall(r"ws://([\d.]+):(\d+)", error_file.read_text()),
        "its address",
    )
    place = host, int(port)
    with ExitStack() as connections:
        description = trouble(place, connections)
        lab.barn(*gap_run(lab), "--bags", "all")
        with connect(place) as good:
            lab.until(lambda: b"advertise" in good.recv(65536), "what the view offers")
        peak_mb = peak_memory_mb(watch.pid)
    hold(peak_mb < _MOST_MB, f"{peak_mb} MB")
    os.kill(watch.pid, signal.SIGINT)
    lab.finish(watch, 130)
    return f"{description}; {ending(lab.row())}; the view took at most {peak_mb} MB"


_MUST = "The trial runs on, and another client is served; the view takes less than 1 GB and ends by Ctrl-C."
_CLIENTS = (
    (
        "malformed-frames",
        "Clients of the live view send what is no frame, no JSON, or asks for too much.",
        _send_malformed,
    ),
    (
        "many-clients",
        "Of 400 clients of the live view half say nothing, and half subscribe to all.",
        _many,
    ),
    (
        "slow-clients",
        "20 clients of the live view subscribe to all and read nothing.",
        _slow,
    ),
)
add_all(FAMILY, _MUST, _watch_during, _CLIENTS)


@case(MACHINE)
def no_loopback(lab: Lab) -> str:
    """There is no network, not even a loopback interface (unshare --net).

    Mode direct works; over ROS the run is refused in one line.
    """
    alone = ["unshare", "--net", "--"]
    if not succeeds([*alone, "true"]):
        raise Skipped("a network namespace cannot be made here (needs root)")
    refusal = lab.expect_refusal(*words(lab), prefix=alone)
    hold("no loopback interface" in refusal, refusal)
    lab.barn(*gap_run(lab), prefix=alone)
    return f"{refusal}; direct: {ending(lab.row())}"


@case(MACHINE)
def no_such_dds(lab: Lab) -> str:
    """RMW_IMPLEMENTATION asks for Cyclone DDS, of which PyPI has no wheels.

    Where it is not installed, the run ends with one line that names it; else the row is
    the undisturbed one.
    """
    run_undisturbed()
    cyclone = {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}
    ended = lab.barn(*words(lab), code=None, environment=cyclone)
    if ended.code == 0:
        return same(lab)
    hold("rmw_cyclonedds_cpp" in ended.error and not lab.rows(), ended.text)
    return ended.error.replace(str(lab.folder), "")[:160]


@case(MACHINE)
def a_planner_in_another_century(lab: Lab) -> str:
    """The clock that the planner's processes see is 55 years behind, so that its
    commands seem to be of no trial.

    The trial ends as interference, by the planner's fault, and names that.
    """
    _, false = shifted_clock(lab, -55 * 365 * 86_400)
    assignments = [f"{name}={value}" for name, value in false.items()]
    before = ["env", *assignments]
    prefix = f"{shlex.join(before)} "
    planner = by_command(FOREIGN, "starts", "drives", prefix=prefix)
    lab.barn(*ros(lab, *planner, limit_s=6.0))
    return judge(lab, "interference", "stamped by a clock that is 1734")


@case(MACHINE)
def a_planner_with_a_fast_clock(lab: Lab) -> str:
    """The clock that the planner's processes see runs 50 times as fast (libfaketime).

    The trial runs to its timeout.
    """
    library = next(Path("/usr/lib").glob("*/faketime/libfaketime.so.1"), None)
    if library is None:
        raise Skipped("Debian's package libfaketime is not installed")
    before = shlex.join(["env", f"LD_PRELOAD={library}", "FAKETIME=+0 x50"])
    planner = by_command(FOREIGN, "starts", "drives", prefix=f"{before} ")
    lab.barn(*ros(lab, *planner, limit_s=6.0))
    return judge(lab, "timeout", "")


def _run_with_limit(lab: Lab, kind: int, most: int, over_ros: bool) -> str:
    limit = partial(resource.setrlimit, kind, (most, most))
    command = words(lab) if over_ros else gap_run(lab)
    ended = lab.barn(*command, code=None, before=limit)
    # OpenBLAS interrupts its process where it gets no thread
    hold(ended.code in (0, 1, 130), ended.text)
    return f"code {ended.code}: {ended.text}" if ended.code else ending(lab.row())


_MUST = (
    "The run works, or ends with the reason and without a traceback; nothing is left."
)
_LIMITS = (
    (
        "little-memory",
        "A process may have 600 MB of addresses (ulimit -v).",
        resource.RLIMIT_AS,
        600_000_000,
        False,
    ),
    (
        "little-memory-over-ros",
        "A process may have 1.5 GB of addresses.",
        resource.RLIMIT_AS,
        1_500_000_000,
        True,
    ),
    (
        "small-stack",
        "A process may have 256 kB of stack (ulimit -s).",
        resource.RLIMIT_STACK,
        256_000,
        True,
    ),
    (
        "locked-memory",
        "A process may lock no memory (ulimit -l).",
        resource.RLIMIT_MEMLOCK,
        0,
        True,
    ),
)
add_all(MACHINE, _MUST, _run_with_limit, _LIMITS)


@case(MACHINE)
def few_processes(lab: Lab) -> str:
    """The user, who is not root, may have 30 processes and threads (ulimit -u).

    The run over ROS works, or ends with one line that gives the reason; nothing is
    left.
    """
    if os.geteuid() != 0 or which("setpriv") is None:
        raise Skipped("needs root, to be another user")
    lab.folder.chmod(0o777)
    limits = "setpriv --reuid=54321 --clear-groups prlimit --nproc=30"
    other = limits.split()
    if not succeeds([*other, sys.executable, "-c", "import rclpy"]):
        raise Skipped("another user cannot use this environment")
    home = {"HOME": str(lab.folder)}
    ended = lab.barn(*words(lab), code=None, prefix=other, environment=home)
    hold(ended.code in (0, 1, 3), ended.text)
    return ended.error[:160] if ended.code == 1 else ending(lab.row())
