from dataclasses import replace

from barn_eval.ros.readiness import POSE_STAMPED, TWIST, TWIST_STAMPED, Endpoint, Graph, Needs, inspect
from barn_eval.trials.outcome import Outcome

SCAN = "sensor_msgs/msg/LaserScan"
ACTION = "nav2_msgs/action/NavigateToPose"
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
    missing = "no publisher on /cmd_vel; no subscription to /scan; no subscription to /odom"
    assert finding.text() == f"{missing}; no node of a planner is seen"
    assert finding.outcome is Outcome.PLANNER_NOT_READY


def test_nobody_but_the_simulator_is_another_matter_than_a_planner_with_something_missing():
    needs = replace(NEEDS, known_nodes={"/simulator"}, surroundings="on ROS domain 5")
    own = [replace(endpoint, node="/simulator") for endpoint in SIMULATOR]
    assert inspect(Graph(own), needs).missing[-1] == "no node of a planner is seen on ROS domain 5"
    talker = Endpoint("/chatter", "std_msgs/msg/String", b"t", "/talker")
    assert inspect(Graph([*own, talker]), needs).missing[-1] == "no subscription to /odom"


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


def test_an_input_that_is_listened_for_elsewhere_is_hinted_at():
    inputs = (Endpoint("/front/scan", SCAN, b"s", "/nav"), INPUTS[1])
    finding = inspect(graph(Endpoint("/cmd_vel", TWIST, b"c", "/nav"), subscriptions=inputs), NEEDS)
    assert finding.text() == "no subscription to /scan; a LaserScan subscription exists on /front/scan, remap it"
    # the simulator's own subscriptions, and those that are served, are no hint
    served = Endpoint("/rear/scan", SCAN, b"R")
    needs = replace(NEEDS, known_nodes={"/nav"}, offered=[served])
    assert inspect(graph(subscriptions=inputs), needs).missing[1] == "no subscription to /scan"
    inputs = (replace(inputs[0], topic="/rear/scan"), INPUTS[1])
    assert inspect(graph(subscriptions=inputs), replace(needs, known_nodes=())).missing[1] == "no subscription to /scan"


def test_a_goal_that_the_evaluator_would_send_in_vain():
    latched = Endpoint("/goal_pose", POSE_STAMPED, b"g", "/nav", latched=True)
    needs = Needs("/cmd_vel", "auto", [("/goal_pose", POSE_STAMPED)], offered=[replace(latched, latched=False)])
    command = Endpoint("/cmd_vel", TWIST, b"c", "/nav")
    assert inspect(graph(command, subscriptions=[latched]), needs).text() == (
        "the subscription to /goal_pose asks for transient local durability, which its publisher does not offer"
    )
    by_action = Graph([command], [], [("/navigate_to_pose", ACTION)])
    assert inspect(by_action, needs).text() == (
        "no subscription to /goal_pose; the action /navigate_to_pose takes goals, set goal_by to action"
    )


def test_an_action_for_the_goal():
    command = Endpoint("/cmd_vel", TWIST, b"c", "/nav")
    needs = Needs("/cmd_vel", action=("/navigate_to_pose", ACTION))
    assert inspect(Graph([command], [], [("/navigate_to_pose", ACTION)]), needs).ready
    assert inspect(Graph([command]), needs).text() == "no action /navigate_to_pose"
    elsewhere = inspect(Graph([command], [], [("/robot/navigate_to_pose", ACTION)]), needs)
    assert elsewhere.text() == (
        "no action /navigate_to_pose; a NavigateToPose action exists as /robot/navigate_to_pose"
    )
    assert elsewhere.outcome is Outcome.PLANNER_NOT_READY
    other = inspect(Graph([command], [], [("/navigate_to_pose", "my_msgs/action/Drive")]), needs)
    assert other.text() == "no action /navigate_to_pose of NavigateToPose; one of Drive exists"
    assert other.outcome is Outcome.WRONG_MESSAGE_TYPE


def test_commands_without_guarantee_of_delivery_are_taken_and_known_as_such():
    for reliable in (True, False):
        finding = inspect(graph(Endpoint("/cmd_vel", TWIST, b"c", "/nav", reliable=reliable)), NEEDS)
        assert finding.ready
        assert finding.command_reliable is reliable
