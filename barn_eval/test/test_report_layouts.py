"""The layouts for RViz and Foxglove name topics that a trial's bag has, with what is needed to receive them."""

import json
import re
from pathlib import Path

import pytest
import yaml

from barn_eval.direct import run_direct_trial
from barn_eval.protocol import PAPER
from barn_eval.recorder import Recorder
from barn_eval.trial import TrialSpec, simulator_config
from barn_worlds.dataset import open_dataset

CONFIG = Path(__file__).resolve().parents[1] / "config"


@pytest.fixture(scope="module")
def topics(tmp_path_factory):
    """Profiles of the topics of an E-Band trial's bag, which has all that a planner can show."""
    world = open_dataset("barn300").load(0)
    spec = TrialSpec("barn300", 0, world, "eband", "paper", {}, PAPER, simulator_config(PAPER), 1, 0)
    path = tmp_path_factory.mktemp("layouts") / "bag"
    with Recorder(path) as recorder:
        run_direct_trial(spec, recorder)
    listed = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    metadata = [entry["topic_metadata"] for entry in listed["topics_with_message_count"]]
    return {entry["name"]: yaml.safe_load(str(entry["offered_qos_profiles"]))[0] for entry in metadata}


def test_rviz_shows_what_there_is_and_can_receive_it(topics):
    content = yaml.safe_load((CONFIG / "barn.rviz").read_text())
    shown = {}
    for display in content["Visualization Manager"]["Displays"]:
        for key in ("Topic", "Description Topic"):
            if key in display:
                shown[display[key]["Value"]] = display[key]
    assert shown.keys() == {
        "/map", "/local_costmap/costmap", "/robot_description", "/scan", "/plan", "/local_plan", "/band",
        "/ground_truth/odom", "/goal_pose",
    }  # fmt: skip
    for name, profile in shown.items():
        offered = topics[name]
        # A subscription may not ask for more than the publisher offers.
        assert profile["Reliability Policy"] == "Best Effort" or offered["reliability"] == "reliable", name
        assert profile["Durability Policy"] == "Volatile" or offered["durability"] == "transient_local", name


def test_foxglove_shows_topics_that_there_are(topics):
    text = (CONFIG / "barn_foxglove.json").read_text()
    layout = json.loads(text)
    named = set(layout["configById"]["3D!barn"]["topics"]) | set(re.findall(r'"(?:value|path)": "(/[a-z_/]+)', text))
    assert named <= topics.keys()
    panels = set(re.findall(r'"(?:first|second)": "([^"]+)"', text))
    assert panels == set(layout["configById"])
