"""The layouts for RViz and Foxglove name topics that a trial's bag has, with what is
needed to receive them.
"""

import dataclasses
import json
import re
from pathlib import Path

import pytest
import yaml
from planners import recorded, spec_of

from barn_eval.trials.protocol import DYNABARN, PAPER_2020
from barn_eval.trials.result import Outcome
from barn_worlds.messages.cdr import jazzy_types
from barn_worlds.messages.topics import CMD_VEL_STAMPED, GROUND_TRUTH, WORLD_PATH

CONFIG = Path(__file__).resolve().parents[2] / "config"
LAUNCH = CONFIG.parent / "launch"
RVIZ = yaml.safe_load((CONFIG / "barn.rviz").read_text())
FOXGLOVE = json.loads((CONFIG / "barn_foxglove.json").read_text())
PANELS = FOXGLOVE["configById"]
# What a display of RViz takes, by the end of its class.
DISPLAYS = {
    "Map": "nav_msgs/msg/OccupancyGrid",
    "RobotModel": "std_msgs/msg/String",
    "LaserScan": "sensor_msgs/msg/LaserScan",
    "Path": "nav_msgs/msg/Path",
    "MarkerArray": "visualization_msgs/msg/MarkerArray",
    "Odometry": "nav_msgs/msg/Odometry",
    "Pose": "geometry_msgs/msg/PoseStamped",
}
# The plans of a map server and of a planner have one topic, but other profiles.
OFF = {"Plan of a map server, published once"}
IN_THE_SCENE = {
    "/map", "/local_costmap/costmap", "/robot_description", "/scan", "/plan", "/local_plan", "/band", "/candidates",
    "/odom", "/goal_pose", "/score_text", "/world", "/moving_obstacles",
}  # fmt: skip


@pytest.fixture(scope="module")
def topics(tmp_path_factory):
    """Topics with type and profile that a trial's bag has.

    DWA's and E-Band's, and one among moving obstacles.
    """
    types = {}
    for planner, protocol in (
        ("dwa", PAPER_2020),
        ("eband", PAPER_2020),
        ("gap", DYNABARN),
    ):
        path = tmp_path_factory.mktemp("layouts") / "bag"
        recorded(spec_of(0, protocol, planner), path)
        listed = yaml.safe_load((path / "metadata.yaml").read_text())[
            "rosbag2_bagfile_information"
        ]
        for entry in listed["topics_with_message_count"]:
            metadata = entry["topic_metadata"]
            if entry["message_count"]:
                types[metadata["name"]] = (
                    metadata["type"],
                    yaml.safe_load(str(metadata["offered_qos_profiles"]))[0],
                )
    return types


def test_rviz_shows_what_there_is_and_can_receive_it(topics):
    displays = {}
    for display in RVIZ["Visualization Manager"]["Displays"]:
        for key in ("Topic", "Description Topic"):
            if key in display and display["Name"] not in OFF:
                assert display["Enabled"] is display["Value"] is True
                displays[display[key]["Value"]] = (
                    display["Class"].split("/")[1],
                    display[key],
                )
    assert displays.keys() == IN_THE_SCENE
    for name, (kind, profile) in displays.items():
        offered_type, offered = topics[name]
        assert DISPLAYS[kind] == offered_type, name
        # A subscription may not ask for more than the publisher offers.
        assert (
            profile["Reliability Policy"] == "Best Effort"
            or offered["reliability"] == "reliable"
        ), name
        assert (
            profile["Durability Policy"] == "Volatile"
            or offered["durability"] == "transient_local"
        ), name


def test_rviz_receives_the_plan_of_a_map_server():
    (display,) = (
        display
        for display in RVIZ["Visualization Manager"]["Displays"]
        if display["Name"] in OFF
    )
    assert display["Enabled"] is False
    assert display["Topic"]["Value"] == f"/{WORLD_PATH.name}"
    assert display["Topic"]["Durability Policy"] == "Transient Local"
    assert WORLD_PATH.qos.durability == "transient_local"


@pytest.mark.parametrize("name", ["barn.rviz", "barn_foxglove.json"])
def test_watching_asks_for_nothing_that_a_planner_must_not_hear(name):
    assert GROUND_TRUTH.name not in (CONFIG / name).read_text()


def test_rviz_follows_the_namespace():
    (topics,) = re.findall(
        r"(?s)TOPICS = \((.*?)\)", (LAUNCH / "rviz.launch.py").read_text()
    )
    absolute = {"/score_text", "/world", "/moving_obstacles"}
    renamed = {f"/{name}" for name in re.findall(r'"(.+?)"', topics)}
    assert renamed == IN_THE_SCENE - absolute


def test_foxglove_shows_what_there_is(topics):
    scene = PANELS["3D!barn"]
    robot = {
        layer["topic"]
        for layer in scene["layers"].values()
        if layer.get("sourceType") == "topic"
    }
    shown = {name for name, topic in scene["topics"].items() if topic["visible"]}
    assert shown | robot == IN_THE_SCENE
    assert topics.keys() >= IN_THE_SCENE
    places = json.dumps(FOXGLOVE["layout"])
    assert set(re.findall(r'"(?:first|second)": "([^"]+)"', places)) == set(PANELS)
    assert PANELS["DiagnosticSummary!all"]["topicToRender"] in topics


def test_panels_of_foxglove_have_settings_that_its_own_sdk_knows():
    layouts = pytest.importorskip(
        "foxglove.layouts", reason="foxglove-sdk, an optional extra, is not installed"
    )

    def strangers(content, kind):
        names = [field.name for field in dataclasses.fields(getattr(layouts, kind))]
        return set(content) - {
            re.sub("_(.)", lambda match: match[1].upper(), name) for name in names
        }

    kinds = {
        "3D": "ThreeDee",
        "Plot": "Plot",
        "Indicator": "Indicator",
        "DiagnosticSummary": "DiagnosticsSummary",
    }
    for name, panel in PANELS.items():
        assert strangers(panel, kinds[name.split("!")[0]] + "Config") <= {
            "foxglovePanelTitle"
        }, name
        parts = [(series, "PlotSeries") for series in panel.get("paths", [])]
        parts += [(rule, "IndicatorRule") for rule in panel.get("rules", [])]
        parts += [(panel.get("cameraState", {}), "ThreeDeeCameraState")]
        parts += [(panel.get("publish", {}), "ThreeDeePublishSettings")]
        assert [part for part in parts if strangers(*part)] == []


def test_paths_of_foxglove_lead_to_fields(topics):
    text = (CONFIG / "barn_foxglove.json").read_text()
    paths = re.findall(r'"(?:value|path)": "(/[a-z_/]+)\.([a-z_.]+)"', text)
    assert {topic for topic, _ in paths} == {
        "/odom",
        "/cmd_vel",
        "/score",
        "/outcome",
        "/collision",
    }
    stamped = {path for topic, path in paths if path.startswith("twist.")}
    for topic, path in paths:
        kind = topics[topic][0]
        if topic == "/cmd_vel" and path in stamped:
            kind = CMD_VEL_STAMPED.type_name
        for field in path.split("."):
            fields = dict(jazzy_types().fielddefs[kind][1])
            assert field in fields, (topic, path)
            kind = fields[field][1]


def test_foxglove_has_a_color_for_each_outcome():
    colored = {rule["rawValue"] for rule in PANELS["Indicator!outcome"]["rules"]}
    assert colored == {"running", *(outcome.value for outcome in Outcome)}
