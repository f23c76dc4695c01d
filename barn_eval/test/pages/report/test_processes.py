"""The processes that make a report: none outlives it, none that dies is waited for."""

import math
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest
from refusals import refused
from waiting import until

from barn_eval.pages.report.processes import run_forked
from barn_worlds.base.errors import BarnError

_WAITS = """
import os, signal, time
from barn_eval.pages.report.processes import run_forked
signal.signal(signal.SIGINT, signal.default_int_handler)
def tell():
    print(os.getpid(), flush=True)
    time.sleep(3600.0)
run_forked([tell], print)
"""


def test_a_killed_process_is_one_line():
    message = (
        r"^a process that computed a part of the report was killed, probably because"
    )
    with refused(message, BarnError):
        run_forked([partial(signal.raise_signal, signal.SIGKILL)], print)


def test_what_was_not_begun_is_left_when_the_report_fails(tmp_path):
    jobs = [partial(time.sleep, 0.5) for _ in range(1000)] + [
        (tmp_path / "begun").touch
    ]
    with pytest.raises(ValueError, match="math domain error"):
        run_forked([partial(math.sqrt, -1.0), *jobs], print)
    assert not (tmp_path / "begun").exists()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_processes_end_with_the_command(number):
    process = subprocess.Popen(
        [sys.executable, "-c", _WAITS], stdout=subprocess.PIPE, start_new_session=True
    )
    try:
        child = int(process.stdout.readline())
        if number == signal.SIGINT:
            os.killpg(process.pid, number)  # as the terminal does
        else:
            process.send_signal(number)
        process.wait(600.0)
        assert until(lambda: not Path(f"/proc/{child}").exists())
    finally:
        process.kill()
        process.wait()
