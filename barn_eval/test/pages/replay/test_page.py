"""Replays from bags alone.

What the trial was, whoever wrote the bag and whatever has become of it.
"""

import json
import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
from browser import violations
from foreign_bags import at_half_real_time, in_namespace, messages_of, write_bag
from PIL import Image
from refusals import refused
from report_work import EVIL, drive
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from barn_eval.pages.replay.files import write_replay
from barn_eval.pages.replay.page import label_trials, replay_page
from barn_eval.pages.replay.payload import bounds, progress_m
from barn_eval.results.bags.bagfile import BagFile
from barn_eval.results.bags.recorded import read_recorded_trial
from barn_eval.results.bags.recorder import Recorder
from barn_eval.results.bags.sources import Sources
from barn_eval.trials.protocol import DYNABARN, PAPER_2020
from barn_planners.runtime.messages import MAX_CANDIDATES
from barn_worlds.base.arrays import side_lengths
from barn_worlds.base.errors import BagError
from barn_worlds.base.types import NANOSECONDS_PER_SECOND, Pose2D
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.messages import topics
from barn_worlds.messages.cdr import jazzy_types, make_message, serialize


@pytest.fixture(scope="module")
def moving_bag(tmp_path_factory):
    run = drive(tmp_path_factory.mktemp("moving") / "run", DYNABARN)
    return run / "bags" / "gap_w0000_r00"


@pytest.fixture(params=["bag", "moving_bag"])
def either_bag(request):
    """The bag of a trial where nothing moves, and of one among moving obstacles."""
    return request.getfixturevalue(request.param)


def test_what_the_scans_hit_is_drawn_where_they_hit_it(bag):
    """The map that the paper's protocol gives is off by a cell, and a pose that is
    matched to it is drawn there.
    """
    recorded = read_recorded_trial(bag)
    assert recorded.map_frame == Pose2D(0.0, 0.15, 0.0)
    assert any("0.15 m" in note for note in recorded.notes)
    grid = recorded.map

    def share_on_obstacles(off_y_m):
        hits = []
        scans = recorded.items[topics.SCAN]
        for scan, pose in zip(scans[::20], recorded.poses[::20], strict=True):
            ranges = np.asarray(scan.content.ranges)
            angles = scan.content.angles()
            near = np.isfinite(ranges) & (ranges < 8.0)
            # half a cylinder's radius behind its surface
            reach = ranges[near, None] + 0.04
            ends = reach * np.stack(
                [np.cos(angles[near]), np.sin(angles[near])], axis=1
            )
            lidar = Pose2D(*pose.tolist()) @ recorded.lidar
            x, y = lidar.transform(ends).T
            rows = (y + off_y_m - grid.origin_y) / grid.resolution
            columns = (x - grid.origin_x) / grid.resolution
            cells = np.floor(np.column_stack([rows, columns])).astype(int)
            inside = ((cells >= 0) & (cells < grid.data.shape)).all(axis=1)
            hits.extend(grid.data[tuple(cells[inside].T)] >= 50)
        return np.mean(hits)

    assert share_on_obstacles(0.0) > 0.9
    assert share_on_obstacles(0.15) < 0.8


def copy_of(bag, path, change):
    """A copy of a bag whose file has been put through a change."""
    shutil.copytree(bag, path)
    (file,) = path.glob("*.mcap")
    file.write_bytes(change(file.read_bytes()))
    return path


def messages_on(reader, topic):
    """Return the messages of a topic of a bag."""
    connections = [item for item in reader.connections if item.topic == topic]
    return reader.messages(connections)


def test_poses_scans_and_result_are_those_of_the_bag(bag):
    recorded = read_recorded_trial(bag)
    with Reader(bag) as reader:
        read = jazzy_types().deserialize_cdr
        messages = [
            (stamp, read(data, connection.msgtype))
            for connection, stamp, data in messages_on(reader, "/ground_truth/odom")
        ]
    assert len(recorded.times_s) == len(messages) == len(recorded.items[topics.SCAN])
    stamps = [stamp for stamp, _ in messages]
    times_s = (np.array(stamps) - stamps[0]) / NANOSECONDS_PER_SECOND
    np.testing.assert_array_equal(recorded.times_s, times_s)
    positions = [message.pose.pose.position for _, message in messages]
    expected = [[position.x, position.y] for position in positions]
    assert recorded.poses[:, :2].tolist() == expected
    assert recorded.result["outcome"] == "success"
    assert recorded.map is not None
    assert np.isfinite(recorded.commands[1:]).all()
    assert recorded.lidar.x == pytest.approx(0.12)
    outcomes = recorded.items[topics.OUTCOME]
    assert outcomes[0].content == "running"
    assert outcomes[-1] == (pytest.approx(recorded.times_s[-1]), "", "success")
    score = recorded.items[topics.SCORE][-1].content
    assert score == recorded.result["scores"]["challenge"]
    candidates = recorded.items[topics.CANDIDATES]
    for item in candidates:
        assert len(item.content.lines) == MAX_CANDIDATES
    assert len(candidates) == math.ceil(len(messages) / 10)  # two a second
    (note,) = recorded.notes
    assert note.startswith("map ")  # that the map was off


def test_a_cut_off_bag_is_replayed_as_far_as_it_goes(either_bag, tmp_path):
    whole = read_recorded_trial(either_bag)
    part = copy_of(
        either_bag, tmp_path / "cut", lambda data: data[: len(data) * 6 // 10]
    )
    cut = read_recorded_trial(part)
    assert 0.2 < len(cut.times_s) / len(whole.times_s) < 0.9
    assert cut.poses.tolist() == whole.poses[: len(cut.poses)].tolist()
    assert "cut off" in cut.notes[0]
    assert "no result" in " ".join(cut.notes)
    assert "the bag is cut off after" in replay_page(cut)


def test_a_bag_cut_inside_a_number_is_read_up_to_there(either_bag, tmp_path):
    (file,) = either_bag.glob("*.mcap")
    data = file.read_bytes()
    cut = tmp_path / "cut.mcap"
    problems = set()
    # the record before the last eight bytes has three numbers
    for length in range(len(data) - 36, len(data) - 8):
        cut.write_bytes(data[:length])
        bag_file = BagFile(cut)
        assert sum(1 for _ in bag_file.messages()) > 1000
        problems.add(bag_file.problem.partition(" after ")[0])
    assert problems == {"the bag is cut off"}


def test_a_damaged_bag_is_replayed_as_far_as_it_is_whole(either_bag, tmp_path):
    whole = read_recorded_trial(either_bag)
    (file,) = either_bag.glob("*.mcap")
    middle = file.read_bytes()[file.stat().st_size // 2 :][:64]
    damaged = copy_of(
        either_bag, tmp_path / "damaged", lambda data: data.replace(middle, bytes(64))
    )
    hurt = read_recorded_trial(damaged)
    assert 0.1 < len(hurt.times_s) / len(whole.times_s) < 0.9
    assert hurt.notes[0].startswith("the bag is damaged after ")


@pytest.mark.parametrize(
    "content, message",
    [
        (b"", ", or cut off at its beginning"),
        (b"no bag at all", ""),
        (bytes(1000), ""),
        (b"\x89MCAP0\r\n", ", or cut off at its beginning"),
        (b"\x89MCAP0\r\n" + b"\xff" * 99, ", or damaged at its beginning"),
    ],
)
def test_files_that_are_no_bags_are_refused_in_one_line(
    content, message, tmp_path, rejected
):
    (tmp_path / "thing.mcap").write_bytes(content)
    error = rejected("replay thing.mcap --out out.html")
    assert f"thing.mcap: not an MCAP file{message}\n" in error


def test_folders_without_a_bag_are_refused(tmp_path):
    with refused("no such bag", BagError):
        read_recorded_trial(tmp_path / "nowhere")
    with refused("holds no bag", BagError):
        read_recorded_trial(tmp_path)


def test_a_bag_that_lacks_one_of_its_files_is_refused(tmp_path):
    (tmp_path / "a_0.mcap").touch()
    (tmp_path / "metadata.yaml").write_text("  - a_0.mcap\n  - path: a_1.mcap\n")
    with refused("has 1 of the 2 files that metadata.yaml lists", BagError):
        read_recorded_trial(tmp_path)


def test_a_bag_of_something_else_is_refused(tmp_path):
    with Recorder(tmp_path / "talk") as recorder:
        recorder.add_topic("/chatter", "std_msgs/msg/String")
        message = make_message("std_msgs/msg/String", data="hello")
        recorder.write("/chatter", serialize(message), 1)
        recorder.finish()
    with refused(r"no poses of a robot on /ground_truth/odom or /odom", BagError):
        read_recorded_trial(tmp_path / "talk")


def test_a_foreign_bag_in_sqlite_with_odometry_alone_is_replayed(bag, tmp_path):
    """As another recorder may write it.

    SQLite, no truth, no result, a topic of a type it should not have.
    """
    path = tmp_path / "foreign"
    types = jazzy_types()
    with (
        Reader(bag) as reader,
        Writer(path, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer,
    ):
        odometry = writer.add_connection(
            "/odom", "nav_msgs/msg/Odometry", typestore=types
        )
        wrong = writer.add_connection("/map", "std_msgs/msg/String", typestore=types)
        message = make_message("std_msgs/msg/String", data=EVIL)
        writer.write(wrong, 0, serialize(message))
        lost = make_message("nav_msgs/msg/Odometry")
        lost.pose.pose.position.x = math.nan
        writer.write(odometry, 1, serialize(lost))
        for _, stamp, data in messages_on(reader, "/odom"):
            writer.write(odometry, stamp, data)
    recorded = read_recorded_trial(path)
    assert (recorded.frame, recorded.map) == ("odom", None)
    notes = " ".join(recorded.notes)
    assert "positions are from the odometry" in notes
    assert "/map is left out because its type is std_msgs/msg/String" in notes
    assert "/odom has messages that cannot be decoded (values that are not" in notes
    assert len(recorded.times_s) == len(read_recorded_trial(bag).times_s)


def some_of(bag, path, is_wanted, metadata):
    """A copy of a bag with the topics that are wanted, and what is known about its
    trial, if anything is.
    """
    with Reader(bag) as reader, Recorder(path) as recorder:
        for connection, stamp, data in reader.messages():
            if is_wanted(connection.topic):
                recorder.add_topic(connection.topic, connection.msgtype)
                recorder.write(connection.topic, data, stamp)
        if metadata:
            recorder.add_metadata("barn.trial", {"specification": json.dumps(metadata)})
        recorder.finish()
    return path


@pytest.mark.parametrize("specified", [True, False])
def test_without_static_transforms_the_lidar_is_as_specified(bag, tmp_path, specified):
    """As in bags of trials over ROS where tf2_msgs is not installed.

    Another's bag says nothing of its lidar.
    """
    metadata = {"simulator": {"lidar": {"mount_x_m": 0.2}}} if specified else {}
    is_wanted = {"/ground_truth/odom", "/scan"}.__contains__
    recorded = read_recorded_trial(some_of(bag, tmp_path / "bare", is_wanted, metadata))
    assert recorded.lidar == Pose2D(0.2 if specified else 0.0, 0.0, 0.0)
    assert ("assumed at base_link" in str(recorded.problems)) != specified
    assert {*recorded.problems} <= {*recorded.notes}


def test_the_world_is_that_of_the_bag(bag, tmp_path):
    world = open_dataset("barn300").load(0)
    recorded = read_recorded_trial(bag)
    assert recorded.scene.cylinders_m.tolist() == world.cylinders_m.tolist()
    scene = recorded.scene
    assert [scene.start.x, scene.start.y] == pytest.approx(
        recorded.poses[0, :2], abs=1e-3
    )
    assert recorded.goal_pose().distance(PAPER_2020.course(world).goal) == 0.0
    nearest_m = recorded.result["measures"]["min_clearance_m"]
    assert recorded.clearance_m.min() == nearest_m
    shown = bounds(recorded)
    assert (np.array(shown[:2]) <= world.bounds_m[:2]).all()
    assert (np.array(shown[2:]) >= world.bounds_m[2:]).all()
    assert shown[3] >= scene.goal.y + scene.goal_distance_m
    part = some_of(bag, tmp_path / "other", "/world".__ne__, recorded.trial)
    other = read_recorded_trial(part)
    assert other.scene is None
    assert np.isnan(other.clearance_m).all()
    assert '"scene":null' in replay_page(other)


def test_progress_is_along_the_path_and_never_back(bag):
    recorded = read_recorded_trial(bag)
    along_m = progress_m(recorded)
    assert along_m[0] == pytest.approx(0.0, abs=0.05)
    assert (np.diff(along_m) >= 0.0).all()
    scene = recorded.scene
    ends = [[pose.x, pose.y] for pose in (scene.start, scene.goal)]
    whole = np.vstack([ends[0], scene.path_m, ends[1]])
    length_m = side_lengths(whole).sum()
    assert length_m - scene.goal_distance_m - 0.1 < along_m[-1] < length_m + 1e-9
    back = replace(recorded, poses=recorded.poses[::-1].copy())
    assert np.ptp(progress_m(back)) == pytest.approx(0.0, abs=0.05)


def test_trials_are_told_apart_by_planner_then_bag_then_folder(bag):
    first = read_recorded_trial(bag)
    other = replace(first, trial=first.trial | {"planner": {"name": "dwa"}})
    assert label_trials([first, other]) == ["gap", "DWA"]
    names = label_trials([first, replace(first, name="later")])
    assert names == ["gap (gap_w0000_r00)", "gap (later)"]
    names = label_trials([first, replace(first, folder="again")])
    assert names == ["gap (run)", "gap (again)"]
    assert label_trials([first, first]) == ["gap (1)", "gap (2)"]


def test_texts_of_a_bag_are_shown_and_not_run(either_bag, tmp_path):
    recorded = read_recorded_trial(either_bag)
    recorded.result["detail"] = recorded.result["planner"] = EVIL
    recorded.trial["world"]["name"] = EVIL
    page = replay_page(recorded)
    assert EVIL not in page
    assert "&lt;/script&gt;&lt;script&gt;window.evil=1" in page


def test_the_page_plays_pauses_scrubs_and_changes_speed(bag, open_page, tmp_path):
    file = tmp_path / "replay.html"
    assert write_replay([bag], [file]) == [file]
    page = open_page(file)
    time = "window.replay.player.time"

    def pixels():
        return page.evaluate("document.getElementById('scene').toDataURL()")

    def text(element):
        return page.locator(f"#{element}").text_content()

    first = pixels()
    page.select_option("#speed", "0.25")
    page.click("#play")
    page.wait_for_function(f"{time} > 0.2")
    page.click("#play")
    paused = page.evaluate(time)
    assert text("play") == "Play"
    page.wait_for_timeout(200)
    assert page.evaluate(time) == paused
    assert pixels() != first
    page.locator("#scrub").evaluate(
        "(one) => { one.value = 2.0; one.dispatchEvent(new Event('input')) }"
    )
    assert page.evaluate(time) == pytest.approx(2.0, abs=0.01)
    assert text("clock").startswith("2.00 /")
    for layer in ("scan", "candidates"):
        pixels_before = pixels()
        page.click(f"#layer-{layer}")
        assert pixels() != pixels_before
    assert text("score") == "0.500, running"
    assert paused < 2.0  # a quarter of real time
    page.evaluate("window.replay.player.seek(1e9)")
    assert text("score").endswith(", success")
    page.click("#play")  # from the end it begins again
    page.wait_for_function(f"{time} > 0 && {time} < window.replay.player.end - 1")


def test_two_trials_on_one_clock_looked_at_by_mouse_and_by_keys(
    bag, open_page, screenshots, tmp_path
):
    recorded = read_recorded_trial(bag)
    times_s = recorded.times_s
    contact = (times_s > 2.0) & (times_s < 2.3)
    touched = replace(recorded, contact=contact, recoveries_s=(3.0,))
    trial = recorded.trial | {"planner": {"name": EVIL}}
    slower = replace(recorded, times_s=2.0 * times_s, trial=trial)
    file = tmp_path / "two.html"
    file.write_text(replay_page(touched, slower), "utf-8")
    page = open_page(file)
    key = page.keyboard.press

    def clock():
        return page.evaluate("replay.player.time")

    def pixels():
        return page.evaluate(
            "['scene', 'scene-1'].map((id) => document.getElementById(id).toDataURL())"
        )

    def read_status():
        return page.locator("#told").text_content()

    assert page.evaluate("document.querySelectorAll('figure').length") == 2
    assert page.evaluate("window.evil") is None
    end_s = page.evaluate("replay.player.end")
    assert end_s == pytest.approx(2.0 * times_s[-1], abs=0.01)
    page.screenshot(path=screenshots / "replay_two.png", full_page=True)
    assert violations(page) == []
    # Contact, recovery and closest approach: forward, back and around.
    for name, expected in (("c", 2.05), ("r", 3.0), ("Shift+c", 2.05), ("c", 2.05)):
        key(name)
        assert clock() == pytest.approx(expected, abs=0.051)
    assert read_status().startswith("gap: contact at 2.0")
    assert page.evaluate("replay.view.zoom") > 2.0
    page.click("#to-closest")
    closest_s = times_s[recorded.clearance_m.argmin()]
    assert clock() == pytest.approx(closest_s, abs=0.01)
    key("0")
    whole = pixels()
    # Zoom by wheel keeps the point under the mouse; both scenes follow; Fit shows all
    # again.
    page.locator("#scene").evaluate(
        "(one) => one.addEventListener('wheel', (event) => {"
        "window.spot = [event.offsetX, event.offsetY]; window.before = replay.scenes[0].at(...spot) }, {capture: true})"
    )
    page.hover("#scene", position={"x": 300, "y": 200})
    page.mouse.wheel(0, -600)
    page.wait_for_function("replay.view.zoom > 1")
    after = page.evaluate("[replay.scenes[0].at(...spot), before]")
    assert after[0] == pytest.approx(after[1], abs=1e-6)
    near = pixels()
    assert near[0] != whole[0] and near[1] != whole[1]
    key("a")
    moved = pixels()
    assert moved[0] != near[0]
    page.click("#zoom-reset")
    assert pixels() == whole
    # A ruler of two points a meter apart, and by keys one of no length.
    page.click("#measure")
    page.evaluate("replay.view.put([-2, 5]); replay.view.put([-2, 6])")
    assert read_status() == "1.00 m"
    for name in ("m", "m", "p", "p"):
        key(name)
    assert page.evaluate("replay.view.length") == 0.0
    key("m")
    # Aligned along the path, the slower one is as far at twice the time.
    page.select_option("#align", "progress")
    page.evaluate("replay.player.seek(3)")
    times = page.evaluate("replay.trials.map((one) => replay.timeOf(one))")
    assert times[1] == pytest.approx(2.0 * times[0], abs=0.01)
    assert page.locator("#clock").text_content().endswith(" m")
    page.select_option("#arrange", "overlay")
    assert page.evaluate("document.getElementById('scene-1').clientWidth") == 0


@pytest.mark.parametrize("change", [at_half_real_time, in_namespace])
def test_a_bag_of_another_log_shows_the_times_and_poses_of_the_robot(
    bag, tmp_path, change
):
    own = read_recorded_trial(bag)
    path = write_bag(tmp_path / "other", messages_of(bag, change))
    recorded = read_recorded_trial(path)
    np.testing.assert_allclose(recorded.times_s, own.times_s, atol=1e-6)
    np.testing.assert_array_equal(recorded.poses, own.poses)
    scan_times, own_times = (
        [item.time_s for item in trial.items[topics.SCAN]] for trial in (recorded, own)
    )
    np.testing.assert_allclose(scan_times, own_times, atol=1e-6)


def test_poses_of_named_frames_are_drawn_over_the_map_of_the_bag(bag, tmp_path):
    def change(message):
        is_shown = message.topic in ("/tf", "/tf_static", "/map", "/scan")
        return message if is_shown else None

    path = write_bag(tmp_path / "map.bag", messages_of(bag, change), "ros1")
    with refused(
        "no poses of a robot on /ground_truth/odom or .*; it has /map", BagError
    ):
        read_recorded_trial(path)
    with refused("other frames are between: --pose /tf:map.odom.base_link", BagError):
        read_recorded_trial(path, Sources(pose="/tf:map.base_link"))
    recorded = read_recorded_trial(path, Sources(pose="/tf:map.odom.base_link"))
    assert (recorded.frame, len(recorded.poses) > 10) == ("map", True)
    assert len(recorded.scene.obstacles_m) > 50
    notes = " ".join(recorded.notes)
    assert "obstacles are the occupied cells of the bag's map" in notes
    assert "contacts are unknown" in notes
    picture = tmp_path / "map.png"
    write_replay([path], [picture], sources=Sources(pose="/tf:map.odom.base_link"))
    assert Image.open(picture).size[0] > 100
