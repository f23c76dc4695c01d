"""Who interferes with a trial, told by the process that an endpoint belongs to and not
by a name.
"""

from types import SimpleNamespace

import pytest
from refusals import refused

from barn_eval.ros.readiness import Endpoint

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from barn_eval.ros.adapter import TrialTopics
from barn_eval.ros.evaluator_loop import TrialEnded
from barn_eval.ros.graph import LEASE_S, GraphView, Integrity
from barn_eval.trials.result import Outcome

SIMULATOR = b"simulator..."
PLANNER = b"planner....."
OTHER = b"other......."
TOPICS = TrialTopics(
    "/clock", "/odom", "/truth", "/collision", "/cmd_vel", "/scan", "/diagnostics"
)


class View:
    """A graph of plain data."""

    crowd = GraphView.crowd

    def __init__(self, publishers=(), subscriptions=(), clients=(), topics=()):
        self._publishers = publishers
        self._subscriptions = subscriptions
        self._clients = clients
        self._node = SimpleNamespace(
            get_topic_names_and_types=lambda: topics,
            get_service_names_and_types=list,
            get_node_names=list,
        )

    def publishers(self, topic):
        return [endpoint for endpoint in self._publishers if endpoint.topic == topic]

    def subscriptions(self, topic):
        return [endpoint for endpoint in self._subscriptions if endpoint.topic == topic]

    def clients_of(self, name):
        assert name == "/simulator"
        return list(self._clients)


class Channel:
    participant = SIMULATOR

    def __init__(self, *interference):
        self.interference = list(interference)


def endpoint(topic, process, node):
    return Endpoint(topic, "a/msg/B", process + bytes([0, 0, 0, 1]), node)


def ordinary():
    return [
        endpoint("/clock", SIMULATOR, "/simulator"),
        endpoint("/odom", SIMULATOR, "/simulator"),
        endpoint("/scan", SIMULATOR, "/simulator"),
        endpoint("/cmd_vel", PLANNER, "/planner"),
        endpoint("/tf", PLANNER, "/planner"),
    ]


def integrity(view, line):
    return Integrity(view, line, "/simulator", TOPICS, evaluator_topics=("/score",))


def test_a_graph_too_large_to_be_looked_at_is_interference():
    message = "5000 topics are on the graph, more than 1000"
    view = View(ordinary(), topics=range(5000))
    assert integrity(view, Channel()).look() == message


@pytest.mark.parametrize("line", [Channel(), None], ids=["private line", "by hand"])
def test_an_ordinary_graph_is_in_order(line):
    watched = integrity(View(ordinary()), line)
    assert watched.look() == ""
    assert watched.remarks == ""


@pytest.mark.parametrize("line", [Channel(), None], ids=["private line", "by hand"])
@pytest.mark.parametrize(
    "foreign, words",
    [
        (("/odom", PLANNER, "/planner"), "/planner publishes /odom"),
        (("/scan", OTHER, ""), "an unnamed node publishes /scan"),
        (("/score", PLANNER, "/planner"), "/planner publishes /score"),
        (("/clock", OTHER, "/simulator"), "2 nodes are named /simulator"),
    ],
)
def test_foreign_publishers(line, foreign, words):
    assert integrity(View([*ordinary(), endpoint(*foreign)]), line).look() == words


def test_an_impostor_of_the_simulator_is_identified():
    # The simulator itself is not seen yet: without a line its name is all that is
    # known.
    forged = View([endpoint("/odom", PLANNER, "/simulator")])
    assert integrity(forged, Channel()).look() == "/simulator publishes /odom"
    assert integrity(forged, None).look() == ""


def test_simulator_calls_are_reported_with_their_callers():
    interference = Channel("called simulator/reset", "set seed of simulator")
    watched = integrity(View(ordinary(), clients=["/a", "/b"]), interference)
    assert watched.look() == "/a, /b called simulator/reset"
    watched = integrity(View(ordinary()), interference)
    assert watched.look() == "an unnamed node called simulator/reset"
    watched = integrity(View(ordinary()), interference)
    watched.begin()
    assert watched.look() == ""


def test_truth_readers_and_commanders_are_remarked_upon():
    view = View(
        [*ordinary(), endpoint("/cmd_vel", OTHER, "/joystick")],
        [endpoint("/truth", PLANNER, "/planner"), endpoint("/truth", OTHER, "/viewer")],
    )
    watched = integrity(view, Channel())
    assert watched.look() == ""
    view._publishers, view._subscriptions = ordinary(), ()
    assert watched.look() == ""
    remark = "/planner, /viewer subscribed to /truth; 2 publishers on /cmd_vel: /joystick, /planner"
    assert watched.remarks == remark
    watched.begin()
    assert watched.remarks == ""


class Loop:
    """Waits without spending time.

    A condition that does not hold by the given time never will.
    """

    def __init__(self, after=()):
        self.limits_s = []
        self._after = list(after)

    def wait(self, condition, limit_s):
        self.limits_s.append(limit_s)
        if limit_s:
            for change in self._after:
                change()
        return condition()


@pytest.mark.parametrize(
    "line, limit_s",
    [(Channel(), 0.0), (None, LEASE_S)],
    ids=["private line", "by hand"],
)
def test_only_a_manual_simulator_may_replace_another(line, limit_s):
    loop = Loop()
    view = View([*ordinary(), endpoint("/odom", OTHER, "/gone")])
    with pytest.raises(TrialEnded, match="/gone publishes /odom") as ended:
        integrity(view, line).require(loop)
    assert ended.value.outcome is Outcome.INTERFERENCE
    assert loop.limits_s == [limit_s]


def test_an_early_impostor_of_the_simulator_is_refused():
    foreign = endpoint("/clock", OTHER, "/gazebo")
    with refused(r"^ROS_DOMAIN_ID 55: /gazebo publishes /clock there"):
        integrity(View([foreign]), Channel()).require_alone(Loop(), "55")
    view = View([endpoint("/cmd_vel", PLANNER, "/planner")])
    integrity(view, Channel()).require_alone(Loop(), "55")


def test_what_is_about_to_go_does_not_refuse_a_run():
    view = View([endpoint("/clock", OTHER, "/gone")])

    def go():
        view._publishers = view._publishers[: 2 - len(loop.limits_s)]

    loop = Loop([go])
    integrity(view, Channel()).require_alone(loop, "55")
    assert len(loop.limits_s) == 2
