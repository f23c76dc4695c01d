import pytest

from barn_eval.experiments.ros_config import Patience
from barn_eval.ros.readiness import Watchdog
from barn_eval.trials.outcome import Outcome

PATIENCE = Patience(command_s=5.0, clock_s=3.0, vanished_s=1.0, trial_s=60.0)


def quiet(watch, now_s, *, ticks=True, commands=True, publisher=True):
    number = round(10 * now_s)  # which grows
    watch.hear(now_s, number if ticks else 0, number if commands else 0)
    if publisher:
        watch.publisher_seen(now_s)


def test_nothing_while_all_goes_on():
    watch = Watchdog(PATIENCE, 0.0)
    for second in range(60):
        quiet(watch, float(second))
        assert watch.judge(second + 0.9, moved=second > 2) is None


def test_each_silence_has_its_own_outcome():
    cases = (
        ({"ticks": False}, 3.0, True, Outcome.SIMULATOR_DIED),
        ({"publisher": False}, 1.0, True, Outcome.PLANNER_DIED),
        ({"commands": False}, 5.0, False, Outcome.NO_FIRST_MOTION),
        ({"commands": False}, 5.0, True, Outcome.PLANNER_STALLED),
    )
    for missing, limit_s, moved, outcome in cases:
        watch = Watchdog(PATIENCE, 100.0)
        quiet(watch, 101.0)
        quiet(watch, 101.0 + limit_s, **missing)
        assert watch.judge(101.0 + limit_s, moved=moved) is None
        quiet(watch, 101.1 + limit_s, **missing)
        assert watch.judge(101.1 + limit_s, moved=moved)[0] is outcome


def test_a_simulator_that_is_stuck_is_not_the_planners_silence():
    watch = Watchdog(Patience(command_s=3.0, clock_s=5.0), 0.0)
    quiet(watch, 1.0)
    quiet(watch, 5.0, ticks=False, commands=False)
    assert watch.judge(5.0, moved=True) is None
    quiet(watch, 6.1, ticks=False, commands=False)
    assert watch.judge(6.1, moved=True) == (Outcome.SIMULATOR_DIED, "no tick of /clock for 5 s")


def test_a_trial_without_end():
    watch = Watchdog(PATIENCE, 0.0)
    quiet(watch, 61.0)
    outcome, detail = watch.judge(61.0, moved=True)
    assert outcome is Outcome.PLANNER_STALLED
    assert detail == "no verdict after 60 s of wall-clock time"


def test_a_planner_at_a_fifth_of_a_hertz_is_ended_after_a_minute():
    watch = Watchdog(Patience(), 0.0)
    found, second = None, 0
    while found is None:  # 5 s for each step of 0.05 s, all of them spent waiting for its answer
        second += 5
        quiet(watch, float(second))
        found = watch.judge(float(second), moved=True, simulated_s=second * 0.01, waited_s=float(second))
    assert second == 60
    assert found == (
        Outcome.PLANNER_STALLED,
        "60 s of wall-clock time for 0.60 simulated seconds: more than 50 s per simulated second",
    )


@pytest.mark.parametrize(("pace", "owed"), [(0.03, 1.0), (0.01, 0.4)], ids=["slow enough", "the simulator is slow"])
def test_a_slow_planner_or_a_slow_simulator_is_not_ended(pace, owed):
    watch = Watchdog(Patience(), 0.0)
    for second in range(0, 600, 5):
        quiet(watch, float(second))
        assert watch.judge(float(second), moved=True, simulated_s=second * pace, waited_s=second * owed) is None


def test_the_silence_of_a_planner_that_never_spoke_says_so():
    watch = Watchdog(PATIENCE, 0.0)
    quiet(watch, 5.5, commands=False)
    assert watch.judge(5.5, moved=False)[1].endswith("none since the trial began")
