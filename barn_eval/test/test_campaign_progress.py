"""What is shown of a running campaign."""

import io

import pytest
from rich.console import Console
from test_rows import result

from barn_eval.experiments import progress
from barn_eval.experiments.progress import CampaignProgress, clock
from barn_eval.experiments.runner import Loss


@pytest.fixture
def time(monkeypatch):
    """A clock that is moved by hand."""

    class Clock:
        now = 100.0

        def monotonic(self):
            return self.now

    monkeypatch.setattr(progress, "time", clock := Clock())
    return clock


def show(total, earlier, events, time, terminal=False):
    """Take one event every two seconds and return the text shown and the last state."""
    file = io.StringIO()
    console = Console(file=file, force_terminal=terminal, width=200)
    with CampaignProgress(total, earlier, console) as shown:
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
    shown, _ = show(31, [], [result(number) for number in range(31)], time)
    lines = shown.splitlines()
    assert [line.split()[0] for line in lines] == ["15/31", "30/31", "31/31"]
    assert lines[-1] == "31/31 trials, 30.0/min, 6.0 x real time, in 0:01:02, success 31"


def test_losses_are_told_at_once(time):
    shown, _ = show(2, [], [Loss("dwa_w0001_r00", 1, "its worker process was killed by SIGKILL")], time)
    assert shown.startswith("dwa_w0001_r00: attempt 1 lost, its worker process was killed by SIGKILL\n")


def test_a_terminal_gets_a_bar(time):
    shown, _ = show(10, [], [result(1)], time, terminal=True)
    assert "\x1b[" in shown
    assert "1/10" in shown


def test_durations_are_read_at_a_glance():
    assert [clock(value) for value in (0.4, 59.6, 3725.0, 90000.0)] == ["0:00:00", "0:01:00", "1:02:05", "25:00:00"]
