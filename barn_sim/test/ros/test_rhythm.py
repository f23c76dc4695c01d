"""Which instants a planner answers, found out by driving imagined planners in lockstep."""

import math

import pytest

pytest.importorskip("rclpy")

from barn_sim.ros.rhythm import Rhythm

STEP_NS = 50_000_000
WAIT_S = 5.0
TURN_S = 0.003  # wall-clock time of an instant besides its wait


class Planner:
    """Answers each scan after a time, or has a timer on one of the two clocks."""

    def __init__(self, sim_hz=0.0, wall_hz=0.0, answer_s=0.01, busy_s=0.0):
        self.sim_hz = sim_hz
        self.wall_hz = wall_hz
        self.answer_s = answer_s
        self.busy_s = busy_s  # until then
        self.next_ns = 0

    def commands(self, now_ns, now_s, until_s):
        """Return when it sends commands, from readings of an instant to a time."""
        if self.wall_hz:
            number = math.floor(now_s * self.wall_hz) + 1
            return [] if number / self.wall_hz > until_s else [number / self.wall_hz]
        if self.sim_hz:
            if now_ns < self.next_ns or now_s + self.answer_s > until_s:
                return []
            while now_ns >= self.next_ns:
                self.next_ns += math.floor(1e9 / self.sim_hz)
            return [now_s + self.answer_s]
        answer_s = max(now_s, self.busy_s) + self.answer_s
        return [] if answer_s > until_s else [answer_s]


def drive(rhythm, planner, instants, trial=1):
    """Drive a planner for some instants of a trial, which begins with a minute.

    Returns the instants that were waited for, those that were answered, and the time.
    """
    rhythm.begin_trial(STEP_NS, WAIT_S)
    waited, answered = [], []
    now_s = start_s = 60.0 * (trial - 1)
    origin_ns = 60 * trial * 1_000_000_000
    # Where the clock jumps to, a timer on it fires before the first reading.
    planner.commands(origin_ns, 0.0, math.inf)
    for number in range(instants):
        now_ns = origin_ns + number * STEP_NS
        now_s += TURN_S
        if not rhythm.expects(now_ns, has_scan=True):
            continue
        waited.append(number)
        rhythm.begin_wait(now_s)
        while (remaining_s := rhythm.remaining_s(now_s)) > 0.0:
            commands = planner.commands(now_ns, now_s, now_s + remaining_s)
            if not commands:
                now_s += remaining_s
                break
            now_s = commands[0]
            rhythm.hear(now_ns, now_s)
            if number not in answered:
                answered.append(number)
            # Whoever answers scans answers each of them once.
            if not (planner.sim_hz or planner.wall_hz):
                now_s += max(0.0, rhythm.remaining_s(now_s))
                break
        rhythm.end_wait(now_ns)
    return waited, answered, now_s - start_s


@pytest.mark.parametrize("answer_s", [0.002, 0.04, 0.1, 4.9])
def test_a_planner_that_answers_each_scan_is_waited_for_at_each(answer_s):
    rhythm = Rhythm()
    waited, answered, wall_s = drive(rhythm, Planner(answer_s=answer_s), 200)
    assert waited == answered == list(range(200))
    assert (rhythm.period_ns, rhythm.missed) == (0, 0)
    # One reading is held back for one and a half answers, at most 1.5 s.
    assert wall_s <= 200 * (answer_s + TURN_S) + min(1.5, 1.6 * (answer_s + TURN_S))


@pytest.mark.parametrize("hz", [20.0, 10.0, 5.0, 3.0, 2.0, 1.0])
@pytest.mark.parametrize("is_declared", [True, False])
def test_a_timer_on_simulated_time_is_waited_for_when_it_is_due(hz, is_declared):
    rhythm = Rhythm(hz if is_declared else 0.0)
    planner = Planner(sim_hz=hz)
    *_, wall_s = drive(rhythm, planner, 150)
    # Found out after one whole wait and a search, or with the phase alone to be found.
    assert wall_s < (6.0 if is_declared else WAIT_S + 20.0)
    assert rhythm.is_declared is is_declared
    assert rhythm.period_ns == math.ceil(20.0 / hz) * STEP_NS
    assert rhythm.missed == 0
    waited, answered, _ = drive(rhythm, planner, 600, trial=2)
    # Only at its first instant may a trial wait for a moment without a command.
    assert len(set(waited) - set(answered)) <= 1 + math.ceil(20.0 / hz)
    assert rhythm.missed == 0


@pytest.mark.parametrize("hz", [30.0, 20.0, 10.0, 4.0, 2.0])
@pytest.mark.parametrize("is_declared", [True, False])
def test_a_timer_on_the_wall_clock_is_asked_at_its_own_rate(hz, is_declared):
    rhythm = Rhythm(hz if is_declared else 0.0)
    planner = Planner(wall_hz=hz)
    drive(rhythm, planner, 60)
    assert rhythm.period_ns == math.ceil(20.0 / hz) * STEP_NS
    *_, wall_s = drive(rhythm, planner, 600, trial=2)
    assert rhythm.missed == 0
    # So 30 s of simulated time take as long by the wall clock.
    if hz <= 20.0:
        assert wall_s == pytest.approx(30.0, rel=0.05)


@pytest.mark.parametrize("hz", [400.0, 10.0])
def test_a_timer_on_the_wall_clock_is_found_again_after_a_pause(hz):
    rhythm = Rhythm()
    rhythm.begin_trial(STEP_NS, WAIT_S)
    rhythm.begin_wait(0.0)
    rhythm.end_wait(0)
    now_s = WAIT_S
    rhythm.begin_wait(now_s)
    for _ in range(1000):
        if rhythm.remaining_s(now_s) > 0.0:
            now_s += 1.0 / hz
            rhythm.hear(STEP_NS, now_s)
    assert now_s < WAIT_S + 2.5
    assert rhythm.period_ns == math.ceil(20.0 / hz) * STEP_NS


def test_a_planner_that_answers_late_once_is_asked_at_each_scan_again():
    rhythm = Rhythm()
    waited, answered, _ = drive(rhythm, Planner(busy_s=12.0), 400)
    assert waited == list(range(400))
    assert answered == waited[-len(answered) :]
    # The clock has not gone on for longer than it was waited for.
    assert len(answered) > 160
    assert (rhythm.period_ns, rhythm.missed) == (STEP_NS, 0)


@pytest.mark.parametrize("is_declared", [True, False])
def test_a_planner_that_sends_nothing_lets_time_go_on(is_declared):
    rhythm = Rhythm(10.0 if is_declared else 0.0)
    _, answered, wall_s = drive(rhythm, Planner(sim_hz=0.01), 300)
    assert not answered
    # No longer than the simulated time and one wait, though each instant is waited for.
    assert wall_s < 15.0 + WAIT_S
    assert rhythm.missed == (0 if is_declared else 300)


def test_a_declared_rate_that_is_wrong_is_replaced():
    rhythm = Rhythm(10.0)
    drive(rhythm, Planner(sim_hz=4.0), 100)
    assert (rhythm.period_ns, rhythm.is_declared) == (5 * STEP_NS, False)


def test_two_commands_to_each_scan_are_no_timer():
    rhythm = Rhythm()
    rhythm.begin_trial(STEP_NS, WAIT_S)
    now_s = 0.0
    for number in range(50):
        now_s += TURN_S
        rhythm.begin_wait(now_s)
        now_ns = number * STEP_NS
        rhythm.hear(now_ns, now_s + 0.05)
        now_s += 0.051
        if rhythm.remaining_s(now_s) > 0.0:
            rhythm.hear(now_ns, now_s)
        rhythm.end_wait(now_ns)
    assert rhythm.period_ns == 0
