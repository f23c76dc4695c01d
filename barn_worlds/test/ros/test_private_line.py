"""The private line: packets stay whole and in order, and nothing is lost while nobody reads."""

import threading

from barn_worlds.ros.private_line import PrivateLine, Reading, create_ends


def ends(**options):
    ours, theirs = create_ends()
    return PrivateLine(ours.detach(), **options), PrivateLine(theirs.detach())


def test_readings_and_objects_arrive_whole_and_in_order():
    simulator, evaluator = ends()
    data = bytes(range(256)) * 10
    simulator.publish("ground_truth/odom", data)
    simulator.send(answer=7, ok=True, text="two\nlines")
    simulator.publish("/clock", b"")
    first = evaluator.receive()
    second = evaluator.receive()
    third = evaluator.receive()
    assert isinstance(first, Reading)
    assert first[:2] == ("ground_truth/odom", data)
    assert second == {"answer": 7, "ok": True, "text": "two\nlines"}
    assert third[:2] == ("/clock", b"")
    assert third.sent_ns >= first.sent_ns > 0
    assert evaluator.receive() is None


def test_an_unheard_simulator_waits_and_loses_nothing():
    simulator, evaluator = ends()
    numbers = [k % 256 for k in range(500)]

    def send():
        for number in numbers:
            simulator.publish("odom", bytes([number]) * 700)

    sender = threading.Thread(target=send)
    sender.start()
    sender.join(0.5)
    assert sender.is_alive()  # so it does not run ahead either
    heard = [evaluator.receive(wait=True).data[0] for _ in numbers]
    sender.join()
    assert heard == numbers
    assert evaluator.receive() is None


def test_a_simulator_that_is_told_to_stop_does_not_wait():
    simulator, evaluator = ends(waits=lambda: False)
    for _ in range(500):
        simulator.publish("odom", bytes(700))
    assert evaluator.receive() is None


def test_the_end_of_the_other_side():
    simulator, evaluator = ends()
    simulator._socket.close()
    assert evaluator.receive(wait=True) is None
    evaluator.send(number=1)  # to nobody
