from barn_eval.experiments.ros_config import Patience
from barn_eval.ros.watch import Watch
from barn_eval.trials.outcome import Outcome

PATIENCE = Patience(command_s=5.0, clock_s=3.0, vanished_s=1.0, trial_s=60.0)


def quiet(watch, now_s, *, ticks=True, commands=True, publisher=True):
    if ticks:
        watch.tick(now_s)
    if commands:
        watch.command(now_s)
    if publisher:
        watch.publisher_seen(now_s)


def test_nothing_while_all_goes_on():
    watch = Watch(PATIENCE, 0.0)
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
        watch = Watch(PATIENCE, 100.0)
        quiet(watch, 101.0)
        quiet(watch, 101.0 + limit_s, **missing)
        assert watch.judge(101.0 + limit_s, moved=moved) is None
        quiet(watch, 101.1 + limit_s, **missing)
        assert watch.judge(101.1 + limit_s, moved=moved)[0] is outcome


def test_a_trial_without_end():
    watch = Watch(PATIENCE, 0.0)
    quiet(watch, 61.0)
    outcome, detail = watch.judge(61.0, moved=True)
    assert outcome is Outcome.PLANNER_STALLED
    assert detail == "no verdict after 60 s of wall-clock time"


def test_the_silence_of_a_planner_that_never_spoke_says_so():
    watch = Watch(PATIENCE, 0.0)
    quiet(watch, 5.5, commands=False)
    assert watch.judge(5.5, moved=False)[1].endswith("none since the trial began")
