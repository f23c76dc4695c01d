"""The bring-up of Nav2 in examples/nav2: consistent with the simulator and with itself.

Whether Nav2 reads every parameter is what examples/nav2/check_parameters.py says, given
Nav2's source.
"""

import ast
import os
import re
import runpy
import shlex
import sys
from pathlib import Path

import click
import pytest
import yaml
from launch_files import constant
from repository import EXAMPLES
from text_tables import rows_of
from waiting import run_python

from barn_eval.commands import ab
from barn_eval.trials.protocol import PROTOCOLS
from barn_eval.trials.ros_config import WaitLimits
from barn_sim.config import PRESETS, SimulatorNodeConfig
from barn_worlds.messages.topics import FRAMES
from barn_worlds.robots.files import ROBOTS
from barn_worlds.ros.domain import reserve_domain

FOLDER = EXAMPLES / "nav2"
check_parameters = runpy.run_path(FOLDER / "check_parameters.py")["main"]
CONTROLLERS = ("dwb", "graceful", "mppi", "rpp")
# of the paper
SPEED_MPS = 0.5
TURN_RADPS = 1.57
# of each controller
SPEED_KEYS = "max_vel_x vx_max v_linear_max desired_linear_vel"
TURN_KEYS = "max_vel_theta wz_max v_angular_max rotate_to_heading_angular_vel"
README = (FOLDER / "README.md").read_text("utf-8")
COSTMAPS = ("local_costmap", "global_costmap")


def merge_nodes(*names):
    """Return the parameters of all nodes, as Nav2 gets them from several files."""
    nodes = {}
    for name in names:
        text = (FOLDER / f"params/{name}.yaml").read_text()
        for node, content in yaml.safe_load(text).items():
            nodes[node] = update_nested(
                nodes.get(node, {}), content.get(node, content)["ros__parameters"]
            )
    return nodes


def update_nested(before, values):
    return before | {
        k: update_nested(before.get(k, {}), v) if isinstance(v, dict) else v
        for k, v in values.items()
    }


def value_of(parameters, keys):
    """Return the value of the key that a controller has."""
    return next(parameters[key] for key in keys.split() if key in parameters)


def check_inflation(nodes):
    """Assert that the controller slows down by what the costmap inflates."""
    follow = nodes["controller_server"]["FollowPath"]
    layer = nodes["local_costmap"]["inflation_layer"]
    assert follow["inflation_cost_scaling_factor"] == layer["cost_scaling_factor"]
    assert follow["cost_scaling_dist"] <= layer["inflation_radius"]


@pytest.fixture(
    params=[(mode, name) for mode in ("map", "mapless") for name in CONTROLLERS],
    ids="_".join,
)
def nodes(request):
    return merge_nodes("common", *request.param) | {"mode": request.param[0]}


# Nodes and their lists of plugins.
PLUGINS = """
controller_server | controller_plugins
controller_server | goal_checker_plugins
controller_server | progress_checker_plugins
planner_server    | planner_plugins
behavior_server   | behavior_plugins
bt_navigator      | navigators
local_costmap     | plugins
global_costmap    | plugins
"""


def test_plugins_that_are_listed_are_configured(nodes):
    for node, key in rows_of(PLUGINS):
        assert nodes[node][key]
        for plugin in nodes[node][key]:
            assert "::" in nodes[node][plugin]["plugin"], (node, key)
    for costmap in COSTMAPS:
        layer = nodes[costmap]["obstacle_layer"]
        assert layer[layer["observation_sources"]]["topic"] == "/scan"
        assert nodes[costmap]["plugins"][-1] == "inflation_layer"


def test_frames_are_those_of_the_simulator(nodes):
    frames = SimulatorNodeConfig()
    planning = frames.map_frame if nodes["mode"] == "map" else frames.odom_frame
    assert nodes["local_costmap"]["global_frame"] == frames.odom_frame
    assert nodes["behavior_server"]["local_frame"] == frames.odom_frame
    assert nodes["collision_monitor"]["odom_frame_id"] == frames.odom_frame
    assert nodes["collision_monitor"]["base_frame_id"] == FRAMES.base
    for node in ("global_costmap", "behavior_server", "bt_navigator"):
        assert nodes[node]["global_frame"] == planning
        assert nodes[node]["robot_base_frame"] == FRAMES.base
    assert nodes["local_costmap"]["robot_base_frame"] == FRAMES.base
    assert ("static_layer" in nodes["global_costmap"]["plugins"]) == (
        nodes["mode"] == "map"
    )


def test_the_footprint_is_that_of_the_robot(nodes):
    jackal = ROBOTS["jackal"]
    corners = {
        (x * jackal.length_m / 2, y * jackal.width_m / 2)
        for x in (-1, 1)
        for y in (-1, 1)
    }
    for costmap in COSTMAPS:
        footprint = ast.literal_eval(nodes[costmap]["footprint"])
        assert {tuple(corner) for corner in footprint} == corners
        radius = (jackal.length_m**2 + jackal.width_m**2) ** 0.5 / 2
        assert nodes[costmap]["inflation_layer"]["inflation_radius"] > radius


CHOSEN = """required_movement_radius update_frequency width cost_scaling_factor
time_before_collision simulation_time_step min_points vx_min"""


@pytest.mark.parametrize("key", CHOSEN.split())
def test_a_value_that_differs_from_nav2_bringup_says_so(key):
    files = [FOLDER / f"params/{name}.yaml" for name in ("common", "mppi")]
    lines = re.findall(rf"\b{key}: .*", "".join(file.read_text() for file in files))
    assert lines and all("nav2_bringup has" in line for line in lines)


@pytest.mark.parametrize("mode", ["map", "mapless"])
@pytest.mark.parametrize("name", ["turtlebot4", "husky"])
def test_another_robot_has_its_own_size_and_limits(name, mode):
    chassis = ROBOTS[name].chassis
    drive = ROBOTS[name].drive
    nodes = merge_nodes("common", mode, "rpp", f"{name}_rpp")
    before = merge_nodes("common", mode, "rpp")
    outline = {(x, y) for x, y in chassis.footprint_m}
    scale = chassis.circumscribed_m / ROBOTS["jackal"].chassis.circumscribed_m
    for costmap in COSTMAPS:
        footprint = ast.literal_eval(nodes[costmap]["footprint"])
        assert {tuple(corner) for corner in footprint} == outline
        assert outline or nodes[costmap]["robot_radius"] == chassis.footprint_radius_m
        assert (
            nodes[costmap]["inflation_layer"]["inflation_radius"]
            > chassis.circumscribed_m
        )
    follow = nodes["controller_server"]["FollowPath"]
    speed = scale * SPEED_MPS
    for key, value in follow.items():
        if (
            key.endswith(("_dist", "_vel", "_speed", "_radius"))
            and "angular" not in key
            and "robot_pose" not in key
        ):
            default = before["controller_server"]["FollowPath"][key]
            assert isinstance(default, bool) or value == pytest.approx(
                scale * default, rel=0.04
            ), key
    smoother = nodes["velocity_smoother"]
    assert (
        smoother["max_velocity"][0]
        == follow["desired_linear_vel"]
        == pytest.approx(speed, rel=0.02)
    )
    assert smoother["max_velocity"][2] <= drive.max_yaw_rate_rad_s
    assert smoother["max_accel"][0] == drive.max_acceleration_m_s2
    assert smoother["max_accel"][2] <= drive.max_yaw_acceleration_rad_s2
    check_inflation(nodes)


@pytest.mark.parametrize(
    "mode, goal_m", [("mapless", 20.0), ("map", 10.0)]
)  # of DynaBARN, of the challenge
def test_goals_lie_within_the_global_costmap(mode, goal_m):
    # beyond the map as well, so that a costmap of the map's size would not do
    costmap = merge_nodes("common", mode)["global_costmap"]
    assert costmap["rolling_window"]
    assert min(costmap["width"], costmap["height"]) / 2 > goal_m + 1.0


def test_speeds_are_those_of_the_paper(nodes):
    follow = nodes["controller_server"]["FollowPath"]
    speed = value_of(follow, SPEED_KEYS)
    turn = value_of(follow, TURN_KEYS)
    assert speed == SPEED_MPS == nodes["velocity_smoother"]["max_velocity"][0]
    assert turn <= TURN_RADPS == nodes["velocity_smoother"]["max_velocity"][2]
    assert PRESETS["default"].drive.max_speed_m_s >= speed
    assert follow.get("critics", True)
    assert follow.get("model_dt", 0.05) * nodes["controller_server"][
        "controller_frequency"
    ] == pytest.approx(1.0)
    if "inflation_cost_scaling_factor" in follow:
        check_inflation(nodes)


def test_commands_pass_from_server_to_server_to_cmd_vel(nodes):
    servers = constant(FOLDER / "nav2.launch.py", "SERVERS")
    remapped = {name: remappings.get("cmd_vel") for _, name, remappings in servers}
    assert set(nodes) - {"mode", *COSTMAPS} == set(remapped)
    # the smoother hears what the controller and the behaviors send, the monitor what
    # the smoother sends
    assert (
        remapped["controller_server"]
        == remapped["behavior_server"]
        == remapped["velocity_smoother"]
        != "cmd_vel"
    )
    assert nodes["collision_monitor"]["cmd_vel_in_topic"] == "cmd_vel_smoothed"
    assert nodes["collision_monitor"]["cmd_vel_out_topic"] == "cmd_vel"


def test_a_nav2_that_works_is_not_taken_for_a_stalled_one(nodes):
    # a robot kept standing is told so for longer than the evaluator waits for a command
    assert nodes["collision_monitor"]["stop_pub_timeout"] > WaitLimits().command_s
    # a tree whose servers do not answer in time gives up what it has begun: 20 ms is
    # too short for a busy machine
    assert nodes["bt_navigator"]["default_server_timeout"] >= 1000


def test_a_nav2_that_has_given_up_may_stand_until_the_end():
    commands = re.findall(r"barn run .*nav2\.launch\.py.*", README)
    assert len(commands) == 3
    for command in commands:
        assert float(re.search(r"patience\.command_s=(\d+)", command)[1]) > max(
            PROTOCOLS[name].limit_s for name in re.findall(r"--protocol (\w+)", command)
        )


def test_the_workflow_for_a_pull_request_calls_what_exists():
    text = (FOLDER / "compare_builds.yaml").read_text()
    (branch,) = re.findall(r"branches: \[(\w+)\]", text)
    workflow = yaml.safe_load(text)
    assert workflow["jobs"]["compare"]["container"].startswith(f"ros:{branch}-")
    steps = workflow["jobs"]["compare"]["steps"]
    named = re.findall(
        r"\bbarn/(examples/\S+)", " ".join(step.get("run", "") for step in steps)
    )
    assert set(named) == {"examples/nav2/lockstep", "examples/nav2/params"}
    assert all((FOLDER.parents[1] / name).exists() for name in named)
    controller = workflow["env"]["CONTROLLER"]
    assert (FOLDER / f"params/{controller}.yaml").is_file()
    script = steps[-2]["run"].replace("\\\n", " ")
    (call,) = re.findall(r"barn ab (.*?) \|", script)
    values, *_ = ab.command.make_parser(click.Context(ab.command)).parse_args(
        shlex.split(call)
    )
    assert (values["base"], values["head"]) == (
        "install_base/setup.bash",
        "install_head/setup.bash",
    )


@pytest.mark.parametrize("name", ["controllers", "fast"])
def test_a_campaign_declares_the_speed_each_controller_keeps(name):
    text = (FOLDER / f"lockstep/{name}.yaml").read_text()
    for planner in yaml.safe_load(text)["planners"]:
        files = [
            Path(word)
            for word in shlex.split(planner["command"])
            if "examples/" in word
        ]
        assert all((FOLDER.parents[1] / file).is_file() for file in files)
        nodes = merge_nodes(*(file.stem for file in files[1:]))
        follow = nodes["controller_server"]["FollowPath"]
        follow |= {
            key: float(value)
            for key, value in re.findall(
                r"FollowPath\.(\w+):=([\d.]+)", planner["command"]
            )
        }
        speed = value_of(follow, SPEED_KEYS)
        assert 0.99 <= speed / planner["max_speed_mps"] <= 1.0


def test_the_documented_protocols_of_nav2_send_the_goal_once():
    protocols = set(re.findall(r"--protocol (\w+)", README))
    assert protocols == {"challenge", "known_map"}
    assert {PROTOCOLS[name].goal_period_s for name in protocols} == {0.0}
    assert {name: PROTOCOLS[name].map_given for name in protocols} == {
        "challenge": False,
        "known_map": True,
    }


def test_the_check_against_the_source_finds_what_is_misspelt(tmp_path, capsys):
    source = tmp_path / "navigation2"
    other = tmp_path / "other"
    mine = tmp_path / "mine.yaml"
    arguments = [str(source), str(other), str(mine)]
    for place, read in (
        (source / "nav2_controller", "controller_frequency"),
        (other, "prefix.gain"),
    ):
        place.mkdir(parents=True)
        (place / "server.cpp").write_text(f'declare_parameter("{read}", 20.0);')
        (place / "plugins.xml").write_text(
            f'<class type="{place.name}::Checker" base_class_type="x"/>'
        )
    (other / "package.xml").touch()
    text = "controller_server: {ros__parameters: {%s: 20.0, a: {plugin: 'nav2_controller::%s'}, b: {%s}}}"
    plugin = "plugin: 'other::Checker', gain: 1.0, %s: 2.0"
    mine.write_text(text % ("controller_frequency", "Checker", plugin % "use_sim_time"))
    assert check_parameters(arguments) == 0
    mine.write_text(text % ("controler_frequency", "Chequer", plugin % "gian"))
    assert check_parameters(arguments) == 1
    output = capsys.readouterr().out
    assert "controler_frequency is not read by nav2_controller" in output
    assert "b.gian is not read by other" in output
    assert (
        "no plugin nav2_controller::Chequer" in output
        and "5 parameters checked, 3 wrong" in output
    )
    expected = tmp_path / "expected.txt"
    failures = [line for line in output.splitlines() if line.startswith("mine.yaml")]
    arguments += [str(expected)]
    for lines, code in ((failures, 0), (failures[1:], 1), ([*failures, "x"], 1)):
        expected.write_text("\n".join(lines))
        assert check_parameters(arguments) == code


SERVER = """
declare_parameter("controller_frequency", 20.0);
declare_parameter("controller_plugins", default_ids_);
get_parameter("controller_frequency", controller_frequency_);
if (node->has_parameter("old_name")) {
  throw std::runtime_error("'old_name' must be removed");
}
"""
PLUGIN = """
nav2_util::declare_parameter_if_not_declared(
  node, name + ".tolerance", rclcpp::ParameterValue(0.25));
getParam(samples_, "samples", 20);
getParam(is_on_, "enabled", true);
node->declare_parameter(name + ".frame", std::string("map"));
node->declare_parameter(name + ".open", open_default);
"""


# Key, value and problem.
VALUES = """
controller_frequency | 20 | is 20, of type int;
controller_frequency | 20.0 |
controller_plugins | FollowPath | declares list
controller_plugins | [a, b] | names b, which has no section
tolerance | 0.5 | below a plugin, not here
old_name | 1 | is refused
a.tolerance | 1 | declares double
a.samples | 20.0 | declares int
a.samples | 30 |
a.enabled | 1 | declares bool
a.frame | 3 | declares string
a.frame | odom |
a.open | 3 |
"""


@pytest.mark.parametrize("key, value, problem", rows_of(VALUES))
def test_the_check_knows_types_and_places(tmp_path, capsys, key, value, problem):
    package = tmp_path / "navigation2/nav2_controller"
    package.mkdir(parents=True)
    (package / "server.cpp").write_text(SERVER + PLUGIN)
    (package / "plugins.xml").write_text('<class type="x::A" base_class_type="y"/>')
    section, _, name = key.rpartition(".")
    plugin = {"plugin": "x::A"}
    parameters = {"a": plugin}
    (parameters[section] if section else parameters)[name] = yaml.safe_load(value)
    mine = tmp_path / "mine.yaml"
    content = {"controller_server": {"ros__parameters": parameters}}
    mine.write_text(yaml.safe_dump(content))
    assert check_parameters([str(package.parent), str(mine)]) == (1 if problem else 0)
    output = capsys.readouterr().out
    assert problem in output
    assert f"2 parameters checked, {1 if problem else 0} wrong" in output


def test_what_is_expected_of_the_parameters_is_of_files_that_exist():
    lists = sorted(FOLDER.glob("expected_failures*.txt"))
    assert len(lists) == 3
    # Since Nav2 1.4, bt_navigator refuses it.
    assert "error_code_names" not in merge_nodes("common")["bt_navigator"]
    for path in lists:
        for line in path.read_text().splitlines():
            assert (FOLDER / "params" / line.partition(":")[0]).is_file()


def test_lyrical_follows_the_path_as_the_controllers_say():
    handler = merge_nodes("lyrical")["controller_server"]["PathHandler"]
    for name, key in (
        ("mppi", "prune_distance"),
        ("rpp", "max_robot_pose_search_dist"),
    ):
        follow = merge_nodes(name)["controller_server"]["FollowPath"]
        assert handler[key] == follow[key]


def test_each_trial_gets_a_fresh_nav2(with_extra_messages):
    """The node nav2_trial with stand-ins for lifecycle manager and navigator.

    They run in another process.
    """
    script = Path(__file__).with_name("nav2_stand_in.py")
    with reserve_domain({}) as domain:
        environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        }
        environment["PYTHONPATH"] = os.pathsep.join(
            filter(None, [os.environ.get("PYTHONPATH"), *sys.path])
        )
        node = FOLDER / "trial_node.py"
        done = run_python(script, node, env=environment, timeout=600)
    assert done.stdout.splitlines() == [
        "False Nav2 is being brought up",
        "False Nav2 has taken no goal yet",
        "False Nav2 has no plan yet",
        "True ",
        *("RESET", "STARTUP", "False Nav2 has taken no goal yet") * 3,
        "RESET",
        "STARTUP",
        "False Nav2 has no plan yet",
        "RESET",
        "False lifecycle_manager_navigation could not do RESET",
        "False lifecycle_manager_navigation could not do RESET",
        "ended with 0 False",
    ], done.stderr
