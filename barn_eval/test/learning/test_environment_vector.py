"""The batched environment against the same environments one by one, to the last bit."""

import numpy as np
import pytest
import yaml
from refusals import refused

from barn_worlds.base.errors import BarnError

gymnasium = pytest.importorskip("gymnasium", reason="Gymnasium is not installed")

from gymnasium.utils.env_checker import data_equivalence  # noqa: E402

import barn_eval.gym  # noqa: E402
from barn_sim.contact.scene import ScenePool  # noqa: E402

NAME = barn_eval.gym.ENVIRONMENT_ID
SHORT = {"simulator": {"lidar.beams": 90}, "observation.beams": 90}
COUNT = 5


@pytest.fixture
def pair(request):
    """Make a batch of environments and the same ones in Gymnasium's own vector
    environment.
    """

    def make(autoreset="NextStep", **changes):
        batch = gymnasium.make_vec(
            NAME, COUNT, "vector_entry_point", autoreset_mode=autoreset, **changes
        )
        other = gymnasium.make_vec(
            NAME, COUNT, "sync", vector_kwargs={"autoreset_mode": autoreset}, **changes
        )
        request.addfinalizer(batch.close)
        request.addfinalizer(other.close)
        return batch, other

    return make


def drive(pair, steps, actions):
    """Drive both alike and compare all they return.

    Return all outcomes and how often an environment began anew.
    """
    batch, other = pair
    (observation, info), (single_observation, info_too) = (
        batch.reset(seed=3),
        other.reset(seed=3),
    )
    assert data_equivalence(
        (observation, info), (single_observation, info_too), exact=True
    )
    outcomes = []
    for step in range(steps):
        results = batch.step(actions[step])
        expected = other.step(actions[step])
        assert data_equivalence(results, expected, exact=True), step
        infos = results[4].get("final_info", results[4])
        outcomes += [name for name in infos.get("outcome", ()) if name]
    return outcomes


def forward(steps, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform([0.0, -0.6], [0.6, 0.6], (steps, COUNT, 2)).astype(np.float32)


@pytest.mark.parametrize("autoreset", ["NextStep", "SameStep"])
def test_a_batch_is_as_its_environments_one_by_one(pair, autoreset):
    outcomes = drive(
        pair(autoreset=autoreset, worlds="0:300:7", **SHORT), 600, forward(600)
    )
    assert outcomes.count("collision") > 20


def test_so_to_the_goal(pair, open_dataset_file):
    ahead = np.full((250, COUNT, 2), [0.2, 0.0], np.float32)
    assert "success" in drive(pair(dataset=open_dataset_file, **SHORT), 250, ahead)


# Number of steps, whether a robot collides, and what is changed.
CHANGES = """
a pose in a map: [60, true, {protocol: known_map, worlds: '0:300:7'}]
obstacles that can be pushed: [160, false, {protocol: paper2020, worlds: '0:300:7'}]
moving obstacles:
- 150
- true
- {dataset: dynabarn60, protocol: dynabarn, worlds: '0:60:7'}
frames and actions that hold:
- 60
- true
- {protocol: known_map, action.repeat: 3, observation.frames: 3,
   observation.frame_steps: 2, safety.enabled: true, safety.margin_m: 0.0}
"""
CHANGES = yaml.safe_load(CHANGES)


@pytest.mark.parametrize("name", CHANGES)
def test_so_with(pair, name):
    steps, collides, changes = CHANGES[name]
    outcomes = drive(pair(**changes, **SHORT), steps, forward(steps))
    assert ("collision" in outcomes) is collides


def test_so_with_all_beams_and_a_shield(pair):
    shielded = drive(
        pair(worlds="0:300:7", **{"safety.enabled": True}), 160, forward(160)
    )
    assert shielded.count("collision") < drive(
        pair(worlds="0:300:7"), 160, forward(160)
    ).count("collision")


def test_so_when_time_runs_out_and_for_what_is_not_a_number(pair):
    still = np.full((620, COUNT, 2), [-0.6, 0.0], np.float32)
    still[100, 2] = np.nan
    outcomes = drive(pair(worlds="150", **SHORT), 620, still)
    assert {"no_first_motion", "invalid_command"} <= set(outcomes)


def test_where_nothing_is_near_pybullet_is_not_used(pair, monkeypatch):
    monkeypatch.setattr(
        ScenePool, "acquire", lambda *_: pytest.fail("PyBullet is used")
    )
    batch, _ = pair(worlds="150", **SHORT)
    batch.reset(seed=0)
    for _ in range(50):
        _, _, ended, _, _ = batch.step(np.full((COUNT, 2), [-0.6, 1.0], np.float32))
        assert not ended.any()


@pytest.mark.parametrize("autoreset", ["NextStep", "SameStep"])
def test_a_limit_of_steps_and_pictures_are_gymnasiums(pair, autoreset):
    options = {"render_mode": "rgb_array", "disable_env_checker": True, **SHORT}
    limited = pair(autoreset, max_episode_steps=4, worlds=[0], **options)
    drive(limited, 11, forward(11))
    pictures, expected = (env.render() for env in limited)
    assert len(pictures) == COUNT
    assert all(map(np.array_equal, pictures, expected))
    for limit in (0, 2.5):
        with refused(f"max_episode_steps must be a whole number from 1, got {limit}"):
            gymnasium.make_vec(NAME, 1, max_episode_steps=limit)


def test_actions_of_another_shape_are_refused(pair):
    batch, _ = pair(worlds="150", **SHORT)
    with pytest.raises(gymnasium.error.ResetNeeded):
        batch.step(np.zeros((COUNT, 2), np.float32))
    batch.reset(seed=0)
    with refused(
        r"actions must be an array of shape \(5, 2\), got \(5, 3\)", BarnError
    ):
        batch.step(np.zeros((COUNT, 3), np.float32))


def test_it_is_reset_where_it_is_asked_to(pair):
    batch, other = pair(worlds="0:300:7", **SHORT)
    drive((batch, other), 10, forward(10))
    mask = np.array([True, False, False, True, False])
    first, second = (
        envs.reset(seed=7, options={"reset_mask": mask.copy()})
        for envs in (batch, other)
    )
    np.testing.assert_array_equal(first[0], second[0])
    for action in forward(20, 1):
        np.testing.assert_array_equal(batch.step(action)[0], other.step(action)[0])
