from barn_eval.gate import TWIST, TWIST_STAMPED, Endpoint, Graph, Needs, inspect
from barn_eval.outcome import Outcome

SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
NEEDS = Needs("/cmd_vel", "auto", (("/scan", SCAN), ("/odom", ODOMETRY)))
INPUTS = (Endpoint("/scan", SCAN, b"s", reliable=False), Endpoint("/odom", ODOMETRY, b"o"))
SIMULATOR = (Endpoint("/scan", SCAN, b"S", reliable=False), Endpoint("/odom", ODOMETRY, b"O"))


def graph(*publishers, subscriptions=INPUTS):
    return Graph([*SIMULATOR, *publishers], subscriptions)


def test_a_complete_planner_passes_and_its_command_type_is_found():
    for kind in (TWIST, TWIST_STAMPED):
        finding = inspect(graph(Endpoint("/cmd_vel", kind, b"c", "/dwa_planner")), NEEDS)
        assert finding.ready
        assert finding.command_node == "/dwa_planner"
        assert finding.command_type == kind


def test_nothing_there():
    finding = inspect(Graph(), NEEDS)
    assert finding.text() == "no publisher on /cmd_vel; no subscription to /scan; no subscription to /odom"
    assert finding.outcome is Outcome.PLANNER_NOT_READY


def test_other_kind_of_twist_is_named():
    finding = inspect(graph(Endpoint("/cmd_vel", TWIST_STAMPED, b"c")), Needs("/cmd_vel", "twist", NEEDS.inputs))
    assert finding.text() == (
        "no publisher on /cmd_vel; a TwistStamped publisher exists on /cmd_vel, this run expects Twist"
    )
    assert finding.outcome is Outcome.WRONG_MESSAGE_TYPE


def test_a_type_that_is_no_velocity_is_named():
    finding = inspect(graph(Endpoint("/cmd_vel", "std_msgs/msg/String", b"c")), NEEDS)
    assert "a String publisher exists on /cmd_vel, this run expects Twist or TwistStamped" in finding.text()
    assert finding.outcome is Outcome.WRONG_MESSAGE_TYPE


def test_two_types_at_once_are_refused():
    both = (Endpoint("/cmd_vel", TWIST, b"1"), Endpoint("/cmd_vel", TWIST_STAMPED, b"2"))
    finding = inspect(graph(*both), NEEDS)
    assert finding.text() == "publishers of different types on /cmd_vel: Twist, TwistStamped"
    assert finding.outcome is Outcome.WRONG_MESSAGE_TYPE


def test_commands_on_another_topic_are_hinted_at():
    finding = inspect(graph(Endpoint("/nav/cmd_vel", TWIST, b"c")), NEEDS)
    assert finding.text() == "no publisher on /cmd_vel; a Twist publisher exists on /nav/cmd_vel, remap it"
    assert finding.outcome is Outcome.PLANNER_NOT_READY


def test_subscription_of_another_type():
    inputs = (Endpoint("/scan", "sensor_msgs/msg/PointCloud2", b"s"), INPUTS[1])
    finding = inspect(graph(Endpoint("/cmd_vel", TWIST, b"c"), subscriptions=inputs), NEEDS)
    assert finding.text() == "no subscription to /scan; one of PointCloud2 exists, it carries LaserScan"
    assert finding.outcome is Outcome.WRONG_MESSAGE_TYPE


def test_incompatible_quality_of_service():
    inputs = (Endpoint("/scan", SCAN, b"s", reliable=True), INPUTS[1])
    finding = inspect(graph(Endpoint("/cmd_vel", TWIST, b"c"), subscriptions=inputs), NEEDS)
    assert finding.text() == "the subscription to /scan asks for reliable delivery, which its publisher does not offer"
    inputs = (INPUTS[0], Endpoint("/odom", ODOMETRY, b"o", latched=True))
    finding = inspect(graph(Endpoint("/cmd_vel", TWIST, b"c"), subscriptions=inputs), NEEDS)
    assert "transient local durability" in finding.text()


def test_endpoints_of_the_dead_do_not_count():
    whole = graph(Endpoint("/cmd_vel", TWIST, b"c"))
    dead = whole.identities() - {b"S", b"O"}
    assert inspect(whole.without(dead), NEEDS).missing[0] == "no publisher on /cmd_vel"
    revived = Graph([*whole.publishers, Endpoint("/cmd_vel", TWIST, b"c2")], [*INPUTS, *whole.subscriptions])
    assert not inspect(revived.without(dead), NEEDS).ready
    inputs = [Endpoint("/scan", SCAN, b"s2", reliable=False), Endpoint("/odom", ODOMETRY, b"o2")]
    revived = Graph([*whole.publishers, Endpoint("/cmd_vel", TWIST, b"c2")], [*INPUTS, *inputs])
    assert inspect(revived.without(dead), NEEDS).ready
