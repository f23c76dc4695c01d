import json
import os
import re
import signal
import socket
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest
from refusals import refused
from waiting import alive, parent, until

from barn_eval.ros.isolation import can_isolate, probe_isolation
from barn_eval.ros.supervision import launcher, nodes
from barn_eval.ros.supervision.process import (
    EventChannel,
    SupervisedProcess,
    last_lines,
)

KEPT_APART = pytest.mark.skipif(
    not can_isolate(),
    reason=f"the kernel keeps no planner apart here: {probe_isolation()}",
)
# A command with a child that leaves its session and a grandchild that has lost its
# parent; `stubborn` ignores signals.
FAMILY = """
import os, signal, subprocess, sys, time
if "stubborn" in sys.argv:
    signal.signal(signal.SIGINT, signal.SIG_IGN); signal.signal(signal.SIGTERM, signal.SIG_IGN)
sleeper = [sys.executable, "-c", "import time; time.sleep(3600)"]
own = subprocess.Popen(sleeper, start_new_session=True)
shell = subprocess.run(["/bin/sh", "-c", "sleep 3600 > /dev/null & echo $!"], stdout=subprocess.PIPE)
open(sys.argv[1], "w").write(f"{os.getpid()} {own.pid} {int(shell.stdout)}")
time.sleep(3600)
"""


def family(tmp_path, *arguments):
    """Start the family under a launcher and return the process and the pids of its
    three members.
    """
    command = [sys.executable, "-c", FAMILY, str(tmp_path / "pids"), *arguments]
    process = SupervisedProcess("family", command, os.environ, tmp_path / "family.log")
    return process, members(tmp_path / "pids")


def members(note):
    """Wait for the note of the family and return the three pids in it."""
    until(lambda: note.exists() and len(note.read_text().split()) == 3)
    pids = [int(pid) for pid in note.read_text().split()]
    assert all(map(alive, pids)) and len(set(pids)) == 3
    return pids


def ended(log, *command, **options):
    """Wait for the end of a command and return its process, which nothing is left of."""
    process = SupervisedProcess("one", command, os.environ, log, **options)
    process.wait(600.0)
    process.stop()
    return process


def test_stop_ends_the_whole_family(tmp_path):
    process, pids = family(tmp_path)
    process.stop()
    assert re.match(
        r"was killed by SIG(INT|TERM)$|exited with code", process.end
    )  # it may wait for the processor
    assert not any(map(alive, pids))


def test_a_second_stop_takes_no_patience(tmp_path):
    process, pids = family(tmp_path, "stubborn")
    process.ask_to_stop()
    time.sleep(0.1)
    assert alive(pids[0])
    process.send_stop()
    process.stop()
    assert process.end == "was killed by SIGKILL"
    assert not any(map(alive, pids))


def test_end_by_itself_is_reported_and_leaves_no_orphans(tmp_path):
    process, pids = family(tmp_path)
    os.kill(pids[0], signal.SIGKILL)
    until(lambda: process.read() or process.ended)
    assert process.end == "was killed by SIGKILL"
    assert not any(map(alive, pids))
    process.stop()


@pytest.mark.parametrize("also", ["nobody", "first launcher", "second launcher"])
def test_nothing_is_left_when_the_supervisor_is_killed(tmp_path, also):
    script = f"""
    import os, sys, time
    from pathlib import Path
    from barn_eval.ros.supervision.process import SupervisedProcess
    kept = SupervisedProcess("family", [sys.executable, "-c", {FAMILY!r}, {str(tmp_path / "pids")!r}], os.environ,
                   Path({str(tmp_path / "family.log")!r}))
    time.sleep(3600)
    """
    supervisor = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(script)], cwd=tmp_path
    )
    try:
        pids = members(tmp_path / "pids")
        launchers = launchers_of(pids[0])
    finally:
        supervisor.kill()
        if also != "nobody":
            os.kill(launchers[also == "second launcher"], signal.SIGKILL)
        supervisor.wait()
    assert until(lambda: not any(map(alive, (*pids, *launchers))))


def launchers_of(pid):
    """Return the two processes of the launcher of a command, the first of them first."""
    second = parent(pid)
    return parent(second), second


@pytest.mark.parametrize(
    "which, number", [(0, signal.SIGKILL), (1, signal.SIGKILL), (1, signal.SIGTERM)]
)
def test_nothing_is_left_when_the_launcher_is_killed(tmp_path, which, number):
    process, pids = family(tmp_path)
    launchers = launchers_of(pids[0])
    os.kill(launchers[which], number)
    until(lambda: process.read() or process.ended)
    assert "launcher" in process.end
    assert process.lost
    until(lambda: not any(map(alive, (*pids, *launchers))))
    process.stop()


def test_the_exit_code_and_what_was_printed_are_kept(tmp_path):
    process = ended(
        tmp_path / "talker.log",
        sys.executable,
        "-c",
        "print('out'); raise SystemExit(3)",
    )
    assert process.end == "exited with code 3"
    assert last_lines(process.log) == f"the end of {process.log}:\n  out"


@pytest.mark.parametrize(
    "kind",
    [
        launcher.SUITE,
        launcher.PLANNER,
        pytest.param(launcher.ISOLATED, marks=KEPT_APART),
    ],
)
def test_the_log_of_a_planner_ends_where_it_is_stopped(tmp_path, kind):
    script = "import time; print('drives', flush=True)\ntime.sleep(600)"
    log = tmp_path / "planner.log"
    log.write_text("of the start before\n")
    command = [sys.executable, "-c", script]
    process = SupervisedProcess("planner", command, os.environ, log, kind=kind)
    until(lambda: "drives" in log.read_text())
    process.stop()
    assert ("KeyboardInterrupt" in log.read_text()) is (kind == launcher.SUITE)
    quotation = last_lines(log, begin=process.log_begin)
    assert quotation.startswith(f"the end of {log}:\n  drives")


@pytest.mark.parametrize(
    "kind", [launcher.SUITE, pytest.param(launcher.ISOLATED, marks=KEPT_APART)]
)
def test_an_unknown_command_is_told(tmp_path, kind):
    process = ended(tmp_path / "nobody.log", "/no/such/command", kind=kind)
    assert (
        process.end == "cannot be started: /no/such/command: No such file or directory"
    )


def test_an_endless_output_keeps_its_beginning_and_end(tmp_path):
    log = tmp_path / "loud.log"
    script = (
        "import sys\nfor k in range(400_000): print(f'{k:099d}')\nprint('x' * 5000)"
    )
    assert ended(log, sys.executable, "-c", script).end == "exited with code 0"
    lines = log.read_text().splitlines()
    assert log.stat().st_size < 10.2e6  # of 40 MB
    assert lines[0] == f"{0:099d}"
    assert lines[-2] == f"{399_999:099d}"
    (cut,) = [
        number
        for number, line in enumerate(lines)
        if line.endswith(" bytes are left out here]")
    ]
    assert 49_990 < cut < 50_010
    assert last_lines(log, 1) == f"the end of {log}:\n  {'x' * 300}"
    # what the next start prints begins a file of its own, so that many starts take no
    # more
    ended(log, sys.executable, "-c", "print('again')")
    assert log.read_text() == "again\n"
    assert (tmp_path / "loud.log.1").stat().st_size > 9e6


def test_a_log_that_cannot_be_written_is_one_line(tmp_path):
    with refused(r"no/x\.log: No such file or directory"):
        SupervisedProcess("x", ["true"], os.environ, tmp_path / "no" / "x.log")


def test_link_is_handed_down_to_the_command(tmp_path, monkeypatch):
    monkeypatch.chdir(
        tmp_path
    )  # a source tree's folders would hide the installed packages
    ours, theirs = socket.socketpair()
    script = """
    import socket, sys
    from barn_eval.ros.supervision.process import EventChannel
    link = EventChannel(socket.socket(fileno=int(sys.argv[1])))
    while not (events := link.receive()):
        pass
    link.send("echo", name=events[0]["name"])
    """
    command = [sys.executable, "-c", textwrap.dedent(script), str(theirs.fileno())]
    process = SupervisedProcess(
        "echo", command, os.environ, tmp_path / "echo.log", [theirs]
    )
    theirs.close()
    link = EventChannel(ours)
    link.send("started", name="planner")
    events = []
    until(lambda: events.extend(link.receive()) or events)
    assert events == [{"event": "echo", "name": "planner"}]
    until(lambda: link.receive() == [] and link.closed)
    process.stop()
    assert process.end == "exited with code 0"


def test_link_joins_lines_that_come_in_pieces():
    ours, theirs = socket.socketpair()
    link = EventChannel(ours)
    whole = json.dumps({"event": "done"}).encode() + b"\n"
    theirs.sendall(whole + whole[:5])
    assert link.receive() == [{"event": "done"}]
    theirs.sendall(whole[5:])
    assert link.receive() == [{"event": "done"}]


def test_a_foreign_command_gets_no_wheels_of_ours():
    mark = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
    ours = str(Path(sys.prefix) / "lib")
    inherited = {
        "PATH": "/bin",
        mark: "1",
        "LD_LIBRARY_PATH": os.pathsep.join([ours, "/opt/theirs/lib"]),
    }
    assert nodes.foreign_environment(inherited) == {
        "PATH": "/bin",
        "LD_LIBRARY_PATH": "/opt/theirs/lib",
    }
    assert nodes.foreign_environment({mark: "1", "LD_LIBRARY_PATH": ours}) == {}
    assert nodes.foreign_environment({"A": "b"}) == {"A": "b"}


def test_ros_starts_without_a_home_as_services_do(tmp_path):
    variables = nodes.environment({}, 7)
    assert Path(variables["ROS_LOG_DIR"]).is_dir()
    # Fast DDS reads no profile that a planner has left in the working directory.
    assert variables["SKIP_DEFAULT_XML_FILE"] == "1"
    assert "ROS_LOG_DIR" not in nodes.environment({"HOME": str(tmp_path)}, 7)
    given = {"ROS_LOG_DIR": "/mine"}
    assert given.items() <= nodes.environment(given, 7).items()


@KEPT_APART
def test_an_isolated_planner_sees_only_its_own_processes(tmp_path):
    script = f"""
    import os, signal
    seen = [entry for entry in os.listdir("/proc") if entry.isdigit()]
    try:
        os.kill({os.getpid()}, 0)
    except ProcessLookupError:
        print("sees", len(seen), "has the user", os.getuid(), "writes", os.access({str(tmp_path)!r}, os.W_OK))
    os.kill(os.getppid(), signal.SIGKILL)  # the first process of the namespace, which does not mind
    os.kill(os.getpid(), signal.SIGKILL)
    """
    command = [sys.executable, "-c", textwrap.dedent(script)]
    process = ended(
        tmp_path / "apart.log", *command, kind=f"{launcher.ISOLATED}:{tmp_path}"
    )
    assert process.end == "was killed by SIGKILL"
    if probe_isolation() == "apart":
        assert (
            process.log.read_text()
            == f"sees 2 has the user {os.getuid()} writes False\n"
        )


@pytest.mark.skipif(probe_isolation() != "apart", reason="nothing can be hidden here")
def test_an_isolated_planner_neither_sees_nor_moves_the_results(tmp_path, monkeypatch):
    results = tmp_path / "above" / "out"
    parameters = results / "logs" / "planner.yaml"
    parameters.parent.mkdir(parents=True)
    parameters.write_text("named")
    (results / "bag.partial").write_text("true pose")
    (results / "prefix" / "share").mkdir(parents=True)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{results}/prefix:/opt")
    # A working directory from before would lead around what hides the folder.
    monkeypatch.chdir(tmp_path)
    script = """
    import os, sys
    print(sorted(os.listdir("above/out")), open(sys.argv[1]).read())
    print(os.listdir("above/out/prefix"))
    for name in ("above", "above/out", os.getcwd()):
        try:
            os.rename(name, name + "_moved")
        except OSError as error:
            print(error.strerror)
    writable = [os.access("/proc/sys/kernel/panic", os.W_OK)]
    for folder, _, names in os.walk("/sys/fs/cgroup"):
        writable += [os.access(os.path.join(folder, name), os.W_OK) for name in names]
    print(any(writable), os.access("/sys/kernel", os.W_OK))
    """
    command = [sys.executable, "-c", textwrap.dedent(script), str(parameters)]
    process = ended(
        tmp_path / "apart.log", *command, kind=f"{launcher.ISOLATED}:{results}"
    )
    lines = process.log.read_text().splitlines()
    assert lines[:2] == ["['logs', 'prefix'] named", "['share']"]
    assert lines[2:] == ["Device or resource busy"] * 3 + ["False False"]
    assert (results / "bag.partial").exists()
