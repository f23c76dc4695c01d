"""The learning environment.

What Gymnasium and Stable-Baselines3 ask of one, and that its episodes are trials.
"""

import copy
import hashlib
import json
import pickle
import re
import warnings
from dataclasses import asdict, replace
from itertools import chain, cycle, islice, repeat

import numpy as np
import pytest
import yaml
from refusals import refused

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env  # noqa: E402
from PIL import ImageColor  # noqa: E402
from text_tables import answers_of  # noqa: E402
from waiting import run_python  # noqa: E402

import barn_eval.gym  # noqa: E402, F401
from barn_eval.learning.config import EnvConfig, RewardConfig  # noqa: E402
from barn_eval.learning.environment import JackalEnv  # noqa: E402
from barn_eval.learning.reward import (  # noqa: E402
    final_reward,
    measure_distances_left,
    path_points,
    reward_steps,
    reward_weights,
)
from barn_eval.running.direct import run_direct_trial  # noqa: E402
from barn_eval.trials.protocol import CHALLENGE, KNOWN_MAP, PAPER_2020  # noqa: E402
from barn_eval.trials.result import Outcome, Verdict  # noqa: E402
from barn_eval.trials.run_config import PlannerChoice, RunConfig  # noqa: E402
from barn_eval.trials.spec import simulator_config  # noqa: E402
from barn_planners.policy.collision_check import CollisionCheckConfig  # noqa: E402
from barn_planners.policy.file import (  # noqa: E402
    METADATA_KEY,
    Policy,
    PolicyNetwork,
    load_network,
    write_policy,
)
from barn_planners.policy.space import PolicyAction, PolicyObservation  # noqa: E402
from barn_worlds.base.config import as_dict  # noqa: E402
from barn_worlds.base.errors import BarnError  # noqa: E402
from barn_worlds.drawing import palette  # noqa: E402

# Of -0.5 to 2 m/s.
FORWARD, STILL, NO_NUMBER = np.array(
    [[0.2, 0.0], [-0.6, 0.0], [np.nan, 0.0]], np.float32
)

SHIELDED = EnvConfig(worlds="150", safety=CollisionCheckConfig())
MOTION_LIMIT_S = CHALLENGE.first_motion_limit_s


@pytest.fixture
def make(request):
    """Make environments that are closed after the test."""

    def make_one(**changes):
        env = JackalEnv(**changes)
        request.addfinalizer(env.close)
        return env

    return make_one


@pytest.mark.parametrize(
    "changes", [{}, {"observation.beams": 40}, {"protocol": "paper2020"}]
)
def test_gymnasium_finds_nothing_to_say_against_it(changes):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make("barn/Jackal-v0", **changes)
        assert isinstance(env.unwrapped, JackalEnv)
        check_env(env.unwrapped)
    env.close()


def test_stable_baselines_finds_nothing_to_say_against_it(make):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checker.check_env(make(), warn=True)
        checker.check_env(
            make(render_mode="rgb_array"), warn=True, skip_render_check=False
        )


def test_it_can_be_made_by_the_name_of_its_module_alone():
    code = (
        "import gymnasium; env = gymnasium.make('barn_eval.gym:barn/Jackal-v0'); print(env.reset(seed=1)[0].shape)"
        "; import barn_eval.gym, importlib; importlib.reload(barn_eval.gym)"
    )
    ended = run_python("-W", "error", "-c", code)
    assert ended.stdout.strip() == "(725,)" and not ended.stderr


def drive(env, seed, count=40):
    digest = hashlib.sha256(env.reset(seed=seed)[0].tobytes())
    for k in range(count):
        observation, *rest = env.step(np.array([0.1, np.sin(0.3 * k)], np.float32))
        digest.update(observation.tobytes() + repr(rest).encode())
    return digest.hexdigest()


def test_an_environment_used_before_repeats_a_new_one(make):
    env = make(worlds="0:60")
    other = make(worlds="0:60")
    first = drive(env, 4)
    assert drive(env, 5) != first
    assert drive(env, 4) == first == drive(other, 4)


def steering_policy():
    """Return a policy that turns to the goal and away from the nearer side.

    It does not get through every world.
    """
    observation = PolicyObservation(beams=8)
    action = PolicyAction(0.0, 1.0, 1.5)
    weights = np.zeros((observation.size, 2), np.float32)
    weights[1:4, 1] = -0.8
    weights[4:7, 1] = 0.8
    weights[10, 1] = 1.0
    weights[3:5, 0] = 0.7
    return Policy(observation, action, (weights,), (np.array([-0.3, 0.0], np.float32),))


def with_memory(policy):
    """Return the policy with further frames, which it ignores, and held actions."""
    observation = replace(policy.observation, frames=3, frame_steps=2)
    (weights,) = policy.weights
    padded = np.zeros((observation.size, 2), np.float32)
    padded[: len(weights)] = weights
    # What was seen four steps before turns it as well.
    padded[-policy.observation.size + 3, 1] = 0.2
    action = replace(policy.action, repeat=3)
    return replace(policy, observation=observation, action=action, weights=(padded,))


with_and_without_shield = pytest.mark.parametrize(
    "shield", [False, True], ids=["raw", "shielded"]
)


@pytest.mark.parametrize("memory", [False, True], ids=["frame", "frames"])
@with_and_without_shield
@pytest.mark.parametrize(
    "protocol", [CHALLENGE, KNOWN_MAP, PAPER_2020], ids=lambda make_one: make_one.name
)
def test_an_episode_is_the_trial_of_the_benchmark(
    make, tmp_path, protocol, shield, memory
):
    policy = steering_policy()
    if memory:
        policy = with_memory(policy)
    world = 12
    write_policy(tmp_path / "policy.npz", policy)
    spaces = {"observation": policy.observation, "action": policy.action}
    safety = CollisionCheckConfig(enabled=shield)
    env = make(config=EnvConfig(protocol=protocol.name, safety=safety, **spaces))
    settings = {"policy_path": str(tmp_path / "policy.npz"), "safety.enabled": shield}
    planners = (PlannerChoice("policy", overrides=settings),)
    rules = {"protocol": protocol, "simulator": simulator_config(protocol)}
    experiment = RunConfig(planners=planners, repetitions=2, seed=3, **rules)
    finished = run_direct_trial(experiment.trials([world])[1])
    network = PolicyNetwork(policy)
    trial = {"world": world, "campaign_seed": 3, "repetition": 1}
    observation, info = env.reset(options=trial)
    truths = env._episodes.readings.truths
    poses = [truths[0].copy()]
    ended = False
    while not ended:
        observation, _, terminated, truncated, info = env.step(network.act(observation))
        poses.append(truths[0].copy())
        ended = terminated or truncated
    expected = finished.trajectory.truth
    stride = policy.action.repeat
    np.testing.assert_array_equal(expected[:-1:stride], poses[:-1])
    np.testing.assert_array_equal(expected[-1], poses[-1])
    assert info["outcome"] == finished.result.outcome.value
    scores = asdict(finished.result.scores)
    if not scores["success"]:
        scores["least_time_s"] = None
    assert info["scores"] == scores


def write_onnx(path, policy):
    """Write a linear policy as an ONNX file whose state adds up what it turned to."""
    onnx = pytest.importorskip("onnx", reason="onnx is not installed")
    pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
    helper = onnx.helper
    to_node = onnx.numpy_helper.from_array

    def tensor(name, size):
        return helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, (1, size))

    graph = helper.make_graph(
        [
            helper.make_node("Gemm", ["observation", "weights", "biases"], ["now"]),
            helper.make_node("Mul", ["state", "share"], ["kept"]),
            helper.make_node("Add", ["now", "kept"], ["action"]),
            helper.make_node("Identity", ["action"], ["next"]),
        ],
        "policy",
        [tensor("observation", policy.observation.size), tensor("state", 2)],
        [tensor("action", 2), tensor("next", 2)],
        [
            to_node(policy.weights[0], "weights"),
            to_node(policy.biases[0], "biases"),
            to_node(np.array([0.0, 0.1], np.float32), "share"),
        ],
    )
    model = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9
    )
    entry = model.metadata_props.add()
    entry.key = METADATA_KEY
    spaces = {
        "observation": as_dict(policy.observation),
        "action": as_dict(policy.action),
    }
    entry.value = json.dumps(spaces)
    path.write_bytes(model.SerializeToString())


def test_a_recurrent_policy_drives_the_same_trial_as_a_planner(make, tmp_path):
    policy = with_memory(steering_policy())
    path = tmp_path / "policy.onnx"
    write_onnx(path, policy)
    settings = {"policy_path": str(path), "safety.enabled": False}
    run = RunConfig(
        planners=(PlannerChoice("policy", overrides=settings),),
        protocol=CHALLENGE,
        simulator=simulator_config(CHALLENGE),
    )
    result = run_direct_trial(run.trials([12])[0]).result
    assert result.wall_clock.compute_p50_ms > 0.0
    network = load_network(path)
    env = make(config=EnvConfig(observation=policy.observation, action=policy.action))
    observation, info = env.reset(options={"world": 12, "campaign_seed": 0})
    while "outcome" not in info:
        observation, *_, info = env.step(network.act(observation))
    assert info["outcome"] == result.outcome.value
    assert info["scores"]["duration_s"] == result.scores.duration_s


def run_out(env, actions):
    """Return the rewards of an episode, whether it ended by itself and by time, and what
    is known at its end.
    """
    rewards = []
    for action in islice(actions, 4000):
        _, reward, *ended, info = env.step(action)
        rewards.append(reward)
        if any(ended):
            return rewards, ended, info
    raise AssertionError("the episode does not end")


@pytest.mark.parametrize(
    "action, ends, outcome, detail, time_s",
    [
        (FORWARD, [True, False], "collision", "contact", pytest.approx(3.5, abs=0.5)),
        (STILL, [False, True], "no_first_motion", "moved less", MOTION_LIMIT_S),
        (NO_NUMBER, [True, False], "invalid_command", "is not finite", 0.0),
    ],
    ids=["a collision terminates", "time truncates", "what is not a number terminates"],
)
def test_a_failure_ends_an_episode(make, action, ends, outcome, detail, time_s):
    env = make(worlds="150")
    env.reset(seed=0)
    rewards, ended, info = run_out(env, repeat(action))
    assert ended == ends
    assert (info["outcome"], info["is_success"]) == (outcome, False)
    assert info["time_s"] == time_s
    assert rewards[-1] < -9.0
    assert info["scores"]["challenge"] == 0.0
    assert detail in info["detail"]
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(action)
    env.reset()
    env.step(action)


def test_an_action_of_another_shape_is_told(make):
    env = make()
    env.reset(seed=0)
    with refused(r"action must be an array of shape \(2,\), got \(3,\)", BarnError):
        env.step(np.zeros(3))


@pytest.mark.parametrize("along", ["straight", "path"])
def test_a_success_terminates_and_the_progress_adds_up(make, open_dataset_file, along):
    reward = RewardConfig(
        discount=1.0,
        per_second=0.0,
        near_per_second=0.0,
        progress_per_m=2.0,
        progress_along=along,
    )
    env = make(config=EnvConfig(dataset=open_dataset_file, reward=reward))
    _, info = env.reset(seed=0)
    before_m = info["way_left_m"]
    rewards, ended, info = run_out(env, repeat(FORWARD))
    assert ended == [True, False]
    assert (info["outcome"], info["is_success"]) == ("success", True)
    assert info["scores"]["challenge"] == 0.5
    progress_m = before_m - info["way_left_m"]
    assert sum(rewards) == pytest.approx(2.0 * progress_m + reward.success)


def test_the_reward_of_a_step():
    config = RewardConfig(
        discount=0.9,
        progress_per_m=2.0,
        shielded_limit=0.06,
        collision=-20.0,
        out_of_time=-5.0,
    )
    after_m = np.array([1.0, 1.0, 1.0, 3.5])
    before_m = after_m + [0.05, -0.05, 0.05, 0.1]
    start_m = np.full(4, 3.0)
    nearest_m = np.array([[5.0, 5.0], [4.0, 0.3], [5.0, 5.0], [5.0, 5.0]], np.float32)
    changed_s = np.array([0.0, 0.0, 0.05, 0.05])
    shielded = np.array([0.0, 0.0, 0.04, 0.0])
    rewards = np.zeros(4)
    reward_steps(
        reward_weights(config),
        start_m,
        before_m,
        after_m,
        np.full(4, 0.05),
        changed_s,
        nearest_m / 5.0,
        5.0,
        shielded,
        rewards,
    )
    nearer = 2.0 * (0.9 * 2.0 - 1.95) - 0.005
    back = 2.0 * (0.9 * 2.0 - 2.05) - 0.005 - 0.0125
    # The check costs no more than is left to its limit; behind the start there is no
    # progress to lose.
    assert rewards == pytest.approx([nearer, back, nearer - 0.02, -0.005 - 0.05])
    assert shielded == pytest.approx([0.0, 0.0, 0.06, 0.05])
    for outcome, extra in (
        (Outcome.SUCCESS, 10.0),
        (Outcome.COLLISION, -20.0),
        (Outcome.TIMEOUT, -5.0),
    ):
        assert final_reward(config, Verdict(outcome, "", 1.0, 1.0, 0.0)) == extra


@with_and_without_shield
@pytest.mark.parametrize("discount", [0.99, 1.0])
def test_driving_earns_more_than_getting_nowhere(
    make, open_dataset_file, shield, discount
):
    changes = {
        "action.repeat": 4,
        "reward.discount": discount,
        "safety.enabled": shield,
    }
    env = make(dataset=open_dataset_file, **changes)
    # Of -0.5 to 2 m/s, and shares of 2 rad/s. Standing ends with the time for a motion.
    ways = {
        "drive": repeat(FORWARD),
        "stand": repeat(STILL),
        "circle": repeat(np.array([-0.2, 0.5])),
        "shuttle": cycle([np.zeros(2)] * 10 + [np.array([-1.0, 0.0])] * 15),
        "back": chain([np.array([-0.65, 0.0])] * 5, repeat(STILL)),
    }
    returns = {}
    for name, actions in ways.items():
        env.reset(seed=0)
        rewards, _, info = run_out(env, actions)
        assert info["outcome"] != "collision", name
        powers = discount ** np.arange(len(rewards))
        returns[name] = (sum(rewards), float(np.dot(powers, rewards)))
    for name in ways.keys() - {"drive"}:
        assert returns["drive"][0] > returns[name][0] + 5.0, name
        assert returns["drive"][1] > returns[name][1] + 1.0, name


def test_a_check_that_always_works_costs_no_more_than_its_limit(make):
    free = replace(SHIELDED, reward=RewardConfig(shielded_per_second=0.0))
    sums = []
    for one in (SHIELDED, free):
        env = make(config=one)
        env.reset(seed=0)
        sums.append(sum(env.step(FORWARD)[1] for _ in range(400)))
    assert sums[1] - sums[0] == pytest.approx(RewardConfig().shielded_limit)


def test_a_shield_keeps_from_a_collision_and_costs(make):
    env = make(config=SHIELDED)
    env.reset(seed=0)
    rewards = [env.step(FORWARD)[1] for _ in range(150)]
    assert env._episodes.running[0]
    assert min(rewards) < -0.04 and rewards[0] > -0.03


def test_the_remaining_path_starts_at_the_nearest_point():
    rng = np.random.default_rng(0)
    points = rng.integers(0, 5, (200, 30, 3)) * 0.15
    positions = rng.integers(0, 5, (200, 2)) * 0.15
    left_m = np.zeros(200)
    positions[::2] += rng.normal(size=(100, 2))
    offsets = points[:, :, :2] - positions[:, None]
    away = np.hypot(*offsets.transpose(2, 0, 1))
    nearest = away[:, :20].argmin(axis=1)
    rows = np.arange(200)
    measure_distances_left(points, np.full(200, 20), positions, rows, left_m)
    expected = (away + points[:, :, 2])[rows, nearest]
    np.testing.assert_array_equal(left_m, expected)


def test_the_way_left_leads_along_the_path(make):
    env = make(worlds="150")
    env.reset(seed=0)
    spec = env._episodes.trial(0).spec
    path = spec.world.path_m()
    goal = spec.course.goal
    start = spec.course.start

    def meters(along, *places):
        points = path_points(spec.world, spec.course, along)[None]
        counts = np.array([len(points[0])])
        left_m = np.zeros(1)
        for place in places:
            position = np.array([place])
            measure_distances_left(points, counts, position, np.arange(1), left_m)
            yield left_m[0]

    from_the_last = float(np.hypot(*(path[-1] - goal.position)))
    expected = [0.0, from_the_last, spec.world.path_length_m + from_the_last]
    lengths = list(meters("path", goal.position, path[-1], path[0]))
    assert lengths == pytest.approx(expected)
    (straight,) = meters("straight", start.position)
    assert straight == pytest.approx(start.distance(goal))
    assert next(meters("path", start.position)) > straight


def test_worlds_are_drawn_from_those_chosen(make):
    env = make(worlds="149-160")
    worlds = {env.reset(seed=seed)[1]["world"] for seed in range(40)}
    assert len(worlds) > 5 and worlds <= set(range(149, 161))


def test_a_picture_shows_the_robot_on_its_way(make):
    env = make(render_mode="rgb_array", worlds="150")
    assert env.render() is None
    env.reset(seed=0)
    first = env.render()
    assert first.dtype == np.uint8 and first.ndim == 3 and first.shape[2] == 3
    # the robot is some 550 pixels large
    of_robot = (first == ImageColor.getrgb(palette.ROBOT)).all(axis=2)
    assert of_robot.sum() > 300
    for _ in range(15):
        env.step(FORWARD)
    later = env.render()
    changed = np.argwhere((first != later).any(axis=2))
    assert len(changed) > 100
    assert make(worlds="150").render() is None


@pytest.mark.parametrize(
    "worlds, numbers",
    [
        (5, (5,)),
        ([7, 3], (3, 7)),
        (range(10, 13), (10, 11, 12)),
        (np.arange(2), (0, 1)),
    ],
)
def test_worlds_may_be_numbers(make, worlds, numbers):
    assert make(worlds=worlds).worlds == numbers


def test_parts_of_the_configuration_may_be_objects():
    env = gymnasium.make(
        "barn/Jackal-v0",
        observation=PolicyObservation(beams=12, frames=2),
        **{"action.repeat": 2},
    )
    assert env.observation_space.shape == (34,)
    assert env.unwrapped.config.action.repeat == 2
    env.close()
    with refused("action", BarnError):
        JackalEnv(action=PolicyObservation())


def test_wrappers_that_try_an_argument_get_a_type_error():
    # TorchRL's GymEnv does that, and goes on without the argument.
    with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'"):
        gymnasium.make("barn/Jackal-v0", frameskip=4)


def test_a_copy_repeats_the_original_and_none_is_made_of_a_running_one(make):
    env = make(worlds="0:60")
    copies = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    expected = drive(env, 4)
    for other in copies:
        assert drive(other, 4) == expected
        other.close()
    for duplicate in (copy.deepcopy, pickle.dumps):
        with refused("an environment cannot be copied after", BarnError):
            duplicate(env)
    batch = gymnasium.make_vec("barn/Jackal-v0", 2, "vector_entry_point")
    with refused("a batch of environments cannot be copied", BarnError):
        copy.deepcopy(batch)
    batch.close()


MISTAKES = """
{beams: 40}
    unexpected keyword argument 'beams'
{worldz: 40}
    did you mean 'worlds'
{worlds: [1, 2.5]}
    environment: worlds
{worlds: true}
    environment: worlds
{observation.beans: 40}
    did you mean 'observation.beams'
{observation.beams: 0}
    beams must be from 1
{worlds: '500'}
    no world 500
{reward.progress_along: paht}
    did you mean 'path'
{protocol: papper}
    did you mean 'paper2020'
{simulator: {obstacles.movable: true}}
    is set by protocol
{safety.lidar_x_m: 0.3}
    safety.lidar_x_m is 0.3, but the lidar is mounted at 0.055 m
{simulator: {lidar.beans: 3}}
    unknown parameter 'lidar.beans'
{render_mode: human}
    render_mode must be None or 'rgb_array'
"""


@pytest.mark.parametrize("changes, message", answers_of(MISTAKES))
def test_a_mistake_is_told_in_one_line(changes, message):
    with refused(re.escape(message), BarnError):
        JackalEnv(**yaml.safe_load(changes))


@pytest.mark.parametrize(
    "option", ["wordl: 3", "world: 3.5", "world: -1", "world: 5000", "repetition: true"]
)
def test_a_wrong_option_of_a_reset_is_told(make, option):
    with refused(r"reset: |no world", BarnError):
        make().reset(options=yaml.safe_load(option))


def test_a_lidar_that_sees_too_little_is_told(make):
    env = make(simulator={"lidar.angle_min_rad": -1.0, "lidar.angle_max_rad": 1.0})
    with refused("the scan covers only", BarnError):
        env.reset(seed=0)


def test_without_gymnasium_one_line_says_what_to_install():
    code = "import sys; sys.modules['gymnasium'] = None\nimport json\nfrom barn_worlds.base.errors import BarnError\n"
    code += "try:\n    import barn_eval.gym\nexcept BarnError as error:\n    print(json.dumps(str(error)))"
    ended = run_python("-c", code)
    assert "pip install gymnasium" in json.loads(ended.stdout)
