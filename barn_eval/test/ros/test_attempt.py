"""How `barn try` joins a planner's topics with the suite's."""

from barn_eval.ros.attempt import connect
from barn_eval.ros.readiness import TWIST, Endpoint, Graph

SCAN = "sensor_msgs/msg/LaserScan"
POSE = "geometry_msgs/msg/PoseStamped"


def endpoints(*pairs):
    return [Endpoint(topic, kind, b"") for topic, kind in pairs]


def test_the_last_of_a_chain_of_nodes_commands_and_the_first_hears():
    graph = Graph(
        endpoints(("/cmd_gap", TWIST), ("/cmd_out", TWIST), ("/scan_near", SCAN)),
        endpoints(("/cmd_gap", TWIST), ("/scan_near", SCAN), ("/scan_raw", SCAN)),
    )
    attempt = connect(graph)
    assert attempt.topics["cmd_vel"] == "/cmd_out"
    assert attempt.topics["scan"] == "/scan_raw"


def test_only_what_is_called_a_goal_is_one():
    poses = endpoints(("/current_pose", POSE), ("/move_base_simple/goal", POSE))
    attempt = connect(Graph((), poses))
    assert attempt.topics["goal_pose"] == "/move_base_simple/goal"
    record = ("/record", "own_interfaces/action/Record")
    graph = Graph((), poses[:1], [record])
    assert connect(graph).topics["goal_pose"] == ""
    graph = Graph((), (), [record, ("/go", "nav2_msgs/action/NavigateToPose")])
    assert connect(graph).topics["goal_pose"] == "action /go"
