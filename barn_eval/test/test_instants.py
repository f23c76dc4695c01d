import random

import pytest

from barn_eval.ros.instants import LATER_TICKS, Message, Timeline


def message(topic, sent_ns):
    return Message(topic, f"{topic}@{sent_ns}".encode(), sent_ns)


def published(ticks):
    """Ticks and messages in the order of sending: what is due at each instant, and a command after it."""
    for k in range(ticks):
        sent = 1000 * k
        yield "tick", k * 50, sent
        for offset, topic in enumerate(("/odom", "/collision", "/scan", "/cmd_vel")):
            yield topic, k * 50, sent + 10 * (offset + 1)


def feed(timeline, kind, stamp_ns, sent_ns):
    if kind == "tick":
        timeline.tick(stamp_ns, sent_ns)
    else:
        timeline.add(message(kind, sent_ns))


def sorted_out(instants):
    """Stamp, topics and the thousand of sending times, of each instant."""
    return [
        (one.stamp_ns, [m.topic for m in one.messages], {m.sent_ns // 1000 for m in one.messages}) for one in instants
    ]


def in_order(ticks):
    """What `published` is, sorted out."""
    return [(50 * k, ["/odom", "/collision", "/scan", "/cmd_vel"], {k}) for k in range(ticks)]


def test_in_order():
    timeline = Timeline()
    done = []
    for event in published(20):
        feed(timeline, *event)
        done += timeline.complete()
    assert len(done) == 20 - LATER_TICKS
    assert sorted_out([*done, *timeline.rest()]) == in_order(20)


@pytest.mark.parametrize("seed", range(20))
def test_any_order_across_topics_gives_the_same_instants(seed):
    # Each topic keeps its own order; across topics anything may be late by up to one instant.
    random.seed(seed)
    events = list(published(30))
    late = {topic: random.uniform(0.0, 900.0) for topic in ("/odom", "/collision", "/scan", "/cmd_vel", "tick")}
    events.sort(key=lambda event: event[2] + late[event[0]])
    timeline = Timeline()
    done = []
    for event in events:
        feed(timeline, *event)
        done += timeline.complete()
    assert sorted_out([*done, *timeline.rest()]) == in_order(30)


def test_repeated_tick_begins_nothing_new():
    timeline = Timeline()
    for sent_ns in (0, 100, 200):
        timeline.tick(7, sent_ns)
        timeline.add(message("/odom", sent_ns + 1))
    (instant,) = timeline.rest()
    assert [one.sent_ns for one in instant.messages] == [1, 101, 201]


def test_a_tick_tells_whether_it_begins_an_instant():
    timeline = Timeline()
    assert [timeline.tick(stamp_ns, sent_ns) for sent_ns, stamp_ns in enumerate([7, 8, 8, 9])] == [
        True,
        True,
        False,
        True,
    ]
    assert timeline.latest_ns == 9
    assert [instant.stamp_ns for instant in timeline.rest()] == [7, 8, 9]


def test_a_message_sent_with_a_tick_belongs_to_it_whichever_comes_first():
    timeline = Timeline()
    timeline.tick(0, 0)
    timeline.add(message("/odom", 1000))
    timeline.add(message("/truth", 1000))
    timeline.tick(50, 1000)
    timeline.add(message("/scan", 1000))
    assert sorted_out(timeline.rest()) == [(0, [], set()), (50, ["/odom", "/truth", "/scan"], {1})]


def test_what_came_before_the_first_tick_belongs_to_it_alone():
    timeline = Timeline()
    timeline.add(message("/map", -500))
    timeline.tick(0, 0)
    assert [[one.topic for one in instant.messages] for instant in timeline.rest()] == [["/map"]]
    timeline.tick(50, 1000)
    assert [instant.messages for instant in timeline.rest()] == [[]]


def test_what_came_before_the_first_tick_belongs_to_it():
    timeline = Timeline()
    timeline.add(message("/map", -500))
    assert timeline.latest_ns is None
    timeline.tick(0, 0)
    timeline.add(message("/odom", 1))
    assert timeline.latest_ns == 0
    (instant,) = timeline.rest()
    assert [one.topic for one in instant.messages] == ["/map", "/odom"]


def test_a_message_later_than_all_patience_is_kept():
    timeline = Timeline()
    for k in range(4):
        timeline.tick(k, 10 * k)
    assert [instant.stamp_ns for instant in timeline.complete()] == [0, 1]
    timeline.add(message("/late", 5))
    assert [[one.topic for one in instant.messages] for instant in timeline.rest()] == [["/late"], []]


def test_ticks_that_come_by_a_faster_way_complete_nothing_before_the_others_are_heard_as_far():
    timeline = Timeline(fenced=True)
    for stamp in (10, 20, 30, 40):
        timeline.tick(stamp, stamp)
    assert list(timeline.complete()) == []
    timeline.hear(20)
    assert list(timeline.complete()) == []
    timeline.add(Message("/cmd_vel", b"", 15))  # late, and yet in its place
    timeline.hear(30)
    (first,) = timeline.complete()
    assert (first.stamp_ns, [message.sent_ns for message in first.messages]) == (10, [15])
    timeline.hear(10**18)  # a forged one shows no more than has begun
    assert [instant.stamp_ns for instant in timeline.complete()] == [20]
    timeline.tick(50, 50)
    assert list(timeline.complete()) == []
