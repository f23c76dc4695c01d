"""What tests do in processes of their own, which import it by this module's name."""

import os
import signal

from results.test_rows import result

from barn_eval.results.bags.recorder import Recorder
from barn_eval.results.rows import RowFile
from barn_worlds.messages.encode import encode_clock
from barn_worlds.messages.topics import CLOCK

PERIOD_NS = 50_000_000


def record_and_die(path):
    recorder = Recorder(path)
    recorder.add_topic("/clock", CLOCK.type_name)
    for cycle in range(205):
        recorder.write("/clock", encode_clock(cycle * PERIOD_NS), cycle * PERIOD_NS)
    os.kill(os.getpid(), signal.SIGKILL)


def append_rows(folder, reported):
    """Append rows without end, from after the last one that was reported."""
    rows = RowFile(folder)
    for number in range(reported.value + 1, 100_000):
        rows.append(result(number))
        reported.value = number
