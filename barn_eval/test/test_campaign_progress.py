"""What is shown of a running campaign."""

import io
import re
from dataclasses import replace

import pytest
from rich.console import Console
from test_rows import result

from barn_eval.experiments import run as progress
from barn_eval.experiments.engine import Note
from barn_eval.experiments.run import MOST_LINES, ExperimentProgress, clock
from barn_eval.experiments.runner import Loss
from barn_eval.trials.outcome import Outcome


@pytest.fixture
def time(monkeypatch):
    """A clock that is moved by hand."""

    class Clock:
        now = 100.0

        def monotonic(self):
            return self.now

    monkeypatch.setattr(progress, "time", clock := Clock())
    return clock


def failed(number):
    one = result(number)
    return replace(one, outcome=Outcome.TIMEOUT, detail="too slow", scores=replace(one.scores, success=False))


def show(total, earlier, events, time, terminal=False):
    """Take one event every two seconds and return the text shown and the last state."""
    file = io.StringIO()
    console = Console(file=file, force_terminal=terminal, width=200)
    with ExperimentProgress(total, earlier, console) as shown:
        for event in events:
            time.now += 2.0
            shown.take(event)
        text = shown.text()
    return file.getvalue(), text


def test_rate_factor_remaining_time_and_outcomes_are_those_of_the_session(time):
    _, text = show(100, [result(90)], [result(number) for number in range(9)], time)
    # nine trials of 12 simulated seconds in 18 seconds, 90 to go
    assert text == "30.0/min, 6.0 x real time, 0:03:00 left, success 10"


def test_lines_come_now_and_then_and_at_the_end(time):
    total = MOST_LINES + 1
    shown, _ = show(total, [result(0)] * (total - 31), [result(number) for number in range(31)], time)
    lines = shown.splitlines()
    assert [line.split()[0] for line in lines] == ["85/101", "100/101", "101/101"]
    assert lines[-1] == "101/101 trials, 30.0/min, 6.0 x real time, in 0:01:02, success 101"


def test_trials_of_a_small_experiment_have_a_line_each(time):
    shown, _ = show(3, [result(0)], [result(1), failed(2)], time)
    first, second, _ = shown.splitlines()
    assert first == "[2/3] dwa_w0001_r00: success in 10.10 s"
    assert second == "[3/3] dwa_w0002_r00: timeout (too slow)"


def test_what_is_waited_for_is_said_once(time):
    waiting = [Note("dwa", "local-0", "waiting for /scan")] * 3
    shown, _ = show(1, [], [*waiting, result(1), *waiting[:1]], time)
    assert shown.count("waiting for /scan") == 1


@pytest.mark.parametrize("width", [60, 80, 120])
def test_a_narrow_terminal_shows_count_rate_time_left_and_outcomes_whole(time, width):
    file = io.StringIO()
    results = [replace(result(number), outcome=outcome) for number, outcome in enumerate(Outcome)]
    with ExperimentProgress(3000, results, Console(file=file, force_terminal=True, width=width)) as shown:
        time.now += 2.0
        shown.take(result(100))
        text = shown.text()
    last = re.split(r"\x1b\[[0-9;?]*[A-Za-z]", file.getvalue())
    words = set(" ".join(last).replace(",", " ").split())
    assert "\x1b[" in file.getvalue()
    assert {f"{len(Outcome) + 1}/3000", "30.0/min", "left"} <= words
    assert set(text.replace(",", " ").split()) <= words


def test_losses_are_told_at_once(time):
    shown, _ = show(2, [], [Loss("dwa_w0001_r00", 1, "its worker process was killed by SIGKILL")], time)
    assert shown.startswith("dwa_w0001_r00: attempt 1 lost, its worker process was killed by SIGKILL\n")


def test_durations_are_read_at_a_glance():
    assert [clock(value) for value in (0.4, 59.6, 3725.0, 90000.0)] == ["0:00:00", "0:01:00", "1:02:05", "25:00:00"]
