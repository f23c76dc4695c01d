from barn_eval.ros.watchdog import StampCheck
from barn_worlds.base.types import nanoseconds


def test_wall_clock_stamps_are_told_from_simulated_ones():
    check = StampCheck()
    check.take("/plan", nanoseconds(11.0), nanoseconds(12.0))
    assert check.text() == ""
    check.take("/cmd_vel", nanoseconds(1_700_000_000.25), nanoseconds(12.0))
    check.take("/other", nanoseconds(1_600_000_000.0), nanoseconds(12.0))
    assert check.text() == "/cmd_vel is stamped 1700000000.2 s while /clock shows 12.0 s: use_sim_time is off"


def test_each_topic_is_looked_at_once_and_missing_stamps_say_nothing():
    check = StampCheck()
    assert check.wants("/cmd_vel")
    check.take("/cmd_vel", 0, nanoseconds(1000.0))
    assert not check.wants("/cmd_vel")
    assert check.text() == ""
