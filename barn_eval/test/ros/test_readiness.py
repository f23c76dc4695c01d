"""What a planner lacks before a trial over ROS, and which silence ends one that runs."""

from dataclasses import replace

import pytest

from barn_eval.ros.readiness import (
    POSE_STAMPED,
    TWIST,
    TWIST_STAMPED,
    Endpoint,
    Graph,
    Needs,
    Watchdog,
    inspect,
)
from barn_eval.trials.result import Outcome
from barn_eval.trials.ros_config import WaitLimits

SCAN = "sensor_msgs/msg/LaserScan"
ACTION = "nav2_msgs/action/NavigateToPose"
ODOMETRY = "nav_msgs/msg/Odometry"
NEEDS = Needs("/cmd_vel", "auto", (("/scan", SCAN), ("/odom", ODOMETRY)))
INPUTS = (
    Endpoint("/scan", SCAN, b"s", reliable=False),
    Endpoint("/odom", ODOMETRY, b"o"),
)
SIMULATOR = (
    Endpoint("/scan", SCAN, b"S", reliable=False),
    Endpoint("/odom", ODOMETRY, b"O"),
)


def commander(kind=TWIST, node="", **quality):
    """Return the endpoint of a node that publishes commands."""
    return Endpoint("/cmd_vel", kind, b"c", node, **quality)


def graph(*publishers, subscriptions=INPUTS):
    return Graph([*SIMULATOR, *publishers], subscriptions)


def test_a_complete_planner_passes_and_its_command_type_is_found():
    for kind in (TWIST, TWIST_STAMPED):
        finding = inspect(graph(commander(kind, "/dwa_planner")), NEEDS)
        assert (finding.text(), finding.command_type) == ("", kind)
        assert finding.command_node == "/dwa_planner"


def test_a_missing_simulator_differs_from_a_missing_planner():
    needs = replace(NEEDS, known_nodes={"/simulator"}, surroundings="on ROS domain 5")
    endpoints = [replace(endpoint, node="/simulator") for endpoint in SIMULATOR]
    alone = inspect(Graph(endpoints), needs)
    assert alone.missing[-1] == "no node of a planner is seen on ROS domain 5"
    talker = Endpoint("/chatter", "std_msgs/msg/String", b"t", "/talker")
    beside = inspect(Graph([*endpoints, talker]), needs)
    assert beside.missing[-1] == "no subscription to /odom"


COMMAND = commander()
OTHER_SCAN = Endpoint("/scan", "sensor_msgs/msg/PointCloud2", b"s")
STAMPED, TEXT = (
    Endpoint("/cmd_vel", kind, b"2") for kind in (TWIST_STAMPED, "std_msgs/msg/String")
)
ELSEWHERE = replace(COMMAND, topic="/nav/cmd_vel")
NOT_READY = Outcome.PLANNER_NOT_READY
WRONG_TYPE = Outcome.WRONG_MESSAGE_TYPE
NO_COMMAND = "no publisher on /cmd_vel"
THERE = "publisher exists on /cmd_vel"
NO_SCAN = (
    "no subscription to /scan; one of PointCloud2 exists, but it carries LaserScan"
)
NOBODY = "no node of a planner is seen"


@pytest.mark.parametrize(
    "endpoints, command_type, message, outcome",
    [
        (
            Graph(),
            "auto",
            f"{NO_COMMAND}; no subscription to /scan; no subscription to /odom; {NOBODY}",
            NOT_READY,
        ),
        (
            graph(STAMPED),
            "twist",
            f"{NO_COMMAND}; a TwistStamped {THERE}, but this run expects Twist",
            WRONG_TYPE,
        ),
        (
            graph(TEXT),
            "auto",
            f"{NO_COMMAND}; a String {THERE}, but this run expects Twist or TwistStamped",
            WRONG_TYPE,
        ),
        (
            graph(COMMAND, STAMPED),
            "auto",
            "publishers of different types on /cmd_vel: Twist, TwistStamped",
            WRONG_TYPE,
        ),
        (
            graph(ELSEWHERE),
            "auto",
            f"{NO_COMMAND}; a Twist publisher exists on /nav/cmd_vel: remap it",
            NOT_READY,
        ),
        (
            graph(COMMAND, subscriptions=(OTHER_SCAN, INPUTS[1])),
            "auto",
            NO_SCAN,
            WRONG_TYPE,
        ),
    ],
)
def test_what_is_missing_is_named_with_what_is_there_instead(
    endpoints, command_type, message, outcome
):
    finding = inspect(endpoints, replace(NEEDS, command_type=command_type))
    assert (finding.text(), finding.outcome) == (message, outcome)


def test_incompatible_quality_of_service():
    inputs = (Endpoint("/scan", SCAN, b"s", reliable=True), INPUTS[1])
    finding = inspect(graph(COMMAND, subscriptions=inputs), NEEDS)
    assert finding.text() == (
        "the subscription to /scan asks for reliable delivery, "
        "which its publisher does not offer; "
        "subscribe with best effort (in rclpy qos_profile_sensor_data)"
    )
    assert finding.has_unfit_qos
    inputs = (INPUTS[0], Endpoint("/odom", ODOMETRY, b"o", latched=True))
    finding = inspect(graph(COMMAND, subscriptions=inputs), NEEDS)
    assert "transient local durability" in finding.text()
    assert finding.has_unfit_qos
    assert not inspect(graph(subscriptions=INPUTS), NEEDS).has_unfit_qos


def test_an_input_that_is_listened_for_elsewhere_is_hinted_at():
    inputs = (Endpoint("/front/scan", SCAN, b"s", "/nav"), INPUTS[1])
    finding = inspect(graph(commander(node="/nav"), subscriptions=inputs), NEEDS)
    assert finding.text() == (
        "no subscription to /scan; "
        "a LaserScan subscription exists on /front/scan: remap it"
    )
    # the simulator's own subscriptions, and those that are served, are no hint
    served = Endpoint("/rear/scan", SCAN, b"R")
    needs = replace(NEEDS, known_nodes={"/nav"}, offered=[served])
    own = inspect(graph(subscriptions=inputs), needs)
    assert own.missing[1] == "no subscription to /scan"
    inputs = (replace(inputs[0], topic="/rear/scan"), INPUTS[1])
    strange = inspect(graph(subscriptions=inputs), replace(needs, known_nodes=()))
    assert strange.missing[1] == "no subscription to /scan"


def test_a_goal_that_the_evaluator_would_send_in_vain():
    latched = Endpoint("/goal_pose", POSE_STAMPED, b"g", "/nav", latched=True)
    offered = [replace(latched, latched=False)]
    needs = Needs("/cmd_vel", "auto", [("/goal_pose", POSE_STAMPED)], offered=offered)
    command = commander(node="/nav")
    assert inspect(graph(command, subscriptions=[latched]), needs).text() == (
        "the subscription to /goal_pose asks for transient local durability, which its publisher does not offer;"
        " subscribe with volatile durability (in rclpy depth 10 alone)"
    )
    by_action = Graph([command], [], [("/navigate_to_pose", ACTION)])
    assert inspect(by_action, needs).text() == (
        "no subscription to /goal_pose; the action /navigate_to_pose takes goals: set goal_by to action"
    )


def test_an_action_for_the_goal():
    def find(*actions):
        needs = Needs("/cmd_vel", action=("/navigate_to_pose", ACTION))
        return inspect(Graph([commander(node="/nav")], [], actions), needs)

    missing = "no action /navigate_to_pose"
    assert find(("/navigate_to_pose", ACTION)).text() == ""
    assert find().text() == missing
    elsewhere = find(("/robot/navigate_to_pose", ACTION))
    there = "a NavigateToPose action exists as /robot/navigate_to_pose"
    assert elsewhere.text() == f"{missing}; {there}"
    assert elsewhere.outcome is Outcome.PLANNER_NOT_READY
    other = find(("/navigate_to_pose", "my_msgs/action/Drive"))
    assert other.text() == f"{missing} of NavigateToPose; one of Drive exists"
    assert other.outcome is Outcome.WRONG_MESSAGE_TYPE


def test_best_effort_commands_are_accepted_and_marked():
    for reliable in (True, False):
        finding = inspect(graph(commander(node="/nav", reliable=reliable)), NEEDS)
        assert (finding.text(), finding.command_reliable) == ("", reliable)


PATIENCE = WaitLimits(command_s=5.0, clock_s=3.0, vanished_s=1.0, trial_s=60.0)


def quiet(watch, now_s, *, ticks=True, commands=True, publisher=True):
    number = round(10 * now_s)  # which grows
    watch.hear(now_s, number if ticks else 0, number if commands else 0)
    if publisher:
        watch.publisher_seen(now_s)


def test_each_silence_has_its_own_outcome():
    cases = (
        ({"ticks": False}, 3.0, True, Outcome.SIMULATOR_DIED),
        ({"publisher": False}, 1.0, True, Outcome.PLANNER_DIED),
        ({"commands": False}, 5.0, False, Outcome.NO_FIRST_MOTION),
        ({"commands": False}, 5.0, True, Outcome.PLANNER_STALLED),
    )
    for missing, limit_s, has_started, outcome in cases:
        watch = Watchdog(PATIENCE, 100.0)
        quiet(watch, 101.0)
        quiet(watch, 101.0 + limit_s, **missing)
        assert watch.judge(101.0 + limit_s, has_started=has_started) is None
        quiet(watch, 101.1 + limit_s, **missing)
        assert watch.judge(101.1 + limit_s, has_started=has_started)[0] is outcome


def test_a_simulator_that_is_stuck_is_not_the_planners_silence():
    watch = Watchdog(WaitLimits(command_s=3.0, clock_s=5.0), 0.0)
    quiet(watch, 1.0)
    quiet(watch, 5.0, ticks=False, commands=False)
    assert watch.judge(5.0, has_started=True) is None
    quiet(watch, 6.1, ticks=False, commands=False)
    verdict = (Outcome.SIMULATOR_DIED, "no tick of /clock for 5 s")
    assert watch.judge(6.1, has_started=True) == verdict


def test_a_trial_without_end():
    watch = Watchdog(PATIENCE, 0.0)
    quiet(watch, 60.0)
    assert watch.judge(60.0, has_started=True) is None
    quiet(watch, 61.0)
    verdict = (Outcome.PLANNER_STALLED, "no verdict after 60 s of wall-clock time")
    assert watch.judge(61.0, has_started=True) == verdict


def test_a_planner_at_a_fifth_of_a_hertz_is_ended_after_a_minute():
    watch = Watchdog(WaitLimits(), 0.0)
    verdict = None
    now_s = 0.0
    # 5 s for each step of 0.05 s, all of them spent waiting for its answer
    while verdict is None:
        now_s += 5.0
        quiet(watch, now_s)
        spent = {"simulated_s": 0.01 * now_s, "waited_s": now_s}
        verdict = watch.judge(now_s, has_started=True, **spent)
    assert now_s == 60.0
    assert verdict == (
        Outcome.PLANNER_STALLED,
        "60 s of wall-clock time for 0.60 simulated seconds: more than 50 s per simulated second",
    )


@pytest.mark.parametrize(
    "pace, owed",
    [(0.03, 1.0), (0.01, 0.4)],
    ids=["slow enough", "the simulator is slow"],
)
def test_a_slow_planner_or_a_slow_simulator_is_not_ended(pace, owed):
    watch = Watchdog(WaitLimits(), 0.0)
    for second in range(0, 600, 5):
        quiet(watch, float(second))
        spent = {"simulated_s": second * pace, "waited_s": second * owed}
        assert watch.judge(float(second), has_started=True, **spent) is None


def test_the_silence_of_a_planner_that_never_spoke_says_so():
    watch = Watchdog(PATIENCE, 0.0)
    quiet(watch, 5.5, commands=False)
    assert watch.judge(5.5, has_started=False)[1].endswith("none since the trial began")
