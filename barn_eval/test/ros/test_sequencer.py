import random

import pytest

from barn_eval.ros.sequencer import Message, TickSequencer


def message(topic, sent_ns):
    return Message(topic, f"{topic}@{sent_ns}".encode(), sent_ns)


def published(ticks):
    """Ticks and messages in the order of sending.

    What is due at each tick, and a command after it.
    """
    for k in range(ticks):
        sent = 1000 * k
        yield "tick", k * 50, sent
        for offset, topic in enumerate(("/odom", "/collision", "/scan", "/cmd_vel")):
            yield topic, k * 50, sent + 10 * (offset + 1)


def sorted_out(ticks):
    """Stamp, topics and the thousand of sending times, of each tick."""
    return [
        (
            tick.stamp_ns,
            [m.topic for m in tick.messages],
            {m.sent_ns // 1000 for m in tick.messages},
        )
        for tick in ticks
    ]


def test_a_command_may_come_as_late_as_the_scan_after_its_own():
    sequencer = TickSequencer("/scan")
    for number in range(
        9
    ):  # ticks without a scan, while a planner is charged for its computing
        sequencer.tick(50 * number, 1000 * number)
        if number in (0, 7):
            sequencer.add(message("/scan", 1000 * number + 1))
        if number < 8:
            assert not list(sequencer.pop_complete())
    sequencer.add(message("/cmd_vel", 900))
    first, *rest = sorted_out(sequencer.pop_complete())
    assert first == (0, ["/scan", "/cmd_vel"], {0})
    assert rest == [(50 * number, [], set()) for number in range(1, 7)]


@pytest.mark.parametrize("seed", range(20))
def test_any_order_across_topics_gives_the_same_ticks(seed):
    # Each topic keeps its own order; across topics anything may be late by up to one
    # tick.
    random.seed(seed)
    events = list(published(30))
    late = {
        topic: random.uniform(0.0, 900.0)
        for topic in ("/odom", "/collision", "/scan", "/cmd_vel", "tick")
    }
    events.sort(key=lambda event: event[2] + late[event[0]])
    sequencer = TickSequencer("/scan")
    done = []
    for kind, stamp_ns, sent_ns in events:
        if kind == "tick":
            sequencer.tick(stamp_ns, sent_ns)
        else:
            sequencer.add(message(kind, sent_ns))
        done += sequencer.pop_complete()
    in_order = [
        (50 * k, ["/odom", "/collision", "/scan", "/cmd_vel"], {k}) for k in range(30)
    ]
    assert sorted_out([*done, *sequencer.pop_all()]) == in_order


def test_a_tick_that_repeats_the_time_is_reported():
    sequencer = TickSequencer("/scan")
    starts = []
    for sent_ns, stamp_ns in ((0, 7), (100, 8), (200, 8), (300, 9)):
        starts.append(sequencer.tick(stamp_ns, sent_ns))
        sequencer.add(message("/odom", sent_ns + 1))
    assert (starts, sequencer.latest_ns) == ([True, True, False, True], 9)
    contents = [
        (tick.stamp_ns, [one.sent_ns for one in tick.messages])
        for tick in sequencer.pop_all()
    ]
    assert contents == [(7, [1]), (8, [101, 201]), (9, [301])]


def test_a_message_belongs_to_its_tick_in_any_order():
    sequencer = TickSequencer("/scan")
    sequencer.tick(0, 0)
    sequencer.add(message("/odom", 1000))
    sequencer.add(message("/truth", 1000))
    sequencer.tick(50, 1000)
    sequencer.add(message("/scan", 1000))
    assert sorted_out(sequencer.pop_all()) == [
        (0, [], set()),
        (50, ["/odom", "/truth", "/scan"], {1}),
    ]


def test_messages_sent_at_once_stay_in_the_order_of_arrival():
    sequencer = TickSequencer("/scan")
    sequencer.tick(0, 0)
    sequencer.tick(50, 1000)
    for topic in ("/odom", "/truth"):
        sequencer.add(message(topic, 1000))
        assert list(sequencer.pop_complete()) == []
    assert sorted_out(sequencer.pop_all()) == [
        (0, [], set()),
        (50, ["/odom", "/truth"], {1}),
    ]


def test_what_came_before_the_first_tick_belongs_to_it_alone():
    sequencer = TickSequencer("/scan")
    sequencer.add(message("/map", -500))
    sequencer.add(message("/goal", -500))
    assert sequencer.latest_ns is None
    sequencer.tick(0, 0)
    sequencer.add(message("/odom", 1))
    assert sequencer.latest_ns == 0
    assert [[one.topic for one in tick.messages] for tick in sequencer.pop_all()] == [
        ["/map", "/goal", "/odom"]
    ]
    sequencer.tick(50, 1000)
    assert [tick.messages for tick in sequencer.pop_all()] == [[]]


def test_a_message_later_than_all_patience_is_kept():
    sequencer = TickSequencer("/scan")
    for k in range(4):
        sequencer.tick(k, 10 * k)
        sequencer.add(message("/scan", 10 * k))
    assert [tick.stamp_ns for tick in sequencer.pop_complete()] == [0, 1]
    sequencer.add(message("/late", 5))
    assert [[one.topic for one in tick.messages] for tick in sequencer.pop_all()] == [
        ["/late", "/scan"],
        ["/scan"],
    ]


def test_ticks_by_the_private_line_wait_for_messages():
    sequencer = TickSequencer("/scan", fenced=True)
    for stamp in (10, 20, 30, 40):
        sequencer.tick(stamp, stamp)
        sequencer.add(message("/scan", stamp))
    assert list(sequencer.pop_complete()) == []
    sequencer.acknowledge(20)
    assert list(sequencer.pop_complete()) == []
    sequencer.add(Message("/cmd_vel", b"", 15))  # late, and yet in its place
    sequencer.acknowledge(30)
    (first,) = sequencer.pop_complete()
    assert (first.stamp_ns, [one.sent_ns for one in first.messages]) == (10, [10, 15])
    sequencer.acknowledge(10**18)  # a forged one shows no more than has begun
    assert [tick.stamp_ns for tick in sequencer.pop_complete()] == [20]
    sequencer.tick(50, 50)
    assert list(sequencer.pop_complete()) == []
