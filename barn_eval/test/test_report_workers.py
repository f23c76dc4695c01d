"""The processes that make a report: none outlives it, none that dies is waited for."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from barn_eval.pages.report.processes import workers
from barn_worlds.base.errors import BarnError

_WAITS = """
import signal, time
from multiprocessing import active_children
from barn_eval.pages.report.processes import workers
signal.signal(signal.SIGINT, signal.default_int_handler)
with workers() as pool:
    print(*(one.pid for one in active_children()), flush=True)
    pool.submit(time.sleep, 3600.0)
    time.sleep(3600.0)
"""


def _die():
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_killed_process_is_one_line():
    said = r"^a process that computed a part of the report was killed; was there enough"
    with pytest.raises(BarnError, match=said), workers() as pool:
        pool.submit(_die).result()


def test_what_was_not_begun_is_left_when_the_report_fails():
    with pytest.raises(ValueError, match="in vain"), workers() as pool:
        jobs = [pool.submit(time.sleep, 0.5) for _ in range(1000)]
        raise ValueError("in vain")
    assert jobs[-1].cancelled()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_processes_end_with_the_command(number):
    process = subprocess.Popen([sys.executable, "-c", _WAITS], stdout=subprocess.PIPE, start_new_session=True)
    try:
        children = process.stdout.readline().split()
        assert children
        if number == signal.SIGINT:
            os.killpg(process.pid, number)  # as the terminal does
        else:
            process.send_signal(number)
        process.wait(600.0)
        deadline = time.monotonic() + 600.0
        while any(Path(f"/proc/{int(pid)}").exists() for pid in children):
            assert time.monotonic() < deadline
            time.sleep(0.01)
    finally:
        process.kill()
        process.wait()
