"""Trials judged from bags: by truth and odometry, converted, doubtful, incomplete."""

import copy
import math
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from foreign_bags import at_half_real_time, edited, in_namespace, messages_of, write_bag
from planners import recorded, spec_of
from refusals import refused

from barn_eval.results.folder import read_results
from barn_eval.running.judge import JudgeOptions, judge
from barn_eval.trials.protocol import CHALLENGE
from barn_eval.trials.result import Outcome
from barn_eval.verification.check import check_folder
from barn_worlds.base.errors import BagError, ConfigError

TRUTH = "/ground_truth/odom"
KEPT = "/odom /ground_truth/odom /tf /tf_static /collision /scan /cmd_vel /goal_pose"
KEPT = KEPT.split()
NEAR = "schema_version: 1\nbase: challenge\nname: near\ngoal_distance_m: 8.0\n"
CONVERSIONS = {
    "sqlite": {"format": "sqlite"},
    "ros1": {"format": "ros1"},
    "file": {"compression": "file"},
    "message": {"compression": "message"},
    "sqlite message": {"format": "sqlite", "compression": "message"},
}
CHANGES = {"half": at_half_real_time, "namespace": in_namespace}


@pytest.fixture(scope="module")
def nearer(tmp_path_factory):
    """The bag of a trial that goes on for a meter behind the goal of `near`."""
    folder = tmp_path_factory.mktemp("near")
    (folder / "near.yaml").write_text(NEAR)
    protocol = replace(CHALLENGE, name="far", goal_distance_m=7.0)
    recorded(spec_of(120, protocol), folder / "gap_w0120_r00")
    return folder / "gap_w0120_r00"


@pytest.fixture(scope="module")
def expected(nearer, tmp_path_factory):
    """The row of that trial by its odometry."""
    return judge_one(nearer, tmp_path_factory.mktemp("own"), protocol=near(nearer))


@pytest.fixture
def judge_changed(nearer, tmp_path):
    """A function that judges the bag after a change of its messages."""

    def judge_one_changed(change, name="gap_w0120_r00"):
        path = write_bag(tmp_path / name, messages_of(nearer, change))
        return judge_one(path, tmp_path / "out", protocol=near(nearer))

    return judge_one_changed


def near(bag):
    """The protocol by which a bag beside it is judged."""
    return str(bag.with_name("near.yaml"))


def kept(message):
    return message if message.topic in KEPT else None


def of_odometry(edit):
    """A change of a bag's messages, by `edit` of those on /odom."""
    return lambda m: edited(m, edit) if m.topic == "/odom" else kept(m)


def judge_one(path, out, **options):
    _, (row,) = judge([Path(path)], out, JudgeOptions(**options), overwrite=True)
    return row


def test_by_truth_a_row_is_that_of_the_run(collided, tmp_path):
    (own,) = read_results(collided)
    bag = collided / "bags" / own.trial_id
    row = judge_one(bag, tmp_path / "out", pose=TRUTH)
    assert (row.trial_id, row.outcome, row.detail) == (
        own.trial_id,
        own.outcome,
        own.detail,
    )
    assert row.measures == replace(own.measures, off_plan_m=None)
    assert replace(row.scores, least_time_s=None) == replace(
        own.scores, least_time_s=None, efficiency=None
    )
    assert (row.observed.clearance_by, row.observed.pose_source) == (
        "world",
        "/ground_truth/odom",
    )
    check = check_folder(tmp_path / "out")
    assert (check.problems, check.driven) == ([], 0)


def test_by_odometry_times_are_within_a_reading_and_clearance_is_by_scans(
    nearer, tmp_path, expected
):
    by_truth = judge_one(nearer, tmp_path, pose=TRUTH, protocol=near(nearer))
    assert expected.outcome is by_truth.outcome is Outcome.SUCCESS
    error_s = expected.scores.traversal_time_s - by_truth.scores.traversal_time_s
    # A period at each end, and a drift of 2% of 2 m at 0.5 m/s.
    assert abs(error_s) <= expected.observed.time_uncertainty_s == pytest.approx(0.15)
    assert expected.observed.clearance_by == "scans"
    assert expected.measures.min_clearance_m == pytest.approx(
        by_truth.measures.min_clearance_m, abs=0.02
    )
    assert (expected.scores.efficiency, expected.speed_cap_mps) == (None, None)


@pytest.mark.parametrize("kind", [*CONVERSIONS, *CHANGES, "backward"])
def test_the_same_bag_in_any_form_gives_the_same_row(nearer, tmp_path, kind):
    change = CHANGES.get(kind, lambda message: message)
    messages = [change(message) for message in messages_of(nearer, kept)]
    if kind == "backward":
        messages.reverse()
    path = tmp_path / "gap_w0120_r00"
    if kind == "ros1":
        path = path.with_suffix(".bag")
    write_bag(path, messages, **CONVERSIONS.get(kind, {}))
    # Its clock may be slower than that of the log; a robot's may not.
    options = {"protocol": near(nearer), "kind": "simulator"}
    own = judge_one(nearer, tmp_path / "own", **options).repeatable()
    assert judge_one(path, tmp_path / "out", **options).repeatable() == own


def test_parts_without_their_metadata_are_read(nearer, tmp_path, expected):
    write_bag(tmp_path / "bag", messages_of(nearer, kept), "sqlite")
    (database,) = (tmp_path / "bag").glob("*.db3")
    row = judge_one(database, tmp_path / "out", protocol=near(nearer), world="120")
    assert row.scores == expected.scores
    assert row.planner == "unknown"
    own = judge_one(tmp_path / "bag" / "metadata.yaml", tmp_path / "own", world="120")
    assert own.trial_id == row.trial_id


def test_tf_gives_the_row_of_the_odometry(nearer, tmp_path, expected):
    pose = "/tf:odom.base_link"
    row = judge_one(nearer, tmp_path / "out", protocol=near(nearer), pose=pose)
    assert row.scores == expected.scores
    assert row.observed.pose_source == pose


def test_odometry_that_begins_anywhere_is_judged_from_its_first_pose(
    judge_changed, expected
):
    readings = []

    def moved(content):
        readings.append(content)
        pose = content.pose.pose if hasattr(content, "twist") else content.pose
        position = pose.position
        x, y = position.x, position.y
        position.x, position.y = 3.2 - y, x - 7.5
        pose.orientation.z, pose.orientation.w = turned(pose.orientation)

    def turned(orientation):
        yaw = 2.0 * math.atan2(orientation.z, orientation.w) + math.pi / 2.0
        # One heading is noisy: the direction of the goal counts.
        yaw += 0.05 * (len(readings) < 3)
        return math.sin(yaw / 2.0), math.cos(yaw / 2.0)

    def change(message):
        is_pose = message.topic in ("/odom", "/goal_pose")
        return edited(message, moved) if is_pose else kept(message)

    row = judge_changed(change)
    assert row.scores == expected.scores
    assert row.remarks == ""


def test_without_a_world_what_needs_one_is_empty(judge_changed, expected, tmp_path):
    row = judge_changed(kept, "lab.mcap")
    assert row.scores.traversal_time_s == expected.scores.traversal_time_s
    scores = row.scores
    assert (scores.challenge, scores.path_length_m) == (None, None)
    assert scores.normalised_time_s_per_m is scores.optimal_time_s is None
    assert row.measures.min_clearance_m == expected.measures.min_clearance_m
    assert check_folder(tmp_path / "out").problems == []


def test_contacts_are_those_of_a_topic_an_operator_or_nobody(collided, tmp_path):
    bag = next((collided / "bags").iterdir())
    (own,) = read_results(collided)
    nobody = judge_one(bag, tmp_path / "none", pose=TRUTH, contact="none")
    assert nobody.outcome is Outcome.ENVIRONMENT_FAILED
    assert "contacts are unknown" in nobody.remarks
    assert nobody.measures.contacts is None
    operator = judge_one(
        bag,
        tmp_path / "operator",
        pose=TRUTH,
        contact="operator",
        contact_at=str(own.scores.duration_s),
    )
    assert operator.scores == replace(own.scores, least_time_s=None, efficiency=None)
    assert operator.observed.contact_source == "operator"


def test_each_goal_begins_a_trial(nearer, tmp_path):
    messages = messages_of(nearer, kept)
    (goal,) = [message for message in messages if message.topic == "/goal_pose"]

    def farther(content):
        content.pose.position.x += 20.0

    def later(content):
        content.header.stamp.sec += 100

    later_ns = messages[-1].stamp_ns // 3
    messages += [
        replace(edited(message, later), stamp_ns=message.stamp_ns + 10**11)
        for message in messages
        if message.topic in ("/odom", "/goal_pose")
    ]
    # Sent again on the way, a goal begins nothing.
    messages.append(replace(goal, stamp_ns=later_ns))
    messages.append(replace(edited(goal, farther), stamp_ns=later_ns * 2))
    messages.sort(key=lambda message: message.stamp_ns)
    path = write_bag(tmp_path / "lab", messages)
    _, rows = judge([path], tmp_path / "out", JudgeOptions(protocol=near(nearer)))
    assert [row.world for row in rows] == [0, 1, 2]
    assert "m from the goal, before a verdict" in rows[1].detail
    assert rows[2].outcome is Outcome.SUCCESS
    assert rows[2].observed.time_uncertainty_s < 1.0


def test_goals_that_cannot_be_judged_leave_the_others(nearer, tmp_path, caplog):
    messages = messages_of(nearer, kept)
    (goal,) = [message for message in messages if message.topic == "/goal_pose"]
    end_ns = messages[-1].stamp_ns

    def back(content):
        content.pose.position.x = content.pose.position.y = 0.1

    def elsewhere(content):
        content.header.frame_id = "elsewhere"

    def lose(content):
        content.pose.position.x = math.nan

    # In the order of the file, the later goal is the first.
    changes = {elsewhere: end_ns - 10**8, back: end_ns - 10**9, lose: 0}
    for change, stamp_ns in changes.items():
        messages.append(replace(edited(goal, change), stamp_ns=stamp_ns))
    messages.append(replace(goal, stamp_ns=end_ns + 1))
    messages.append(replace(goal, topic="/move_base/goal"))
    options = JudgeOptions(protocol=near(nearer))
    for name, count, notes in (
        (
            "gap_w0120_r00",
            2,
            ["gap_w0120_r01 is not judged: .*a drive back is no trial"],
        ),
        (
            "lab",
            1,
            [
                "_w0001_r00 is .*counts as arrival",
                "_w0002_r00 .*is in frame 'elsewhere'",
            ],
        ),
    ):
        path = write_bag(tmp_path / name, messages)
        _, rows = judge([path], tmp_path / f"out_{name}", options)
        assert len(rows) == count
        assert rows[0].outcome is Outcome.SUCCESS
        assert (
            rows[0].remarks
            == "goals on /move_base/goal are ignored; --goal selects them"
        )
        frames = "its goal is in frame 'elsewhere', but poses are in 'odom': --world or"
        assert frames in rows[-1].remarks or name == "lab"
        for words in (
            *notes,
            "/goal_pose: messages are ignored: values",
            "0_r03 is not judged: .*no poses between",
        ):
            assert re.search(words, caplog.text)


def test_what_is_doubtful_is_said_and_enters_the_uncertainty(judge_changed):
    def change(message):
        at_s = message.stamp_ns / 1e9
        if message.topic != "/odom":
            return kept(message)
        if 2.0 < at_s < 3.0:
            return edited(message, lost)
        return edited(message, back) if 3.1 < at_s < 3.3 else message

    def lost(content):
        content.pose.pose.position.x = math.nan

    def back(content):
        content.header.stamp.sec -= 2

    row = judge_changed(change)
    assert "no pose for 1.0" in row.remarks
    assert "wrong stamps: 3" in row.remarks
    assert 1.0 < row.observed.time_uncertainty_s < 1.5

    def twice(content):
        content.twist.twist.linear.x *= 2.0

    row = judge_changed(of_odometry(twice), "fast/gap_w0120_r00")
    assert "stamps may not be the robot's" in row.remarks
    assert row.observed.time_uncertainty_s > row.scores.duration_s / 2.0


def hop(content):
    content.pose.pose.position.x += 3.0 * (content.header.stamp.sec == 2)


def shrink(content):
    content.pose.pose.position.x *= 0.01
    content.pose.pose.position.y *= 0.01


@pytest.mark.parametrize(
    "change, words",
    [
        (of_odometry(hop), "poses jump by 3.0. m"),
        (of_odometry(shrink), "positions move 0.0. m, but the twist says"),
        (
            lambda m: None if m.topic == "/odom" and m.stamp_ns % 10**9 else kept(m),
            "no pose for 1.00 s",
        ),
    ],
)
def test_poses_that_jump_shrink_or_are_rare_are_doubtful(judge_changed, change, words):
    row = judge_changed(change)
    assert re.search(words, row.remarks)
    assert row.observed.time_uncertainty_s >= min(2.0, row.scores.duration_s)


def test_lidars_are_where_chains_of_transforms_say_and_see_no_part_of_the_robot(
    judge_changed, expected
):
    def change(message):
        if message.topic == "/scan":
            return edited(message, see_itself)
        return (
            edited(message, chain) if message.topic == "/tf_static" else kept(message)
        )

    def see_itself(content):
        content.range_min = 0.0
        content.ranges = content.ranges.copy()
        content.ranges[:20] = 0.12

    def chain(content):
        (lidar,) = (t for t in content.transforms if t.child_frame_id == "lidar_link")
        mast = copy.deepcopy(lidar)
        mast.child_frame_id = lidar.header.frame_id = "mast"
        lidar.transform.translation.x = 0.0
        content.transforms.append(mast)

    row = judge_changed(change)
    assert row.measures.min_clearance_m == expected.measures.min_clearance_m
    assert row.remarks == ""
    row = judge_changed(without("/tf_static"), "lost/gap_w0120_r00")
    assert "/tf_static lacks lidar_link, so a jackal's lidar is assumed" in row.remarks


def stamped(shift_s):
    """A change of the stamps of odometry, by a function of the time in s."""

    def change(message):
        def shift(content):
            stamp = content.header.stamp
            stamp_s = shift_s(message.stamp_ns / 1e9)
            shifted_ns = stamp.nanosec + round(1e9 * stamp_s)
            stamp.sec += shifted_ns // 10**9
            stamp.nanosec = shifted_ns % 10**9

        return edited(message, shift) if message.topic == "/odom" else kept(message)

    return change


@pytest.mark.parametrize(
    "shift_s, count",
    [
        (lambda at_s: 10**9 * (at_s == 3.0), 1),
        (lambda at_s: -3600 * (at_s == 3.0), 1),
        (lambda at_s: 3600 * (at_s == 0.0), 0),
        (lambda at_s: -3600 * (at_s < 0.2), 0),
        (lambda at_s: 5 * (3.0 < at_s < 3.4), 7),
        (lambda at_s: 7200 * (round(20 * at_s) % 7 == 3), 12),
    ],
)
def test_isolated_wrong_stamps_change_no_verdict(
    judge_changed, expected, shift_s, count
):
    row = judge_changed(stamped(shift_s))
    assert row.outcome is Outcome.SUCCESS
    error_s = row.scores.traversal_time_s - expected.scores.traversal_time_s
    assert abs(error_s) <= row.observed.time_uncertainty_s < 1.0
    assert f"wrong stamps: {count}" in row.remarks or not count


@pytest.mark.parametrize("shift_s", [-0.5, 0.9, 2])
def test_a_clock_set_a_little_makes_times_uncertain(judge_changed, expected, shift_s):
    row = judge_changed(stamped(lambda at_s: shift_s * (at_s >= 3.0)))
    error_s = abs(row.scores.traversal_time_s - expected.scores.traversal_time_s)
    assert error_s == pytest.approx(abs(shift_s), abs=0.1)
    assert error_s <= row.observed.time_uncertainty_s
    assert "wrong stamps" in row.remarks or "no pose for" in row.remarks


@pytest.mark.parametrize("shift_s", [10**9, 30, 5, -2, -3600])
def test_a_clock_that_is_set_leaves_no_verdict_but_an_earlier_one(
    judge_changed, expected, shift_s
):
    row = judge_changed(stamped(lambda at_s: shift_s * (at_s >= 3.0)))
    assert row.outcome is Outcome.ENVIRONMENT_FAILED
    assert f"jump by {shift_s + 0.05:+.2f} s: the clock was set" in row.detail
    end_s = expected.scores.duration_s
    row = judge_changed(
        stamped(lambda at_s: shift_s * (at_s > end_s)), "later/gap_w0120_r00"
    )
    assert row.scores == expected.scores


def test_a_clock_set_where_the_log_is_written_leaves_no_verdict(judge_changed):
    ahead = stamped(lambda at_s: 60 * (at_s >= 3.0))

    def change(message):
        message = ahead(message)
        if message and message.stamp_ns >= 3 * 10**9:
            return replace(message, stamp_ns=message.stamp_ns + 60 * 10**9)
        return message

    row = judge_changed(change)
    assert row.outcome is Outcome.ENVIRONMENT_FAILED
    assert "jump by +60.05 s: the clock was set" in row.detail


def test_a_log_without_stamps_gives_the_times(judge_changed, expected):
    def unstamped(content):
        content.header.stamp.sec = content.header.stamp.nanosec = 0

    row = judge_changed(of_odometry(unstamped))
    assert row.scores == expected.scores
    assert (row.observed.clock, expected.observed.clock) == ("log", "stamps")


def without(*names):
    return lambda message: message if message.topic not in names else None


def no_heading(content):
    content.pose.pose.orientation.z = content.pose.pose.orientation.w = 0.0


def rename(content):
    content.header.frame_id = "odom" if content.header.stamp.sec < 3 else "map"


def only_pose(message, name="/mocap"):
    return replace(message, topic=name) if message.topic == "/goal_pose" else None


@pytest.mark.parametrize(
    "change, options, words",
    [
        (
            without("/goal_pose"),
            {},
            "has no goal on /goal_pose .*one: none.; name a goal by --goal, ",
        ),
        (
            without("/odom", "/ground_truth/odom"),
            {},
            "no poses of a robot on /odom.*such as --pose /amcl_pose; it has",
        ),
        (only_pose, {}, "no poses of a robot.*such as --pose /mocap; it has /mocap"),
        (kept, {"pose": "/pose"}, "no topic /pose; it has /cmd"),
        (kept, {"namespace": "/r1"}, "no topic in namespace /r1; it has /cmd"),
        (kept, {"pose": "/tf:a.b"}, "on /tf:a.b .tf has .*odom to bas"),
        (
            kept,
            {"pose": "/tf:map.base_link"},
            "other frames are between: --pose /tf:map.odom.base_link",
        ),
        (kept, {"pose": "/scan"}, "no poses of a robot on /scan"),
        (kept, {"contact": "/scan"}, "/scan: must be a std_msgs/msg/Bool"),
        (
            lambda m: only_pose(m, "/r1/goal_pose") or m,
            {},
            "no goal on /goal_pose .topics that may have one: /r1/goal_pose.; name a",
        ),
        (of_odometry(rename), {}, "/odom: has poses in the frames 'odom' and 'map'"),
        (lambda m: replace(m, stamp_ns=7), {}, "all its poses were logged at 7 ns"),
        (of_odometry(no_heading), {}, "on /odom .none was sent, or none is finite"),
        (
            kept,
            {"world": "120", "frame": "world"},
            "begin .* m from the start of wor",
        ),
    ],
)
def test_what_is_missing_is_said_in_one_line(nearer, tmp_path, change, options, words):
    path = write_bag(tmp_path / "lab", messages_of(nearer, change))
    with refused(words, BagError, longest=1200):
        judge([path], tmp_path / "out", JudgeOptions(**options))
    assert not (tmp_path / "out").exists()


def test_bags_of_several_systems_need_folders_of_their_own(nearer, tmp_path):
    other = write_bag(tmp_path / "other", messages_of(nearer, without("/collision")))
    with refused("judge each system into its own folder", BagError):
        judge([nearer, other], tmp_path / "out")
    with refused("2 numbers for 1 bags", ConfigError):
        judge([nearer], tmp_path / "out", JudgeOptions(world="1,2"))


def test_the_command_prints_rows_and_what_is_to_be_known(nearer, tmp_path, command):
    line = (
        f"judge {nearer} --contact none --system lab --planner mine --out {tmp_path}/o"
    )
    code, out, err = command(line)
    assert code == 3
    assert "mine_w0120_r00: " in err and "environment_failed" in out
    assert "contacts are unknown" in err and "before a verdict" in err
    (row,) = (tmp_path / "o" / "results.jsonl").read_text().splitlines()
    assert '"system":"lab"' in row
    other = write_bag(tmp_path / "dwa_w0121_r00", messages_of(nearer, kept))
    line = f"judge {nearer} {other} --protocol {near(nearer)} --out {tmp_path}/two"
    code, out, _ = command(line)
    words = "planners cannot be compared: the two have no world and repetition"
    assert (code, words in " ".join(out.split())) == (0, True)


def test_a_bag_of_another_world_is_not_taken_for_one_of_the_suites(nearer, tmp_path):
    path = shutil.copytree(nearer, tmp_path / "gap_w0120_r00")
    with refused("was not recorded in world 121 of barn300; name its data", BagError):
        judge_one(path, tmp_path / "out", world="121")


def test_a_report_of_observed_trials_names_no_command(nearer, tmp_path, succeed):
    judge_one(nearer, tmp_path / "out", protocol=near(nearer), system="lab")
    succeed(f"report {tmp_path}/out --out {tmp_path}/page.html")
    page = (tmp_path / "page.html").read_text()
    assert "trials of lab were observed, not driven again" in page
    assert "observed in robot lab" in page and "barn run --dataset" not in page


NO_BAG = "cannot be read as a bag"


@pytest.mark.parametrize(
    "ending, fault",
    [("bag", NO_BAG), ("db3", NO_BAG), ("mcap.zstd", NO_BAG), ("mcap", "not an MCAP")],
)
def test_a_file_that_is_no_bag_is_named_in_one_line(tmp_path, ending, fault):
    path = tmp_path / f"garbage.{ending}"
    path.write_bytes(b"no bag at all, whatever its name says")
    with refused(f"{path}: {fault}", BagError):
        judge([path], tmp_path / "out")
    assert not (tmp_path / "out").exists()
